"""Position reports of an external vehicle: GLOBAL_POSITION_INT and ATTITUDE, in the range's frames and on its clock.

Position is in 1e-7 degrees (1.1 cm) and millimetres above mean sea level, velocity in cm/s north-east-down, attitude
and rates of a body that is forward-right-down (https://mavlink.io/en/messages/common.html). They come from the
vehicle's own estimator, with all its errors; nothing more accurate is available.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from skyrange.codec.mavlink import Message
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S, Time
from skyrange.vehicle.mavlink_state.reported_poses import ReportedState

REACH_M: Final = 100_000.0
"""A position farther from the origin is invalid: an autopilot without a fix reports 0° N 0° E."""
MAX_DRIFT: Final = 1e-3
"""Share of the elapsed time: at this rate a drifting clock is followed, and an early report is forgotten."""
_ROOT: Final = math.sqrt(0.5)
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
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    w, x = cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy
    y, z = cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy
    return (
        -_ROOT * (w + z),
        -_ROOT * (x + y),
        _ROOT * (y - x),
        _ROOT * (z - w),
    )  # as `reported_poses.state_from_sim_state`
