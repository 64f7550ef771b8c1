"""False mode in telemetry: mode, armed state and progress of the mission in an aircraft's reports."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal

from pydantic import AfterValidator, Field, model_validator

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin
from skyrange.attack.telemetry.alteration import CONTROLS, TelemetryLinks, alter_telemetry, put, threat
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.flight_modes import COPTER_MODE_NUMBERS
from skyrange.contracts.params import Number, refuse
from skyrange.core.errors import Problem, nearest
from skyrange.core.time import Time, from_seconds

_HEARTBEAT: Final = int(mav.MAVLINK_MSG_ID_HEARTBEAT)
_CURRENT: Final = int(mav.MAVLINK_MSG_ID_MISSION_CURRENT)
_LANDED: Final = int(mav.MAVLINK_MSG_ID_EXTENDED_SYS_STATE)
_ARMED: Final = int(mav.MAV_MODE_FLAG_SAFETY_ARMED)
_NO_TOTAL: Final = 65_535
"""MISSION_CURRENT: the number of items is not known."""


def _known_mode(name: str) -> str:
    if name not in COPTER_MODE_NUMBERS:
        raise refuse(Problem("", name, "a mode of ArduCopter such as 'AUTO'", nearest(name, COPTER_MODE_NUMBERS)))
    return name


ModeName = Annotated[str, AfterValidator(_known_mode)]
"""Name of a mode of ArduCopter."""


class FalseMode(TelemetryLinks):
    """Which mode, armed state and progress the aircraft seems to have."""

    mode: ModeName | None = Field(default=None, description="Claimed mode, such as 'AUTO'; default: the true one.")
    armed: bool | None = Field(default=None, description="Claimed armed state; default: the true one.")
    mission: Literal["true", "runs", "complete"] = Field(
        default="true",
        description="Claimed state of the mission. runs: active, at the item of the start of the attack and later "
        "ones; complete: at its last item and complete.",
    )
    item_s: Number = Field(
        default=10.0, ge=1, le=3600, description="Time from item to item with mission = 'runs', in seconds."
    )

    @model_validator(mode="after")
    def _claims_something(self) -> FalseMode:
        if self.mode is None and self.armed is None and self.mission == "true":
            raise refuse(Problem("mode", "missing", "a claim: mode, armed or mission"))
        return self


@dataclass(slots=True)
class ModeAlteration:
    """Alters HEARTBEAT, MISSION_CURRENT and EXTENDED_SYS_STATE."""

    mode: int | None
    armed: bool | None
    mission: str
    item_ns: Time
    item: int | None = None
    """The last true item before the start."""

    @property
    def messages(self) -> frozenset[int]:
        """Those that it alters."""
        heartbeat = self.mode is not None or self.armed is not None
        numbers = {_HEARTBEAT} if heartbeat else set()
        if self.armed is not None:
            numbers.add(_LANDED)
        if self.mission != "true":
            numbers.add(_CURRENT)
        return frozenset(numbers)

    def alter(self, since_ns: Time, number: int, fields: Any) -> bool:
        """See `Alteration`."""
        if number == _CURRENT:
            if since_ns < 0 or self.item is None:
                self.item = int(fields["seq"])
            if since_ns >= 0:
                self._set_mission(since_ns, fields)
        elif number == _HEARTBEAT:
            if self.mode is not None:
                put(fields, "custom_mode", self.mode)
            if self.armed is not None:
                base = int(fields["base_mode"])
                put(fields, "base_mode", base | _ARMED if self.armed else base & ~_ARMED)
                put(fields, "system_status", mav.MAV_STATE_ACTIVE if self.armed else mav.MAV_STATE_STANDBY)
        elif self.armed is not None:
            state = mav.MAV_LANDED_STATE_IN_AIR if self.armed else mav.MAV_LANDED_STATE_ON_GROUND
            put(fields, "landed_state", state)
        return True

    def _set_mission(self, since_ns: Time, fields: Any) -> None:
        last = int(fields["total"])  # items are numbered from 1, as ArduPilot's item 0 is home
        last = last if 0 < last < _NO_TOTAL else int(fields["seq"])
        if self.mission == "complete":
            put(fields, "seq", last)
            put(fields, "mission_state", mav.MISSION_STATE_COMPLETE)
            return
        assert self.item is not None
        put(fields, "seq", min(self.item + since_ns // self.item_ns, max(last, self.item)))
        put(fields, "mission_state", mav.MISSION_STATE_ACTIVE)


def make(params: FalseMode, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for links that the scenario does not have, or that carry no telemetry."""
    mode = None if params.mode is None else COPTER_MODE_NUMBERS[params.mode]
    alteration = ModeAlteration(mode, params.armed, params.mission, from_seconds(params.item_s))
    return alter_telemetry(params.links, context, alteration)


MODE = AttackPlugin(
    FalseMode,
    make,
    "Alters mode, armed state and progress of the mission in telemetry.",
    technique="T0856",
    surface=("gcs", "log", "autopilot", "rid_data"),
    persists="acts",
    effect="the ground station follows a flight that does not take place: it recalls, gives up or trusts the aircraft",
    threat=threat("the messages with mode and mission, and the numbers of the autopilot's modes"),
    controls=CONTROLS,
)
