"""False mode in telemetry: mode, armed state and progress of the mission in an aircraft's reports."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, Literal

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.message_fields import put_bits
from skyrange.codec.mavlink import dialect as mav

_NO_TOTAL: Final = 65_535
"""MISSION_CURRENT: the number of items is not known."""


@sky.attack(
    "telemetry.mode",
    effect="the ground station follows a flight that does not take place: it recalls, gives up or trusts the aircraft",
    knowledge="the messages with mode and mission, and the numbers of the autopilot's modes",
)
class FalseMode(sky.AlteredTelemetry):
    """Alters mode, armed state and progress of the mission in telemetry."""

    mode: sky.CopterMode | None = sky.param("Claimed mode, such as 'AUTO'; default: the true one.", default=None)
    armed: bool | None = sky.param("Claimed armed state; default: the true one.", default=None)
    mission: Literal["true", "runs", "complete"] = sky.param(
        "Claimed mission. runs: active, at the item of the start and later ones; complete: done, at its last item.",
        default="true",
    )
    item_s: sky.Number = sky.param("Time from item to item of 'runs', in seconds.", default=10.0, ge=1, le=3600)
    item: int | None = None
    """The last true item before the start."""
    item_ns: sky.Time

    def prepare(self, context: sky.AttackContext) -> None:
        self.item_ns = sky.from_seconds(self.item_s)

    def find_problems(self) -> sky.Problems:
        if not any(self.find_messages()):
            yield sky.Problem("mode", "missing", "a claim: mode, armed or mission")

    def find_messages(self) -> Iterator[str]:
        if self.mode is not None or self.armed is not None:
            yield "HEARTBEAT"
        if self.armed is not None:
            yield "EXTENDED_SYS_STATE"
        if self.mission != "true":
            yield "MISSION_CURRENT"

    def learn(self, message: str, fields: sky.MavlinkFields) -> None:
        if message == "MISSION_CURRENT":
            self.item = int(fields["seq"])

    def alter(self, message: str, fields: sky.MavlinkFields, since_ns: sky.Time) -> bool:
        if message == "MISSION_CURRENT":
            self._claim_progress(fields, since_ns)
        elif message == "EXTENDED_SYS_STATE":
            sky.put(
                fields, "landed_state", mav.MAV_LANDED_STATE_IN_AIR if self.armed else mav.MAV_LANDED_STATE_ON_GROUND
            )
        else:
            if self.mode is not None:
                sky.put(fields, "custom_mode", sky.copter_mode(self.mode))
            if self.armed is not None:
                put_bits(fields, "base_mode", mav.MAV_MODE_FLAG_SAFETY_ARMED, value=self.armed)
                sky.put(fields, "system_status", mav.MAV_STATE_ACTIVE if self.armed else mav.MAV_STATE_STANDBY)
        return True

    def _claim_progress(self, fields: sky.MavlinkFields, since_ns: sky.Time) -> None:
        true, last = int(fields["seq"]), int(fields["total"])  # from 1 on, as ArduPilot's item 0 is home
        last = last if 0 < last < _NO_TOTAL else true
        self.item = true if self.item is None else self.item
        runs = self.mission == "runs"
        item = min(self.item + since_ns // self.item_ns, max(last, self.item)) if runs else last
        sky.put(fields, "seq", item)
        sky.put(fields, "mission_state", mav.MISSION_STATE_ACTIVE if runs else mav.MISSION_STATE_COMPLETE)
