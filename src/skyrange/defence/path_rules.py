"""Path rules: what a defence sends, lets pass, holds and compares on the way between station and autopilot.

Several defences share that way. What one sends by itself, another may drop, and bytes that one compares, another may
have changed in between. So each kind declares what it does, and a scenario whose defences disturb each other is refused
before the run. Attacks have no rules: they are there to disturb.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

from skyrange.core.ids import link_name


class PathEnd(NamedTuple):
    """One end of one link, where taps are."""

    link: str
    """Name of the link, such as `gcs:blue/b1`."""
    side: str
    """Role of the endpoint, such as `companion`."""


@dataclass(frozen=True, slots=True)
class Sends:
    """Frames that a defence sends by itself."""

    at: PathEnd
    direction: Literal["fwd", "rev"]
    """`fwd` is towards the autopilot."""
    messages: frozenset[int]
    """MAVLink message numbers."""
    commands: frozenset[int] = frozenset()
    """Numbers of MAV_CMD that they carry."""
    until: PathEnd | None = None
    """Where the defence takes them off again; `None`: they go on to the autopilot or the station."""


@dataclass(frozen=True, slots=True)
class Passes:
    """A place that not every frame passes."""

    at: PathEnd
    direction: Literal["fwd", "rev"]
    messages: frozenset[int] | None = None
    """Message numbers that pass; `None`: all."""
    commands: frozenset[int] | None = None
    """Numbers of MAV_CMD that pass; `None`: all."""
    drops: frozenset[int] = frozenset()
    """Message numbers that do not pass, of those that would."""


@dataclass(frozen=True, slots=True)
class Signs:
    """A stretch on which frames are signed: what comes onto it in between is not, and is dropped at its end."""

    at: PathEnd
    """Where frames are signed as they pass."""
    until: PathEnd
    """Where they are verified, and unsigned."""
    direction: Literal["fwd", "rev"]


@dataclass(frozen=True, slots=True)
class Compares:
    """Two ends between which the bytes of frames may not change, because both compute a hash of them."""

    at: PathEnd
    until: PathEnd
    direction: Literal["fwd", "rev"]


@dataclass(frozen=True, slots=True)
class Holds:
    """A place where frames may wait while later ones of their sender pass."""

    at: PathEnd
    direction: Literal["fwd", "rev"]


@dataclass(frozen=True, slots=True)
class ExpectsOrder:
    """A place where a frame that later ones of its sender have overtaken is taken for a forged or repeated one."""

    at: PathEnd
    direction: Literal["fwd", "rev"]


PathRule = Sends | Passes | Signs | Compares | Holds | ExpectsOrder


def ends_at(role: str, side: str, vehicles: Sequence[str]) -> list[PathEnd]:
    """The `side` end of the link of this role of each aircraft."""
    return [PathEnd(link_name(role, vehicle), side) for vehicle in vehicles]
