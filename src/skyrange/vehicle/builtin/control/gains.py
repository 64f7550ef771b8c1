"""Gains of the loop, computed from the parameters and stored once for all aircraft with equal values.

Of a thousand aircraft most
have the same parameters. Stored per aircraft, they and the gains computed from them would be the larger part of the
data that the processor loads in every tick.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyrange.core import elementary
from skyrange.core.compiled import compiled
from skyrange.core.time import NS_PER_MS, Time
from skyrange.vehicle.builtin.control.shaping import clamp
from skyrange.vehicle.builtin.layout import GAINS, Records, new_records
from skyrange.world.airframes import AIRFRAMES, Airframe

SLOW_LOOP_S = 0.01
"""Interval of guidance and position control, s; at least one step of the loop."""
GRAVITY_MPS2 = 9.80665
"""ArduPilot's GRAVITY_MSS (libraries/AP_Math/definitions.h)."""
_CDEG = math.pi / 18_000.0
# AC_AttitudeControl.h: AC_ATTITUDE_ACCEL_{RP,Y}_CONTROLLER_{MIN,MAX}_RADSS, AC_ATTITUDE_YAW_MAX_ERROR_ANGLE_RAD
_ACCEL_RP_MIN = math.radians(40.0)
_ACCEL_RP_MAX = math.radians(720.0)
_ACCEL_Y_MIN = math.radians(10.0)
_ACCEL_Y_MAX = math.radians(120.0)
_YAW_ERROR_MAX = math.radians(45.0)


@compiled
def lowpass_alpha(hz: float, dt_s: float) -> float:
    """Return the weight of a new value in one step of a low-pass filter (Filter/LowPassFilter.cpp); 0 Hz is none."""
    if hz <= 0.0:
        return 1.0
    return dt_s / (dt_s + 1.0 / (2.0 * math.pi * hz))


@compiled
def compute_gains(g: Any, p: Any, dt_s: float) -> None:
    """Compute one aircraft's gains from its parameters for steps of `dt_s`."""
    g.angle_p[0] = p.ATC_ANG_RLL_P
    g.angle_p[1] = p.ATC_ANG_PIT_P
    g.angle_p[2] = p.ATC_ANG_YAW_P
    g.angle_accel[0] = clamp(0.5 * p.ATC_ACCEL_R_MAX * _CDEG, _ACCEL_RP_MIN, _ACCEL_RP_MAX)
    g.angle_accel[1] = clamp(0.5 * p.ATC_ACCEL_P_MAX * _CDEG, _ACCEL_RP_MIN, _ACCEL_RP_MAX)
    g.angle_accel[2] = clamp(0.5 * p.ATC_ACCEL_Y_MAX * _CDEG, _ACCEL_Y_MIN, _ACCEL_Y_MAX)
    for axis in range(3):
        g.angle_linear[axis] = g.angle_accel[axis] / (g.angle_p[axis] * g.angle_p[axis])
    # inv_sqrt_controller of the rate that saturates the yaw motors (thrust_heading_rotation_angles)
    rate = 1.0 / p.ATC_RAT_YAW_P
    if rate < g.angle_accel[2] / g.angle_p[2]:
        error = rate / g.angle_p[2]
    else:
        error = 0.5 * g.angle_linear[2] + 0.5 * rate * rate / g.angle_accel[2]
    g.yaw_error_max = min(error, _YAW_ERROR_MAX)
    g.rate_p[0] = p.ATC_RAT_RLL_P
    g.rate_p[1] = p.ATC_RAT_PIT_P
    g.rate_p[2] = p.ATC_RAT_YAW_P
    g.rate_i[0] = p.ATC_RAT_RLL_I * dt_s
    g.rate_i[1] = p.ATC_RAT_PIT_I * dt_s
    g.rate_i[2] = p.ATC_RAT_YAW_I * dt_s
    g.rate_d[0] = p.ATC_RAT_RLL_D / dt_s
    g.rate_d[1] = p.ATC_RAT_PIT_D / dt_s
    g.rate_imax[0] = p.ATC_RAT_RLL_IMAX
    g.rate_imax[1] = p.ATC_RAT_PIT_IMAX
    g.rate_imax[2] = p.ATC_RAT_YAW_IMAX
    g.target_alpha[0] = lowpass_alpha(p.ATC_RAT_RLL_FLTT, dt_s)
    g.target_alpha[1] = lowpass_alpha(p.ATC_RAT_PIT_FLTT, dt_s)
    g.target_alpha[2] = lowpass_alpha(p.ATC_RAT_YAW_FLTT, dt_s)
    g.error_alpha[0] = lowpass_alpha(p.ATC_RAT_RLL_FLTE, dt_s)
    g.error_alpha[1] = lowpass_alpha(p.ATC_RAT_PIT_FLTE, dt_s)
    g.error_alpha[2] = lowpass_alpha(p.ATC_RAT_YAW_FLTE, dt_s)
    g.d_alpha[0] = lowpass_alpha(p.ATC_RAT_RLL_FLTD, dt_s)
    g.d_alpha[1] = lowpass_alpha(p.ATC_RAT_PIT_FLTD, dt_s)
    g.accel_alpha = lowpass_alpha(p.PSC_ACCZ_FLTE, dt_s)
    slow_s = math.ceil(SLOW_LOOP_S / dt_s - 1e-6) * dt_s
    g.vel_alpha = lowpass_alpha(p.PSC_VELXY_FLTE, slow_s)
    g.vel_d_alpha = lowpass_alpha(p.PSC_VELXY_FLTD, slow_s)
    g.climb_alpha = lowpass_alpha(p.PSC_VELZ_FLTE, slow_s)
    g.pos_p = p.PSC_POSXY_P
    g.vel_p = p.PSC_VELXY_P
    g.vel_i = p.PSC_VELXY_I
    g.vel_d = p.PSC_VELXY_D / slow_s
    g.vel_imax = 0.01 * p.PSC_VELXY_IMAX
    g.height_p = p.PSC_POSZ_P
    g.climb_p = p.PSC_VELZ_P
    g.input_p = 1.0 / max(p.ATC_INPUT_TC, 0.01)
    g.accel_max[0] = p.ATC_ACCEL_R_MAX * _CDEG
    g.accel_max[1] = p.ATC_ACCEL_P_MAX * _CDEG
    g.accel_max[2] = p.ATC_ACCEL_Y_MAX * _CDEG
    g.slew_yaw = p.ATC_SLEW_YAW * _CDEG
    g.lean_accel = GRAVITY_MPS2 * elementary.tan(p.ANGLE_MAX * _CDEG)
    # PSC_ACCZ gains are per cm/s² and in 1/1000 of full throttle: 0.1 per m/s²
    g.accel_p = 0.1 * p.PSC_ACCZ_P
    g.accel_i = 0.1 * p.PSC_ACCZ_I * dt_s
    # update_U_controller: the integral can always remove the whole hover throttle
    g.accel_imax = max(0.001 * p.PSC_ACCZ_IMAX, p.MOT_THST_HOVER)
    g.throttle_hover = p.MOT_THST_HOVER
    g.spin_min = p.MOT_SPIN_MIN
    g.spin_range = p.MOT_SPIN_MAX - p.MOT_SPIN_MIN
    g.expo = p.MOT_THST_EXPO
    if abs(g.expo) > 1e-6:
        g.expo_c = 0.5 * (1.0 - g.expo) / g.expo
        g.expo_a = g.expo_c * g.expo_c
        g.expo_b = 1.0 / g.expo


def set_motor_factors(gains: Records, row: int, airframe: Airframe) -> None:
    """Write one row of motor factors, as AP_MotorsMatrix does: half for the outermost motors, on both sides.

    The four motors of a QUAD X have equal factors, whatever the angles of its arms.
    """
    rotors = airframe.rotors
    for name in ("roll_factor", "pitch_factor", "yaw_factor"):
        gains[name][row] = 0.0
    far_left = max(abs(rotor.left_m) for rotor in rotors)
    far_forward = max(abs(rotor.forward_m) for rotor in rotors)
    for motor, rotor in enumerate(rotors):
        left, back = rotor.left_m / far_left, -rotor.forward_m / far_forward
        if len(rotors) == 4:
            left, back = math.copysign(1.0, left), math.copysign(1.0, back)
        gains["roll_factor"][row, motor] = 0.5 * left
        gains["pitch_factor"][row, motor] = 0.5 * back
        gains["yaw_factor"][row, motor] = -0.5 * rotor.spin


UPDATE_NS = 100 * NS_PER_MS
"""A parameter changed in flight takes effect in the loop within this time."""


class GainSets:
    """The distinct sets of parameters among some aircraft. A deep copy continues identically."""

    def __init__(self, airframes: Sequence[str], settings: Records) -> None:
        """`airframes` names each aircraft's airframe; `settings` (n,) SETTINGS may change later: see `update`."""
        self._settings = settings
        names = sorted(set(airframes))
        self._names = names
        self._frames = np.array([names.index(name) for name in airframes], dtype=np.int64)
        self._applied = b""
        self._dt_s = 0.0
        self.set_index: NDArray[np.int64] = np.zeros(len(airframes), dtype=np.int64)
        """(n,) row of each aircraft in `settings` and `gains`."""
        self.parameter_sets: Records = settings[:0].copy()
        """(sets,) SETTINGS."""
        self.gains: Records = new_records(GAINS, 0)
        """(sets,) GAINS."""

    def computed_for(self, dt_s: float) -> bool:
        """Whether the gains are those for this step."""
        return dt_s == self._dt_s

    def update(self, now: Time, dt_s: float) -> None:
        """Apply changed parameters; `dt_s` is the step that the gains are computed for."""
        if dt_s == self._dt_s and now % UPDATE_NS != 0:
            return
        settings = self._settings.tobytes()
        if dt_s == self._dt_s and settings == self._applied:
            return
        self._applied, self._dt_s = settings, dt_s
        keys = np.hstack(
            [self._settings.view(np.uint8).reshape(len(self.set_index), -1), self._frames.view(np.uint8).reshape(-1, 8)]
        )
        _, first, set_index = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        self.set_index = set_index.reshape(-1).astype(np.int64)
        self.parameter_sets = self._settings[first]
        self.gains = new_records(GAINS, len(first))
        for row, frame in enumerate(self._frames[first].tolist()):
            set_motor_factors(self.gains, row, AIRFRAMES[self._names[frame]])
            compute_gains(self.gains[row], self.parameter_sets[row], dt_s)
