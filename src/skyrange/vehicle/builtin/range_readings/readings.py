"""Readings of the range sensors of an aircraft: what its rangefinder and its proximity sensor have taken in."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from skyrange.core.time import NS_PER_MS, Time
from skyrange.vehicle.builtin.range_readings.boundary import Boundary

TIMEOUT_NS: Final[Time] = 500 * NS_PER_MS  # AP_RANGEFINDER_MAVLINK_TIMEOUT_MS, PROXIMITY_MAV_TIMEOUT_MS


@dataclass(slots=True)
class Rangefinder:
    """The last DISTANCE_SENSOR in the orientation of RNGFND1_ORIENT."""

    read_ns: Time = -TIMEOUT_NS
    distance_m: float = 0.0
    min_m: float = 0.0
    max_m: float = 0.0


@dataclass(slots=True)
class Proximity:
    """The boundary of obstacles, and what avoidance keeps from one step to the next."""

    boundary: Boundary = field(default_factory=Boundary)
    read_ns: Time = -TIMEOUT_NS
    boot_ms: int = -1
    """`time_boot_ms` of the last DISTANCE_SENSOR."""
    waiting_m: dict[int, float] = field(default_factory=dict)
    """Distances by sector of the messages with that time, which enter the boundary together."""
    limited_ns: Time = -TIMEOUT_NS
    """When avoidance last changed a velocity."""
    limited_vel: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """The velocity that it made of it."""


@dataclass(slots=True)
class RangeSensors:
    """The range sensors of an aircraft; None for one that it has not."""

    rangefinder: Rangefinder | None
    proximity: Proximity | None
