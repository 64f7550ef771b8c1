"""Hidden failures: reports of failsafes, faulty sensors and a bad estimator, made to look like a healthy aircraft's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin
from skyrange.attack.telemetry.alteration import CONTROLS, TelemetryLinks, alter_telemetry, put, threat
from skyrange.codec.mavlink import dialect as mav
from skyrange.core.time import Time

_HEARTBEAT: Final = int(mav.MAVLINK_MSG_ID_HEARTBEAT)
_SYS_STATUS: Final = int(mav.MAVLINK_MSG_ID_SYS_STATUS)
_EKF: Final = int(mav.MAVLINK_MSG_ID_EKF_STATUS_REPORT)
_FENCE: Final = int(mav.MAVLINK_MSG_ID_FENCE_STATUS)
_TEXT: Final = int(mav.MAVLINK_MSG_ID_STATUSTEXT)
_ARMED: Final = int(mav.MAV_MODE_FLAG_SAFETY_ARMED)
_VARIANCES: Final = ("velocity_variance", "pos_horiz_variance", "pos_vert_variance", "compass_variance")
HEALTHY_VARIANCE: Final = 0.1
"""Largest variance (normalised innovation) that is reported; ground stations warn from 0.5 (Mission Planner)."""
HEALTHY_FLAGS: Final = (
    mav.EKF_ATTITUDE
    | mav.EKF_VELOCITY_HORIZ
    | mav.EKF_VELOCITY_VERT
    | mav.EKF_POS_HORIZ_REL
    | mav.EKF_POS_HORIZ_ABS
    | mav.EKF_POS_VERT_ABS
    | mav.EKF_PRED_POS_HORIZ_REL
    | mav.EKF_PRED_POS_HORIZ_ABS
)
"""Flags of an estimator with a position."""


class HiddenFailures(TelemetryLinks):
    """All reports of failures are made harmless."""


@dataclass(slots=True)
class HealthyReports:
    """Alters status, health, estimator and fence; blanks warnings and errors, whose frames stay."""

    @property
    def messages(self) -> frozenset[int]:
        """Those that report failures."""
        return frozenset((_HEARTBEAT, _SYS_STATUS, _EKF, _FENCE, _TEXT))

    def alter(self, since_ns: Time, number: int, fields: Any) -> bool:
        """See `Alteration`."""
        if number == _HEARTBEAT:
            if fields["system_status"] >= mav.MAV_STATE_CRITICAL:
                armed = fields["base_mode"] & _ARMED
                put(fields, "system_status", mav.MAV_STATE_ACTIVE if armed else mav.MAV_STATE_STANDBY)
        elif number == _SYS_STATUS:
            fields["onboard_control_sensors_health"] |= fields["onboard_control_sensors_enabled"]
        elif number == _EKF:
            put(fields, "flags", HEALTHY_FLAGS)
            for name in _VARIANCES:
                put(fields, name, min(float(fields[name]), HEALTHY_VARIANCE))
        elif number == _FENCE:
            put(fields, "breach_status", 0)
            put(fields, "breach_type", mav.FENCE_BREACH_NONE)
        elif fields["severity"] <= mav.MAV_SEVERITY_WARNING:
            put(fields, "severity", mav.MAV_SEVERITY_DEBUG)
            fields["text"] = b""
        return True


def make(params: HiddenFailures, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for links that the scenario does not have, or that carry no telemetry."""
    return alter_telemetry(params.links, context, HealthyReports())


HIDE_FAILURES = AttackPlugin(
    HiddenFailures,
    make,
    "Hides failures in telemetry: status, sensor health, estimator, fence and warnings.",
    technique="T0878",
    surface=("gcs", "log", "autopilot", "rid_data"),
    persists="acts",
    effect="neither operator nor Remote ID receivers learn of a failsafe",
    threat=threat("the messages that report failures"),
    controls=CONTROLS,
)
