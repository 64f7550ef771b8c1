"""The mean wind of a flight, from how far a multirotor leans at which velocity.

A multirotor that does not accelerate leans by as much as the drag asks for. The drag of rotors is proportional to the
velocity through the air (P.-J. Bristeau et al., The role of propeller aerodynamics in the model of a quadrotor UAV,
ECC 2009; ArduPilot's EKF3 has it as `EK3_DRAG_MCOEF`). So along north and east

    lean acceleration − acceleration = k (velocity − wind),

from which least squares give k and the wind. The body's drag, which grows with the square, is left out: k is that of
the velocities that were flown.

Residuals are correlated over seconds; the variance is that of W. K. Newey & K. D. West (Econometrica 55, 1987) with a
lag of `_LAG_S`. An error of the attitude of `ATTITUDE_DEG` is added, which no log shows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.flightlog.flights import Flight

Floats = NDArray[np.float64]
ATTITUDE_DEG: Final = 1.0
"""Assumed standard deviation of a constant error of roll and pitch: an autopilot's levelling is not in its log."""
_GRAVITY_MPS2: Final = 9.80665
_STEP_S: Final = 0.25
_LAG_S: Final = 5.0
_SMOOTH_S: Final = 1.0
_LOW_M: Final = 3.0
"""Below this height the ground and the landing change the wind and the thrust."""
_MAX_LEAN_RAD: Final = math.radians(45.0)
_MAX_MPS: Final = 100.0
_LEAST_S: Final = 15.0
_LEAST_T: Final = 3.0
"""Least ratio of k to its standard error: with less, velocity and wind cannot be told apart."""


@dataclass(frozen=True, slots=True)
class WindEstimate:
    """The mean wind, as the velocity of the air."""

    east_mps: float
    north_mps: float
    sd_mps: float
    """Standard deviation of each component: of the fit, and of the assumed error of the attitude."""
    drag_per_s: float
    """k: acceleration by velocity through the air."""
    used_s: float
    """Seconds of flight that were used."""

    @property
    def speed_mps(self) -> float:
        """Speed of the wind."""
        return math.hypot(self.east_mps, self.north_mps)

    @property
    def from_deg(self) -> float:
        """The direction that the wind comes from, in degrees clockwise from true north."""
        return math.degrees(math.atan2(-self.east_mps, -self.north_mps)) % 360.0


def estimate_wind(flight: Flight, first: float = 0.0, last: float = 1.0) -> WindEstimate | str:
    """The wind in a part of a flight, by shares of its time in the air; or why it cannot be estimated."""
    span_s = flight.landing_s - flight.take_off_s
    low_s, high_s = flight.take_off_s + first * span_s, flight.take_off_s + last * span_s
    position, attitude = flight.rows("position", low_s, high_s), flight.rows("attitude", low_s, high_s)
    if len(position) < 4 or len(attitude) < 4:
        return "the log has no attitude or no velocity of this flight"
    if not np.isfinite(position["north_mps"]).all():
        return "the log has no velocity of this flight"
    begin_s = max(position["time_s"][0], attitude["time_s"][0])
    end_s = min(position["time_s"][-1], attitude["time_s"][-1])
    times_s = np.arange(begin_s, end_s, _STEP_S)
    if len(times_s) < _LEAST_S / _STEP_S:
        return f"the log has {max(end_s - begin_s, 0.0):.0f} s of flight, and at least {_LEAST_S:.0f} s are needed"
    roll, pitch, yaw = (
        np.interp(times_s, attitude["time_s"], values)
        for values in (attitude["roll_rad"], attitude["pitch_rad"], np.unwrap(attitude["yaw_rad"]))
    )
    north_mps, east_mps = (
        _smooth(np.interp(times_s, position["time_s"], position[name])) for name in ("north_mps", "east_mps")
    )
    lean_north, lean_east = (_smooth(lean) for lean in _lean_mps2(roll, pitch, yaw))
    up_m = np.interp(times_s, position["time_s"], position["alt_msl_m"]) - flight.home[2]
    steady = (up_m > _LOW_M) & (np.abs(roll) < _MAX_LEAN_RAD) & (np.abs(pitch) < _MAX_LEAN_RAD)
    steady &= (np.abs(north_mps) < _MAX_MPS) & (np.abs(east_mps) < _MAX_MPS) & np.isfinite(yaw)
    if steady.sum() * _STEP_S < _LEAST_S:
        return f"{steady.sum() * _STEP_S:.0f} s of the flight are above {_LOW_M:g} m, and {_LEAST_S:.0f} s are needed"

    push = np.stack([lean_north - np.gradient(north_mps, _STEP_S), lean_east - np.gradient(east_mps, _STEP_S)], axis=1)
    return _fit(np.stack([north_mps, east_mps], axis=1)[steady], push[steady])


def _smooth(values: Floats) -> Floats:
    """Means over `_SMOOTH_S`: ends are those of the values that are there."""
    width = round(_SMOOTH_S / _STEP_S) + 1
    kernel = np.ones(width)
    return np.convolve(values, kernel, "same") / np.convolve(np.ones(len(values)), kernel, "same")


def _lean_mps2(roll: Floats, pitch: Floats, yaw: Floats) -> tuple[Floats, Floats]:
    """Horizontal acceleration by thrust that carries the weight, to the north and to the east."""
    upright = np.cos(roll) * np.cos(pitch)
    north = np.cos(roll) * np.sin(pitch) * np.cos(yaw) + np.sin(roll) * np.sin(yaw)
    east = np.cos(roll) * np.sin(pitch) * np.sin(yaw) - np.sin(roll) * np.cos(yaw)
    return -_GRAVITY_MPS2 * north / upright, -_GRAVITY_MPS2 * east / upright


def _fit(velocity: Floats, push: Floats) -> WindEstimate | str:
    """Least squares of push = k velocity + c for both axes with one k, where the wind is −c / k."""
    count = len(velocity)
    design = np.zeros((2, count, 3))
    design[:, :, 0] = velocity.T
    design[0, :, 1] = design[1, :, 2] = 1.0
    rows, wanted = design.reshape(-1, 3), push.T.reshape(-1)
    normal = rows.T @ rows
    if np.linalg.cond(normal) > 1e8:
        return "the flight has one velocity, so that drag and wind cannot be told apart"
    inverse = np.linalg.inv(normal)
    drag, *offsets = solution = inverse @ rows.T @ wanted
    residual = push.T - np.einsum("atk,k->at", design, solution)
    scores = np.einsum("atk,at->tk", design, residual)
    middle = scores.T @ scores
    lag = min(round(_LAG_S / _STEP_S), count - 1)
    for shift in range(1, lag + 1):
        cross = scores[shift:].T @ scores[:-shift]
        middle += (1.0 - shift / (lag + 1.0)) * (cross + cross.T)
    covariance = inverse @ middle @ inverse
    if drag <= 0.0 or drag < _LEAST_T * math.sqrt(max(covariance[0, 0], 0.0)):
        return "the lean does not grow with the velocity, so that drag and wind cannot be told apart"
    wind = [-offset / drag for offset in offsets]
    variances = []
    for axis, speed in enumerate(wind):
        gradient = np.zeros(3)
        gradient[0], gradient[1 + axis] = -speed / drag, -1.0 / drag
        variances.append(float(gradient @ covariance @ gradient))
    tilted_mps = _GRAVITY_MPS2 * math.radians(ATTITUDE_DEG) / drag
    sd_mps = math.sqrt(max(*variances, 0.0) + tilted_mps * tilted_mps)
    return WindEstimate(float(wind[1]), float(wind[0]), sd_mps, float(drag), count * _STEP_S)
