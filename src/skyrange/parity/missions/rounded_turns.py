"""Turns to the present heading, where the sign of a rounding residue decides whether an aircraft turns a whole circle.

`CONDITION_YAW` with a direction turns by the difference between the requested and the present heading, plus a whole
circle if the sign of the difference is not that of the direction (ArduCopter/autoyaw.cpp, `set_fixed_yaw_rad`). Where
the two are equal but for a residue, of the estimate or of a place in whole 1e-7 degrees, the two of a comparison have
residues of their own, and neither is wrong.
"""

from __future__ import annotations

from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mission import Mission
from skyrange.core.geodesy import Origin
from skyrange.metrics.time_series import vehicles
from skyrange.record import RunRecord

Floats = NDArray[np.float64]

NEAR_DEG: Final = 3.0
"""A heading is the requested one to within this: a fixed turn is over at 2°."""
APART_DEG: Final = 90.0
APART_S: Final = 2.0
"""One turns and the other does not if, in so long or longer, they come so far apart."""


_ANYWHERE: Final = Origin(45.0, 9.0, 0.0)


class _Flight(Protocol):
    @property
    def time_s(self) -> Floats:
        """(n,) times in s."""
        ...

    @property
    def heading_rad(self) -> Floats:
        """(n,) headings, clockwise from north, without jumps of a whole circle."""
        ...


class _Placed(Protocol):
    def at(self, origin: Origin, start_enu_m: tuple[float, float]) -> Mission:
        """The mission for an aircraft that starts there."""
        ...


def directed_turns(mission: _Placed) -> list[tuple[float, int]]:
    """The turns to a heading with a direction: degrees clockwise from north, 1 clockwise or -1."""
    items = mission.at(_ANYWHERE, (0.0, 0.0)).items
    turns = (item for item in items if item.command == mav.MAV_CMD_CONDITION_YAW and not item.param4 > 0.0)
    return [(item.param1, int(np.sign(item.param3))) for item in turns if abs(item.param3) > 0.0]


def rounded_turn(mission: _Placed, first: _Flight, second: _Flight) -> str:
    """Where one flight turns and the other stays, at a heading that both have and a turn requests; "" if nowhere.

    The flights are compared at equal times. The one that turns does so in the direction of that turn.
    """
    turns = directed_turns(mission)
    if not turns or min(len(first.time_s), len(second.time_s)) < 2:
        return ""
    times_s = first.time_s[first.time_s <= second.time_s[-1]]
    first_deg = np.degrees(first.heading_rad[: len(times_s)])
    second_deg = np.degrees(np.interp(times_s, second.time_s, second.heading_rad))
    second_deg += 360.0 * round(float(first_deg[0] - second_deg[0]) / 360.0)
    apart = np.abs(first_deg - second_deg)
    last_near = np.maximum.accumulate(np.where(apart <= NEAR_DEG, np.arange(len(apart)), -1))
    indices = np.flatnonzero((apart > APART_DEG) & (last_near >= 0) & (times_s - times_s[last_near] >= APART_S))
    if not len(indices):
        return ""
    far, at = int(indices[0]), int(last_near[indices[0]])
    stays, turned = (
        (second_deg, first_deg) if np.ptp(second_deg[at:far]) < np.ptp(first_deg[at:far]) else (first_deg, second_deg)
    )
    sense = np.sign(turned[far] - turned[at])
    for degrees, direction in turns:
        off = (stays[at : far + 1] - degrees + 180.0) % 360.0 - 180.0
        if direction == sense and np.abs(off).max() <= NEAR_DEG:
            who = "the first" if turned is first_deg else "the second"
            return f"turn to {degrees:g}° at {degrees:g}°, {times_s[at]:.1f} s: only {who} turns a circle"
    return ""


def read_headings(record: RunRecord) -> dict[str, Floats]:
    """The true headings of every aircraft of a run in rad, clockwise from north, in order of time."""
    table: Any = record.table("truth", ["vehicle", "qw", "qx", "qy", "qz"])
    names = np.asarray(table.column("vehicle").to_pylist())
    qw, qx, qy, qz = (table.column(name).to_numpy().astype(np.float64) for name in ("qw", "qx", "qy", "qz"))
    heading = 0.5 * np.pi - np.arctan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))
    return {vehicle.id: heading[names == vehicle.id] for vehicle in vehicles(record)}
