"""Optional packages, by the extra of skyrange that installs them."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from typing import Final

from skyrange.core.errors import InputError

MODULES: Final[Mapping[str, tuple[str, ...]]] = {
    "view": ("aiohttp",),
    "live": ("zmq", "aiohttp"),
    "city": ("pyogrio", "pyproj"),
    "orca": ("pyrvo",),
    "serial": ("serial",),
    "ns3": ("ns",),
    "planning": ("ompl",),
    "utm": ("aiohttp", "uas_standards", "s2sphere", "jwt", "sqlalchemy", "alembic"),
    "sionna": ("sionna", "mitsuba"),
    "env": ("pettingzoo", "gymnasium"),
    "export": ("mcap",),
    "logs": ("pyulog",),
    "scale": ("ray", "fsspec"),
    "study": ("scipy", "polars", "duckdb", "sklearn", "lightgbm", "cairosvg"),
}
"""The modules that each extra of `pyproject.toml` adds, without those of development."""


def describe_install(extra: str) -> str:
    """What to do if an extra is missing."""
    return f"Install it: pip install 'skyrange[{extra}]'"


def require_extra(extra: str, who: str) -> None:
    """Raise `InputError` in the name of `who` if a module of an extra is not installed. Imports nothing."""
    for module in MODULES[extra]:
        if not _is_installed(module):
            raise missing_module(module, extra, who)


def missing_module(module: str, extra: str, who: str) -> InputError:
    """The error of `who` that needs a module of an extra."""
    return InputError.one(who, module, "not installed", f"the packages of skyrange[{extra}]", describe_install(extra))


def find_extra(module: str) -> str | None:
    """The first extra that adds a module, which may be a submodule; `None` if none does."""
    top = module.partition(".")[0]
    return next((extra for extra, modules in MODULES.items() if top in modules), None)


def _is_installed(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except (ImportError, ValueError):  # ValueError: a module in `sys.modules` without a specification
        return False
