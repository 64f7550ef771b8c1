"""Which plugins of a kind are there? A registry of factories by group and kind, filled by entry points.

A package offers a plugin by an entry point (`[project.entry-points."skyrange.approvals"]`), a
notebook by `register`. A kind is one word or dotted words: `approve-all`, `remote_id.spoof`. Nothing
is imported until a kind is asked for.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from skyrange.core.errors import ComponentError, InputError, nearest

APPROVALS = "skyrange.approvals"
ATTACKS = "skyrange.attacks"
AUTOPILOTS = "skyrange.autopilots"
AVOIDANCE = "skyrange.avoidance"
GROUPS = (APPROVALS, ATTACKS, AUTOPILOTS, AVOIDANCE)

KIND_PATTERN = re.compile(r"[a-z][a-z0-9]*(?:[-_][a-z0-9]+)*(?:\.[a-z][a-z0-9]*(?:[-_][a-z0-9]+)*)*")
"""Lower-case words joined by `-` or `_`, in parts joined by dots."""

Factory = Callable[..., Any]
"""Makes the plugin's object; its arguments are the group's contract, checked in `skyrange.testing`."""

_registered: dict[tuple[str, str], Factory] = {}


def register(group: str, kind: str, factory: Factory) -> None:
    """Offer `factory` under `kind` in `group`, in this process.

    It stands before an entry point of the same kind. Raises InputError for an unknown group, a kind
    that breaks `KIND_PATTERN`, or a kind that another factory was registered under.
    """
    _known_group(group)
    if not KIND_PATTERN.fullmatch(kind):
        raise InputError.one(
            "plugin", "kind", kind, "lower-case words joined by '-', '_' or '.', such as 'remote_id.spoof'"
        )
    known = _registered.setdefault((group, kind), factory)
    if known is not factory:
        raise InputError.one("plugin", "kind", kind, f"a kind that is free in {group}", "Choose another name.")


def kinds(group: str) -> tuple[str, ...]:
    """Every kind of `group`, sorted. Raises InputError for an unknown group."""
    _known_group(group)
    return tuple(sorted({kind for of, kind in _registered if of == group} | _entry_points(group).keys()))


def find(group: str, kind: str) -> Factory:
    """The factory of `kind`, imported now if an entry point names it.

    Raises InputError (with the nearest spelling) for a kind that nobody offers, and ComponentError
    when the package that offers it cannot be imported.
    """
    _known_group(group)
    factory = _registered.get((group, kind))
    if factory is not None:
        return factory
    point = _entry_points(group).get(kind)
    if point is None:
        raise InputError.one("plugin", group, kind, "a kind that is installed", nearest(kind, kinds(group)))
    try:
        loaded: Factory = point.load()
    except (ImportError, AttributeError) as error:
        raise ComponentError(
            f"plugin {kind}", f"cannot import {point.value}: {error}", "Reinstall the package that provides it"
        ) from error
    return loaded


def _known_group(group: str) -> None:
    if group not in GROUPS:
        raise InputError.one("plugin", "group", group, "a group of plugins", nearest(group, GROUPS))


@cache
def _entry_points(group: str) -> dict[str, EntryPoint]:
    """Entry points by kind; a package installed later is seen by the next process."""
    return {point.name: point for point in entry_points(group=group)}
