"""Poses that autopilots report: SIM_STATE, or GLOBAL_POSITION_INT and ATTITUDE, in the range's frames.

libraries/SITL/SITL.cpp, `sim_state_send`: position in 1e-7 degrees (1.1 cm) and whole centimetres above mean sea
level, velocity north-east-down, body forward-right-down. The simulated body stands `GEAR_M` above the ground
(SIM_Multicopter.cpp, `frame_height`). The message holds no time; the time of the previous message is used.

Position reports of an external vehicle: GLOBAL_POSITION_INT and ATTITUDE, in the range's frames and on its clock.
Position is in 1e-7 degrees (1.1 cm) and millimetres above mean sea level, velocity in cm/s north-east-down, attitude
and rates of a body that is forward-right-down (https://mavlink.io/en/messages/common.html). They come from the
vehicle's own estimator, with all its errors; nothing more accurate is available.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from skyrange.codec.mavlink import Message
from skyrange.contracts.components import Floats, Poses
from skyrange.core import elementary, elementary_python
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S, Time

GEAR_M: Final = 0.1
MAX_EXTRAPOLATION_NS: Final[Time] = NS_PER_S // 4
"""Limit of the extrapolation of a pose, forwards or backwards."""
_ROOT: Final = math.sqrt(0.5)


class ReportedState(NamedTuple):
    """The true state of one aircraft, frames as in `contracts.components.Poses`."""

    position_enu_m: tuple[float, float, float]
    vel_enu_mps: tuple[float, float, float]
    attitude: tuple[float, float, float, float]
    rates_radps: tuple[float, float, float]

    @property
    def is_valid(self) -> bool:
        """Whether all values are finite and the quaternion has unit length."""
        return all(map(math.isfinite, (*self[0], *self[1], *self[2], *self[3]))) and (
            abs(elementary_python.distance(self.attitude, (0.0,) * 4) - 1.0) < 0.01
        )


def state_from_sim_state(message: Message, origin: Origin) -> ReportedState:
    """The state in a SIM_STATE message."""
    east_m, north_m = origin.enu_of(message.lat_int * 1e-7, message.lon_int * 1e-7)
    w, x, y, z = message.q1, message.q2, message.q3, message.q4
    return ReportedState(
        (east_m, north_m, message.alt - GEAR_M - origin.alt_msl_m),
        (message.ve, message.vn, -message.vd),
        # q' = (0, √½, √½, 0) · q · (0, 1, 0, 0): north-east-down to east-north-up, and the body's half turn
        (-_ROOT * (w + z), -_ROOT * (x + y), _ROOT * (y - x), _ROOT * (z - w)),
        (message.xgyro, -message.ygyro, -message.zgyro),
    )


class ReportedPoses:
    """The last states of a fleet, as poses."""

    def __init__(self, count: int) -> None:
        self._late_ns = np.zeros(count)
        self._poses = Poses(
            np.zeros(count, dtype=bool), np.zeros((count, 3)), np.zeros((count, 3)), np.zeros((count, 4)),
            np.zeros((count, 3)),
        )  # fmt: skip

    def update(self, row: int, state: ReportedState, late_ns: Time) -> None:
        """Take in the state of `row` as of `late_ns` before the tick."""
        poses = self._poses
        poses.fresh[row] = True
        poses.position_enu_m[row] = state.position_enu_m
        poses.vel_enu_mps[row] = state.vel_enu_mps
        poses.attitude[row] = state.attitude
        poses.rates_radps[row] = state.rates_radps
        self._late_ns[row] = min(max(late_ns, -MAX_EXTRAPOLATION_NS), MAX_EXTRAPOLATION_NS)

    def take_new(self) -> Poses | None:
        """The poses that are new since the last call, extrapolated to the tick by their velocity."""
        if not self._poses.fresh.any():
            return None
        poses, late_s = self._poses, self._late_ns[:, None] / NS_PER_S
        position: Floats = poses.position_enu_m + poses.vel_enu_mps * late_s
        velocity, attitude, rates = (a.copy() for a in (poses.vel_enu_mps, poses.attitude, poses.rates_radps))
        taken = Poses(poses.fresh, position, velocity, attitude, rates)
        poses.fresh = np.zeros_like(poses.fresh)
        return taken


REACH_M: Final = 100_000.0
"""A position farther from the origin is invalid: an autopilot without a fix reports 0° N 0° E."""
MAX_DRIFT: Final = 1e-3
"""Share of the elapsed time: at this rate a drifting clock is followed, and an early report is forgotten."""
_NO_HEADING: Final = 65_535


@dataclass(slots=True)
class PositionReports:
    """The reports of one vehicle."""

    attitude: tuple[float, float, float] | None = None
    """Roll, pitch, yaw, rad."""
    rates: tuple[float, float, float] = (0.0, 0.0, 0.0)
    boot_ms: int = -1
    """Its clock at the last position."""
    state: ReportedState | None = None
    _ahead_s: float = 0.0
    """Our clock minus its own, by the report with the least delay."""
    _at_s: float | None = None

    def on_attitude(self, message: Message) -> None:
        """Take in an ATTITUDE. One with a value that is not finite is ignored."""
        reported = (message.roll, message.pitch, message.yaw, message.rollspeed, message.pitchspeed, message.yawspeed)
        if all(map(math.isfinite, reported)) and max(map(abs, reported)) < 1e3:
            self.attitude, self.rates = reported[:3], reported[3:]

    def on_position(self, message: Message, origin: Origin, now_s: float) -> Time | None:
        """Take in a GLOBAL_POSITION_INT at `now_s` of the machine's clock: its age in ns, `None` for a position beyond
        `REACH_M`.

        The report with the least delay is assumed to have none, because nothing better is known: the result is how
        much longer this one took.
        """
        east_m, north_m = origin.enu_of(message.lat * 1e-7, message.lon * 1e-7)
        up_m = message.alt * 1e-3 - origin.alt_msl_m
        if max(abs(east_m), abs(north_m), abs(up_m)) > REACH_M:
            return None
        yaw = 0.0 if message.hdg == _NO_HEADING else math.radians(message.hdg * 1e-2)
        self.state = ReportedState(
            (east_m, north_m, up_m),
            (message.vy * 1e-2, message.vx * 1e-2, -message.vz * 1e-2),
            quaternion_from_euler(*(self.attitude or (0.0, 0.0, yaw))),
            (self.rates[0], -self.rates[1], -self.rates[2]),
        )
        boot_ms = int(message.time_boot_ms)
        ahead_s = now_s - boot_ms * 1e-3
        if self._at_s is None or boot_ms < self.boot_ms:
            self._ahead_s = ahead_s
        else:
            self._ahead_s = min(self._ahead_s + (now_s - self._at_s) * MAX_DRIFT, ahead_s)
        self._at_s, self.boot_ms = now_s, boot_ms
        return round(min(ahead_s - self._ahead_s, 1.0) * NS_PER_S)


def quaternion_from_euler(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """w, x, y, z from forward-left-up to east-north-up, of angles from forward-right-down to north-east-down."""
    cr, sr = elementary.cos(roll / 2), elementary.sin(roll / 2)
    cp, sp = elementary.cos(pitch / 2), elementary.sin(pitch / 2)
    cy, sy = elementary.cos(yaw / 2), elementary.sin(yaw / 2)
    w, x = cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy
    y, z = cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy
    return (
        -_ROOT * (w + z),
        -_ROOT * (x + y),
        _ROOT * (y - x),
        _ROOT * (z - w),
    )  # as `state_from_sim_state`
