"""False alarm: reports of an emergency and of failed sensors that an aircraft does not have."""

from __future__ import annotations

from typing import Final, Literal

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.message_fields import put_bits
from skyrange.attack.bases.mavlink.params import SENSORS, SensorNames
from skyrange.attack.bases.mavlink.telemetry import report_lost

_STATES: Final = {"critical": sky.mavlink.MAV_STATE_CRITICAL, "emergency": sky.mavlink.MAV_STATE_EMERGENCY}


@sky.attack(
    "telemetry.false_alarm",
    effect="Remote ID says emergency, and the aircraft's own avoidance stays off, as in a failsafe",
    knowledge="the messages that report failures",
)
class FalseAlarm(sky.AlteredTelemetry):
    """Reports a failsafe, failed sensors and a lost estimator that the aircraft does not have."""

    state: Literal["critical", "emergency"] = sky.param(
        "Claimed MAV_STATE in HEARTBEAT; ArduPilot reports critical during a failsafe.", default="critical"
    )
    sensors: SensorNames = sky.param(
        "Sensors that seem to have failed, named as in MAV_SYS_STATUS_SENSOR; may be empty.", default=("GPS", "AHRS")
    )
    estimator: bool = sky.param("Whether EKF_STATUS_REPORT tells that the position is lost.", default=True)
    failed: int = 0
    """Bits of the sensors."""

    def prepare(self, context: sky.AttackContext) -> None:
        for name in self.sensors:
            self.failed |= SENSORS[name]

    def find_messages(self) -> tuple[str, ...]:
        return ("HEARTBEAT", "SYS_STATUS", *(("EKF_STATUS_REPORT",) if self.estimator else ()))

    def alter(self, message: str, fields: sky.MavlinkFields, since_ns: sky.Time) -> bool:
        if message == "HEARTBEAT":
            sky.put(fields, "system_status", _STATES[self.state])
        elif message == "SYS_STATUS":
            for name in ("onboard_control_sensors_present", "onboard_control_sensors_enabled"):
                put_bits(fields, name, self.failed, value=True)
            put_bits(fields, "onboard_control_sensors_health", self.failed, value=False)
        else:
            report_lost(fields)
        return True
