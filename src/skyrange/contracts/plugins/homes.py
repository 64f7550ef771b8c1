"""Homes of kinds: the package of each group, whose modules are named as the kinds in them."""

from __future__ import annotations

import keyword
from collections.abc import Iterator, Mapping
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from importlib.util import find_spec
from pkgutil import walk_packages
from types import ModuleType
from typing import Final

from skyrange.core.errors import ComponentError, SkyrangeError

HOMES: Final[Mapping[str, str]] = {
    "skyrange.attacks": "skyrange.attack",
    "skyrange.defences": "skyrange.defence",
    "skyrange.detectors": "skyrange.detect",
    "skyrange.faults": "skyrange.fault",
}
"""The package of each group: `mavlink.mode` of `skyrange.attacks` is in `skyrange.attack.mavlink.mode`."""
PACKAGES: Final = "skyrange.plugins"
"""The entry point group of packages with kinds: with `acme = "acme_sky"`, `acme.lag` is in `acme_sky.lag`."""


def name_of_module(module: str) -> str | None:
    """The name of the kinds in a module below a home; `None` for a module elsewhere, where names are free."""
    for home, prefix in [*((home, "") for home in HOMES.values()), *_offered().items()]:
        if module.startswith(f"{home}."):
            path = module.removeprefix(f"{home}.")
            return prefix + ".".join(part.removesuffix("_") for part in path.split("."))
    return None


def import_home(group: str, kind: str) -> None:
    """Import the module that has a kind of this name, if there is one."""
    for module in _modules_of(group, kind):
        if _exists(module):
            _import(module)
            return


def import_all(group: str) -> None:
    """Import every module of the group's home, and of all packages that offer kinds."""
    for home in [*([HOMES[group]] if group in HOMES else []), *_offered()]:
        _import_below(home)


def _modules_of(group: str, kind: str) -> Iterator[str]:
    """The modules in which a kind may be."""
    path = ".".join(f"{part}_" if keyword.iskeyword(part) else part for part in kind.split("."))
    if group in HOMES:
        yield f"{HOMES[group]}.{path}"
    for package, prefix in _offered().items():
        if kind.startswith(prefix):
            yield f"{package}.{path.removeprefix(prefix)}"


def _exists(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:  # a package on the way
        return False


@cache
def _import_below(package: str) -> None:
    home = _import(package)
    for found in walk_packages(getattr(home, "__path__", ()), f"{package}."):
        if not found.name.endswith(".__main__"):
            _import(found.name)


def _import(module: str) -> ModuleType:
    """Import a module. What it raises is the fault of its package; `InputError` says already what is wrong."""
    try:
        return import_module(module)
    except SkyrangeError:
        raise
    except Exception as error:
        package = module.partition(".")[0]
        hint = f"Mend {package}, or remove it" if package != "skyrange" else "Reinstall skyrange"
        raise ComponentError(f"package {package}", f"cannot import {module}: {error!r}", hint) from error


@cache
def _offered() -> dict[str, str]:
    """The packages that offer kinds, and what the names of theirs begin with."""
    return {point.value: f"{point.name}." for point in entry_points(group=PACKAGES)}
