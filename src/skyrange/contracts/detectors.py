"""Detectors as plugins: what one is told when it is made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from skyrange.contracts.monitors import Monitor
from skyrange.contracts.plugins import DETECTORS, Plugin

if TYPE_CHECKING:
    from skyrange.core.chance import Chance
    from skyrange.core.geodesy import Origin
    from skyrange.core.time import Epoch


@dataclass(frozen=True, slots=True)
class DetectorContext:
    """What the scenario tells a detector that it makes. Whether there is an attack is not in it."""

    id: str
    """The detector's id, unique among the detectors of the scenario."""
    vehicles: Sequence[str]
    """Every vehicle id of the scenario (`blue/b1`), in order."""
    origin: Origin
    epoch: Epoch
    chance: Chance


@dataclass(frozen=True, slots=True)
class DetectorPlugin(Plugin[DetectorContext, Monitor]):
    """A kind of detector. `make` returns a new monitor at each call: one for each run, and each process of it."""

    group: ClassVar[str] = DETECTORS
