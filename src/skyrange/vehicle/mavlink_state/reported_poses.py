"""True state of aircraft that ArduPilot's own simulation moves: read from SIM_STATE, in the range's frames.

libraries/SITL/SITL.cpp, `sim_state_send`: position in 1e-7 degrees (1.1 cm) and whole centimetres above mean sea
level, velocity north-east-down, body forward-right-down. The simulated body stands `GEAR_M` above the ground
(SIM_Multicopter.cpp, `frame_height`). The message holds no time; the time of the previous message is used.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from skyrange.codec.mavlink import Message
from skyrange.contracts.components import Floats, Poses
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
            abs(math.hypot(*self.attitude) - 1.0) < 0.01
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
