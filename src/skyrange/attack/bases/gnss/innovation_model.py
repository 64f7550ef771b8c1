"""Model of a victim's GNSS fusion: innovations of false fixes, gates and gains of EKF3, as an attacker computes them.

A Kalman filter's covariance and gains depend on its noise parameters and on the times of its fixes, not on what it
measures; and the inertial sensors measure the true motion, whatever the fixes say. So the error that false fixes cause
follows from the offsets of the fixes alone, and whoever knows the parameters needs neither the victim's state nor its
telemetry. The model has one horizontal axis (position, velocity, tilt, gyro bias) and the climb rate, whose variance
is part of the velocity test: the coupling of EKF3's 24 states that remains near hover.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import Final

import numpy as np

from skyrange.contracts.components import Floats
from skyrange.core import elementary_python, matrices

GRAVITY_MPS2: Final = 9.80665
TARGET_DT_S: Final = 0.012
"""EKF_TARGET_DT (AP_NavEKF3_core.h): the step to which the process noises apply."""
ACC_P_NSE: Final = 0.35
GYRO_P_NSE: Final = 0.015
GBIAS_P_NSE: Final = 0.001
ABIAS_P_NSE: Final = 0.02
VELD_M_NSE: Final = 0.5
ALT_M_NSE: Final = 2.0
"""EKF3's parameters of the same names, at ArduCopter's defaults (AP_NavEKF3.cpp)."""
_CONVERGED_FIXES: Final = 600
_SUBSTEPS: Final = 10


@dataclass(frozen=True, slots=True)
class FilterParameters:
    """What an attacker assumes of a victim's receiver and estimator."""

    pos_i_gate: float
    """EK3_POS_I_GATE, hundredths of a standard deviation."""
    vel_i_gate: float
    """EK3_VEL_I_GATE, likewise."""
    posne_m_nse: float
    """EK3_POSNE_M_NSE, m."""
    velne_m_nse: float
    """EK3_VELNE_M_NSE, m/s."""
    accuracy_m: float
    """Horizontal accuracy that the receiver claims."""
    speed_accuracy_mps: float
    period_s: float
    """Interval of its fixes."""
    lag_s: float
    """Age of a fix when it is fused, at most the interval."""


@dataclass(slots=True, eq=False)
class InnovationModel:
    """Errors (position m, velocity m/s, tilt rad, gyro bias rad/s) of a converged filter that fuses every fix."""

    position_gate_m: float
    """The innovation of position, along one axis, that is just accepted."""
    velocity_gate_mps: float
    period_s: float
    error: Floats
    """(4,) at the time of the next fix, before it is fused."""
    _velocity_gain: Floats
    _position_gain: Floats
    _before: Floats
    """(4, 4) From the time of a fix to its fusion."""
    _after: Floats
    """(4, 4) From there to the next fix."""

    def innovations(self, offset_m: float, velocity_mps: float) -> tuple[float, float]:
        """Innovations of position and velocity of a fix with these offsets."""
        return offset_m - float(self.error[0]), velocity_mps - float(self.error[1])

    def speed_once_level(self, innovation_mps: float) -> float:
        """Error of velocity once innovations of velocity of this size have brought the error of tilt back to zero.

        While the tilt is wrong, the filter goes on accelerating: its error of velocity grows by g tilt² / (2 rate).
        """
        tilt = float(self.error[2])
        rate = float(self._velocity_gain[2]) * innovation_mps / self.period_s
        return float(self.error[1]) + GRAVITY_MPS2 * tilt * abs(tilt) / (2.0 * rate)

    def fuse(self, offset_m: float, velocity_mps: float) -> None:
        """Fuse a fix with these offsets, first its velocity as EKF3 does, and go on to the next."""
        by_m, by_mps = self.innovations(offset_m, velocity_mps)
        correction = self._velocity_gain * by_mps
        correction = correction + self._position_gain * (by_m - float(correction[0]))
        self.error = matrices.multiply(self._after, matrices.multiply(self._before, self.error) + correction)


def converged(assumed: FilterParameters) -> InnovationModel:
    """The model of a filter that has fused fixes for so long that its gains no longer change.

    The tests and variances are those of FuseVelPosNED (AP_NavEKF3_PosVelFusion.cpp): the gates use EK3_VELNE_M_NSE,
    the gains the accuracy that the receiver claims if that is worse. Six satellites or more, no manoeuvre.
    """
    velocity_noise = elementary_python.square(max(assumed.speed_accuracy_mps, assumed.velne_m_nse))
    climb_noise = elementary_python.square(max(assumed.speed_accuracy_mps, VELD_M_NSE))
    position_noise = elementary_python.square(max(assumed.accuracy_m, assumed.posne_m_nse))
    check = assumed.velne_m_nse * assumed.velne_m_nse
    p, u = np.diag([position_noise, 0.01, 1e-4, 1e-5]), np.diag([1.0, 0.01, 0.01])
    step_s = assumed.period_s / _SUBSTEPS
    move, climb = _level(step_s), _vertical(step_s)
    noise = (
        np.diag([0.0, ACC_P_NSE * ACC_P_NSE, GYRO_P_NSE * GYRO_P_NSE, GBIAS_P_NSE * GBIAS_P_NSE]) * TARGET_DT_S * step_s
    )
    climb_stir = np.diag([0.0, ACC_P_NSE * ACC_P_NSE, ABIAS_P_NSE * ABIAS_P_NSE]) * TARGET_DT_S * step_s
    position_spread = velocity_spread = 0.0
    velocity_gain = position_gain = np.zeros(4)
    for _ in range(_CONVERGED_FIXES):
        for step in range(_SUBSTEPS):
            p = matrices.multiply(move, p, move.T) + noise
            u = matrices.multiply(climb, u, climb.T) + climb_stir
            if step % (_SUBSTEPS // 2) == 0:
                _, u = _updated(u, 0, ALT_M_NSE * ALT_M_NSE)
        position_spread = 2.0 * (p[0, 0] + position_noise)
        velocity_spread = 2.0 * (p[1, 1] + check) + u[1, 1] + check
        velocity_gain, p = _updated(p, 1, velocity_noise)
        position_gain, p = _updated(p, 0, position_noise)
        _, u = _updated(u, 1, climb_noise)
    return InnovationModel(
        max(0.01 * assumed.pos_i_gate, 1.0) * sqrt(position_spread),
        max(0.01 * assumed.vel_i_gate, 1.0) * sqrt(velocity_spread),
        assumed.period_s,
        np.zeros(4),
        velocity_gain,
        position_gain,
        _level(assumed.lag_s),
        _level(assumed.period_s - assumed.lag_s),
    )


def _level(seconds: float) -> Floats:
    """Transition of (position, velocity, tilt, gyro bias): tilt times g is acceleration."""
    h, g = seconds, GRAVITY_MPS2
    rows = [[1, h, g * h * h / 2, g * h * h * h / 6], [0, 1, g * h, g * h * h / 2], [0, 0, 1, h], [0, 0, 0, 1]]
    return np.array(rows, dtype=np.float64)


def _vertical(seconds: float) -> Floats:
    """Transition of (height, climb rate, accelerometer bias)."""
    h = seconds
    return np.array([[1, h, -h * h / 2], [0, 1, -h], [0, 0, 1]], dtype=np.float64)


def _updated(covariance: Floats, state: int, noise: float) -> tuple[Floats, Floats]:
    """Gains of a measurement of one state, and the covariance after it."""
    row = covariance[state]
    gain = row / (row[state] + noise)
    return gain, covariance - np.outer(gain, row)
