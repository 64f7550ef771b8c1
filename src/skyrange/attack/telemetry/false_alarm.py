"""False alarm: reports of an emergency and of failed sensors that an aircraft does not have."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal

from pydantic import AfterValidator, BeforeValidator, Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin
from skyrange.attack.telemetry.alteration import CONTROLS, TelemetryLinks, alter_telemetry, put, threat
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.params import items, refuse
from skyrange.core.errors import Problem, nearest
from skyrange.core.time import Time

_HEARTBEAT: Final = int(mav.MAVLINK_MSG_ID_HEARTBEAT)
_SYS_STATUS: Final = int(mav.MAVLINK_MSG_ID_SYS_STATUS)
_EKF: Final = int(mav.MAVLINK_MSG_ID_EKF_STATUS_REPORT)
_VARIANCES: Final = ("velocity_variance", "pos_horiz_variance", "pos_vert_variance", "compass_variance")
_BAD_VARIANCE: Final = 1.0
"""Claimed variance (normalised innovation): at 1 the estimator would reject the measurement."""
_STATES: Final = {"critical": int(mav.MAV_STATE_CRITICAL), "emergency": int(mav.MAV_STATE_EMERGENCY)}
SENSORS: Final = {
    entry.name.removeprefix("MAV_SYS_STATUS_").removeprefix("SENSOR_"): number
    for number, entry in mav.enums["MAV_SYS_STATUS_SENSOR"].items()
    if not entry.name.endswith("ENUM_END")
}
"""Bits of SYS_STATUS by name, without the prefix MAV_SYS_STATUS_SENSOR_."""


def _known_sensors(names: tuple[str, ...]) -> tuple[str, ...]:
    for place, name in enumerate(names):
        if name not in SENSORS:
            raise refuse(Problem(str(place), name, "a sensor of SYS_STATUS such as 'GPS'", nearest(name, SENSORS)))
    return names


class FalseAlarm(TelemetryLinks):
    """The emergency that the aircraft seems to have."""

    state: Literal["critical", "emergency"] = Field(
        default="critical",
        description="Claimed MAV_STATE in HEARTBEAT; ArduPilot reports critical during a failsafe.",
    )
    sensors: Annotated[
        tuple[str, ...], BeforeValidator(items, json_schema_input_type=list[str]), AfterValidator(_known_sensors)
    ] = Field(
        default=("GPS", "AHRS"),
        description="Sensors that seem to have failed, named as in MAV_SYS_STATUS_SENSOR; may be empty.",
    )
    estimator: bool = Field(
        default=True, description="Whether the estimator seems to have lost its position, in EKF_STATUS_REPORT."
    )


@dataclass(slots=True)
class AlarmingReports:
    """Alters HEARTBEAT, SYS_STATUS and EKF_STATUS_REPORT."""

    state: int
    failed: int
    estimator: bool

    @property
    def messages(self) -> frozenset[int]:
        """Those that report failures."""
        return frozenset((_HEARTBEAT, _SYS_STATUS, _EKF) if self.estimator else (_HEARTBEAT, _SYS_STATUS))

    def alter(self, since_ns: Time, number: int, fields: Any) -> bool:
        """See `Alteration`."""
        if number == _HEARTBEAT:
            put(fields, "system_status", self.state)
        elif number == _SYS_STATUS:
            for name in ("onboard_control_sensors_present", "onboard_control_sensors_enabled"):
                put(fields, name, int(fields[name]) | self.failed)
            put(fields, "onboard_control_sensors_health", int(fields["onboard_control_sensors_health"]) & ~self.failed)
        else:
            put(fields, "flags", mav.EKF_ATTITUDE | mav.EKF_CONST_POS_MODE)
            for name in _VARIANCES:
                put(fields, name, max(float(fields[name]), _BAD_VARIANCE))
        return True


def make(params: FalseAlarm, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for links that the scenario does not have, or that carry no telemetry."""
    failed = 0
    for name in params.sensors:
        failed |= SENSORS[name]
    return alter_telemetry(params.links, context, AlarmingReports(_STATES[params.state], failed, params.estimator))


FALSE_ALARM = AttackPlugin(
    FalseAlarm,
    make,
    "Reports a failsafe, failed sensors and a lost estimator that the aircraft does not have.",
    technique="T0856",
    surface=("gcs", "log", "autopilot", "rid_data"),
    persists="acts",
    effect="Remote ID says emergency, and the aircraft's own avoidance stays off, as in a failsafe",
    threat=threat("the messages that report failures"),
    controls=CONTROLS,
)
