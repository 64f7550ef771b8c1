"""UTM services as processes: a USS, a DSS or an authorization service of F3548 on HTTP, in real time."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Final

from skyrange.core.errors import ComponentError

NEEDED: Final = ("uas_standards", "s2sphere", "jwt", "sqlalchemy", "alembic")
"""Modules of the extra `utm`."""


def check_installed(who: str = "utm") -> None:
    """Raise `ComponentError` in the name of `who` if a package of the extra is missing."""
    missing = [name for name in NEEDED if find_spec(name) is None]
    if missing:
        raise ComponentError(who, f"{missing[0]} is not installed", "pip install 'skyrange[utm]'")
