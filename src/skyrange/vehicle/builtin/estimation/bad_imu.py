"""Bad IMU data: accelerometers that disagree with both height and climb rate (badIMUdata).

An impact, or vibration beyond their range, leaves the inertial climb rate wrong, and the height diverges with it. GNSS
and the barometer would then be rejected by their gates. EKF3 detects that both innovations lie on the same side, and
accepts their measurements for 10 s (NavEKF3_core::FuseVelPosNED, selectHeightForFusion, CovariancePrediction).
"""

from __future__ import annotations

from typing import Any, Final

from skyrange.core.compiled import compiled
from skyrange.core.time import NS_PER_S

HOLD_NS: Final = 10 * NS_PER_S
"""BAD_IMU_DATA_HOLD_MS."""
RESET_NS: Final = NS_PER_S
"""BAD_IMU_DATA_TIMEOUT_MS: after this time without good data, the height is reset to the barometer."""
ACCEL_NOISE_MPS2: Final = 5.0
"""BAD_IMU_DATA_ACC_P_NSE: the accelerometers' process noise while their data are bad."""


@compiled
def update_bad_imu(k: Any, now: int, climb: float, off: float, climb_noise: float, height_noise: float) -> bool:
    """At a fix, return whether IMU data are bad; then the climb rate becomes the fix's.

    `climb` is the fix's climb rate, `off` its difference to the estimated one at that time, m/s. Noises are variances.
    Both innovations must lie beyond three standard deviations on the same side; beyond two or one soon afterwards.
    """
    since = now - k.bad_imu_at
    gain = 9.0
    if since <= 3 * HOLD_NS // 2:
        gain = 1.0
    elif since <= 2 * HOLD_NS:
        gain = 4.0
    if k.hgt_innov * off > 0.0 and k.hgt_innov**2 > gain * height_noise and off * off > gain * climb_noise:
        k.bad_imu_at = now
    else:
        k.good_imu_at = now
    bad: bool = since < HOLD_NS
    k.bad_imu = 1 if bad else 0
    if bad:
        by = climb - k.vel[2]
        k.vel[2] = climb
        k.pending_vel[2] += by
        k.corrected_vel[2] += by
    return bad


@compiled
def needs_height_reset(k: Any, now: int) -> bool:
    """Whether to reset the height to the barometer's at once."""
    lost: bool = k.bad_imu == 1 and now - k.good_imu_at > RESET_NS
    return lost
