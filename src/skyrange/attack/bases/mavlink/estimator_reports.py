"""Estimator as telemetry reports it: flags and variances of EKF_STATUS_REPORT."""

from __future__ import annotations

from typing import Final

from skyrange.attack.bases.mavlink.message_fields import Fields, put
from skyrange.codec.mavlink import dialect as mav

VARIANCES: Final = ("velocity_variance", "pos_horiz_variance", "pos_vert_variance", "compass_variance")
"""Fields with variances (normalised innovations)."""
HEALTHY_VARIANCE: Final = 0.1
"""Largest variance of a healthy estimator; ground stations warn from 0.5 (Mission Planner)."""
HEALTHY_FLAGS: Final = (
    mav.EKF_ATTITUDE | mav.EKF_VELOCITY_HORIZ | mav.EKF_VELOCITY_VERT | mav.EKF_POS_HORIZ_REL | mav.EKF_POS_HORIZ_ABS
    | mav.EKF_POS_VERT_ABS | mav.EKF_PRED_POS_HORIZ_REL | mav.EKF_PRED_POS_HORIZ_ABS
)  # fmt: skip
"""Flags of an estimator with a position."""
LOST_VARIANCE: Final = 1.0
"""Least variance of a lost estimator: at 1 it would reject the measurement."""
LOST_FLAGS: Final = mav.EKF_ATTITUDE | mav.EKF_CONST_POS_MODE
"""Flags of an estimator without a position."""


def report_healthy(fields: Fields) -> None:
    """Make the report one of an estimator with a position."""
    put(fields, "flags", HEALTHY_FLAGS)
    for name in VARIANCES:
        put(fields, name, min(float(fields[name]), HEALTHY_VARIANCE))


def report_lost(fields: Fields) -> None:
    """Make the report one of an estimator that has lost its position."""
    put(fields, "flags", LOST_FLAGS)
    for name in VARIANCES:
        put(fields, name, max(float(fields[name]), LOST_VARIANCE))
