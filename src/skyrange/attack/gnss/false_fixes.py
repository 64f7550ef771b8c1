"""Falsified GNSS fixes: a sensor fault between receivers and autopilots, and the tracks that it follows.

A spoofer changes what a receiver computes. So this fault alters the position and velocity of each fix; time, fix type,
satellites and claimed accuracy stay as the receiver reports them, and no other sensor is altered.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator

from skyrange.attack.contract import Attack, AttackContext
from skyrange.attack.exclusive import Exclusive
from skyrange.attack.victims import check_vehicles
from skyrange.contracts.components import Floats, SensorAct, Sensors
from skyrange.contracts.links import Schedule
from skyrange.contracts.params import Enu, refuse
from skyrange.core.errors import Problem
from skyrange.core.time import NEVER, NS_PER_S, Time

_FIX_2D = 2  # MAVLink GPS_FIX_TYPE: the lowest one with a position


def within(least: float, most: float, what: str) -> AfterValidator:
    """A validator of `Enu`: each component from `least` to `most`."""

    def check(vector: Any) -> Any:
        if not all(least <= component <= most for component in vector):
            raise refuse(Problem("", repr(list(vector)), f"each component from {least:g} to {most:g} {what}"))
        return vector

    return AfterValidator(check)


Offset = Annotated[Enu, within(-100_000.0, 100_000.0, "metres")]
"""Metres east, north and up, each at most 100 km."""
Rate = Annotated[Enu, within(-500.0, 500.0, "m/s")]
"""Metres per second east, north and up, each at most what EKF3 takes for a velocity (500 m/s)."""


class Track(Protocol):
    """The offset of fixes from the truth over time. Immutable."""

    def at(self, seconds: Floats) -> tuple[Floats, Floats, NDArray[np.int64]]:
        """At times (n,) since the start of the attack: offsets (n, 3) m, offsets of velocities (n, 3) m/s, phases (n,).

        A phase is a small number for the kind of alteration. An act is labelled when it changes.
        """
        ...


@dataclass(frozen=True, slots=True)
class ShamTrack:
    """The phases of a track, with zero offsets."""

    track: Track

    def at(self, seconds: Floats) -> tuple[Floats, Floats, NDArray[np.int64]]:
        """See `Track`."""
        offsets, velocities, phases = self.track.at(seconds)
        return np.zeros_like(offsets), np.zeros_like(velocities), phases


@dataclass(slots=True)
class FalseFixes:
    """A fault that shifts the fixes of its vehicles along a track.

    The offset of a fix is that of the time at which the fix was *measured*: a repeated fix has the same offset again,
    and a fix that was measured before the attack started stays true. The track counts from the start of the schedule,
    so the only state between ticks is the phase that was last reported for each vehicle, and what was computed for the
    latest fixes: they are repeated for many ticks.
    """

    name: str
    vehicles: Sequence[str]
    track: Track
    schedule: Schedule
    slow: bool = True
    _phases: list[int] = field(init=False)
    _fixes: tuple[Time, bytes, bytes] = (NEVER, b"", b"")
    """Of the latest shift: the start it counts from, and times and types of the fixes."""
    _shift: tuple[slice | NDArray[np.int64], Floats, Floats] = field(init=False)
    """Rows, and what is added to their positions and velocities."""

    def __post_init__(self) -> None:
        self._phases = [-1] * len(self.vehicles)
        self._shift = (slice(0, 0), np.zeros((0, 3)), np.zeros((0, 3)))

    def on_sensors(self, now: Time, sensors: Sensors) -> Sequence[SensorAct]:
        """Shift the fixes. Returns an act for each vehicle whose alteration begins or changes its phase."""
        if self.schedule.start_ns > now:
            return []
        fixes = (self.schedule.start_ns, sensors.gnss_time_ns.tobytes(), sensors.gnss_fix.tobytes())
        acts = self._follow(sensors) if fixes != self._fixes else []
        self._fixes = fixes
        rows, offsets, velocities = self._shift
        sensors.gnss_enu_m[rows] += offsets
        sensors.gnss_vel_enu_mps[rows] += velocities
        return acts

    def _follow(self, sensors: Sensors) -> list[SensorAct]:
        """Compute the shift of new fixes; an act for each vehicle whose alteration begins or changes its phase."""
        start = self.schedule.start_ns
        rows = np.flatnonzero((sensors.gnss_time_ns >= start) & (sensors.gnss_fix >= _FIX_2D))
        offsets, velocities, phases = self.track.at((sensors.gnss_time_ns[rows] - start) / NS_PER_S)
        self._shift = (slice(None) if len(rows) == len(self.vehicles) else rows), offsets, velocities
        acts = []
        for row, phase in zip(rows.tolist(), phases.tolist(), strict=True):
            if self._phases[row] != phase:
                self._phases[row] = phase
                acts.append(SensorAct(self.vehicles[row], "gnss"))
        return acts


def falsify_fixes(vehicles: Sequence[str], track: Track, context: AttackContext) -> Attack:
    """The attack on these vehicles' receivers, or its sham. Raises `InputError` for one that is not in the scenario."""
    check_vehicles(context, vehicles)
    used = ShamTrack(track) if context.sham else track
    fault = FalseFixes(f"{context.id}.gnss", vehicles, used, context.schedule)
    return Attack(faults=[fault], exclusive=[Exclusive(fixes_of(vehicle)) for vehicle in vehicles])


def fixes_of(vehicle: str) -> str:
    """The fixes of an aircraft as something that one attack alone may falsify: see `Exclusive.what`."""
    return f"GNSS fixes of {vehicle}"
