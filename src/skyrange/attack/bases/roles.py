"""Links of some roles, by patterns."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import Final

from skyrange.attack.contract import AttackContext
from skyrange.core.errors import InputError, nearest

LINKS_ABOUT: Final = "Links gcs, log or autopilot by name or pattern, such as ['gcs:blue/b1']."
"""Description of the parameter that names control links."""


def find_links(patterns: Sequence[str], context: AttackContext, roles: Sequence[str]) -> list[str]:
    """The links that match, each once.

    Raises `InputError` for a pattern without a link, and for a link of another role than `roles`.
    """
    chosen = []
    for place, pattern in enumerate(patterns):
        found = [name for name in context.links if fnmatchcase(name, pattern)]
        wrong = [name for name in found if name.partition(":")[0] not in roles]
        if not found or wrong:
            usable = [name for name in context.links if name.partition(":")[0] in roles]
            expected = f"a link of the scenario: {', '.join(roles)}"
            raise InputError.one(
                context.id, f"links.{place}", wrong[0] if wrong else pattern, expected, nearest(pattern, usable)
            )
        chosen += found
    return list(dict.fromkeys(chosen))
