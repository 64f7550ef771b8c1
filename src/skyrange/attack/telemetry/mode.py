"""False mode in telemetry: mode, armed state and progress of the mission in an aircraft's reports."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final, Literal

from skyrange.attack.bases.mavlink.message_fields import put, put_bits
from skyrange.attack.bases.mavlink.params import CopterMode
from skyrange.attack.bases.mavlink.telemetry import AlteredTelemetry
from skyrange.attack.contract import AttackContext
from skyrange.attack.declaration import attack
from skyrange.attack.presets import TELEMETRY_CONTROLS, rewrites_telemetry
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.flight_modes import COPTER_MODE_NUMBERS
from skyrange.contracts.params import Number
from skyrange.contracts.plugins.fields import param
from skyrange.core.errors import Problem
from skyrange.core.time import Time, from_seconds

_NO_TOTAL: Final = 65_535
"""MISSION_CURRENT: the number of items is not known."""


@attack(
    "telemetry.mode",
    technique="T0856",
    surface=("gcs", "log", "autopilot", "rid_data"),
    persists="acts",
    effect="the ground station follows a flight that does not take place: it recalls, gives up or trusts the aircraft",
    threat=rewrites_telemetry("the messages with mode and mission, and the numbers of the autopilot's modes"),
    controls=TELEMETRY_CONTROLS,
)
class FalseMode(AlteredTelemetry):
    """Alters mode, armed state and progress of the mission in telemetry."""

    mode: CopterMode | None = param("Claimed mode, such as 'AUTO'; default: the true one.", default=None)
    armed: bool | None = param("Claimed armed state; default: the true one.", default=None)
    mission: Literal["true", "runs", "complete"] = param(
        "Claimed state of the mission. runs: active, at the item of the start of the attack and later ones; complete: "
        "at its last item and complete.",
        default="true",
    )
    item_s: Number = param("Time from item to item with mission = 'runs', in seconds.", default=10.0, ge=1, le=3600)
    item: int | None = None
    """The last true item before the start."""
    item_ns: Time

    def prepare(self, context: AttackContext) -> None:
        """Convert the time."""
        self.item_ns = from_seconds(self.item_s)

    def find_problems(self) -> Iterator[Problem]:
        """No claim."""
        if not any(self.find_messages()):
            yield Problem("mode", "missing", "a claim: mode, armed or mission")

    def find_messages(self) -> Iterator[str]:
        """Those that tell what is claimed."""
        if self.mode is not None or self.armed is not None:
            yield "HEARTBEAT"
        if self.armed is not None:
            yield "EXTENDED_SYS_STATE"
        if self.mission != "true":
            yield "MISSION_CURRENT"

    def learn(self, message: str, fields: Any) -> None:
        """Learn how far the mission is."""
        if message == "MISSION_CURRENT":
            self.item = int(fields["seq"])

    def alter(self, message: str, fields: Any, since_ns: Time) -> bool:
        """Claim mode, armed state or progress."""
        if message == "MISSION_CURRENT":
            self._claim_progress(fields, since_ns)
        elif message == "EXTENDED_SYS_STATE":
            put(fields, "landed_state", mav.MAV_LANDED_STATE_IN_AIR if self.armed else mav.MAV_LANDED_STATE_ON_GROUND)
        else:
            if self.mode is not None:
                put(fields, "custom_mode", COPTER_MODE_NUMBERS[self.mode])
            if self.armed is not None:
                put_bits(fields, "base_mode", mav.MAV_MODE_FLAG_SAFETY_ARMED, self.armed)
                put(fields, "system_status", mav.MAV_STATE_ACTIVE if self.armed else mav.MAV_STATE_STANDBY)
        return True

    def _claim_progress(self, fields: Any, since_ns: Time) -> None:
        true, last = int(fields["seq"]), int(fields["total"])  # from 1 on, as ArduPilot's item 0 is home
        last = last if 0 < last < _NO_TOTAL else true
        self.item = true if self.item is None else self.item
        runs = self.mission == "runs"
        item = min(self.item + since_ns // self.item_ns, max(last, self.item)) if runs else last
        put(fields, "seq", item)
        put(fields, "mission_state", mav.MISSION_STATE_ACTIVE if runs else mav.MISSION_STATE_COMPLETE)
