"""Detectors as plugins: the context that a detector is made from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

from skyrange.contracts.monitors import Monitor
from skyrange.contracts.plugins.registry import DETECTORS, Plugin

if TYPE_CHECKING:
    from skyrange.core.chance import Chance
    from skyrange.core.geodesy import Origin
    from skyrange.core.time import Epoch


@dataclass(frozen=True, slots=True)
class DetectorContext:
    """The context of a detector: data of the scenario, without its attacks."""

    id: str
    """The detector's id, unique among the detectors of the scenario."""
    vehicles: Sequence[str]
    """Every vehicle id of the scenario (`blue/b1`), in order."""
    origin: Origin
    epoch: Epoch
    chance: Chance

    def __post_init__(self) -> None:
        object.__setattr__(self, "vehicles", tuple(self.vehicles))


@dataclass(frozen=True, slots=True)
class DetectorPlugin(Plugin[DetectorContext, Monitor]):
    """A kind of detector. `make` returns a new monitor at each call: one for each run, and each process of it."""

    group: ClassVar[str] = DETECTORS

    reduced: str = field(default="", kw_only=True)
    """What it lacks of the published method that it is named after, such as inputs or a rate; "" for nothing.

    Rankings mark a detector that has it: its place says nothing about the method as published.
    """
