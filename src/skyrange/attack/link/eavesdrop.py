"""Eavesdropping on a link: what frames tell of aircraft and missions is recorded, and nothing is altered."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final, TypeAlias

import skyrange.plugin as sky
from skyrange.attack.tapped_links import LEARNED
from skyrange.codec.mavlink import decode, dialect, sender_system
from skyrange.codec.mavlink.signing import is_signed
from skyrange.contracts.scalars import Scalar

MAX_FACTS: Final = 10_000
"""Facts that the attacker keeps of one link; what is new beyond them is not kept, so a flood takes no memory."""

Fact: TypeAlias = tuple[str, dict[str, Scalar]]
"""Which fact it is (such as parameter and name), and what it says."""


def _position(message: sky.MavlinkMessage, system: int) -> Fact:
    where: dict[str, Scalar] = {"lat_deg": message.lat * 1e-7, "lon_deg": message.lon * 1e-7}
    return f"position|{system}", {**where, "alt_msl_m": message.alt * 1e-3}


def _heartbeat(message: sky.MavlinkMessage, system: int) -> Fact:
    armed = bool(message.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)
    state: dict[str, Scalar] = {"type": message.type, "autopilot": message.autopilot}
    component: int = message.get_srcComponent()
    return f"system|{system}/{component}", {
        "component": component,
        **state,
        "mode": message.custom_mode,
        "armed": armed,
    }


def _home(message: sky.MavlinkMessage, system: int) -> Fact:
    where: dict[str, Scalar] = {"lat_deg": message.latitude * 1e-7, "lon_deg": message.longitude * 1e-7}
    return f"home|{system}", {**where, "alt_msl_m": message.altitude * 1e-3}


def _mission_count(message: sky.MavlinkMessage, system: int) -> Fact:
    return f"mission|{system}", {"items": message.count}


def _mission_item(message: sky.MavlinkMessage, system: int) -> Fact:
    where: dict[str, Scalar] = {"lat_deg": message.x * 1e-7, "lon_deg": message.y * 1e-7, "alt_m": message.z}
    return f"mission_item|{message.seq}", {"seq": message.seq, "command": message.command, **where}


def _parameter(message: sky.MavlinkMessage, system: int) -> Fact:
    return f"parameter|{message.param_id}", {"name": message.param_id, "value": message.param_value}


def _command(message: sky.MavlinkMessage, system: int) -> Fact:
    return f"command|{message.command}", {"command": message.command, "target_system": message.target_system}


def _target(message: sky.MavlinkMessage, system: int) -> Fact:
    where: dict[str, Scalar] = {"lat_deg": message.lat_int * 1e-7, "lon_deg": message.lon_int * 1e-7}
    return "target", {**where, "alt_m": message.alt}


_READERS: Final[Mapping[int, Callable[[Any, int], Fact]]] = {
    dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: _position,
    dialect.MAVLINK_MSG_ID_HEARTBEAT: _heartbeat,
    dialect.MAVLINK_MSG_ID_HOME_POSITION: _home,
    dialect.MAVLINK_MSG_ID_MISSION_COUNT: _mission_count,
    dialect.MAVLINK_MSG_ID_MISSION_ITEM_INT: _mission_item,
    dialect.MAVLINK_MSG_ID_PARAM_VALUE: _parameter,
    dialect.MAVLINK_MSG_ID_PARAM_SET: _parameter,
    dialect.MAVLINK_MSG_ID_COMMAND_LONG: _command,
    dialect.MAVLINK_MSG_ID_COMMAND_INT: _command,
    dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT: _target,
}
"""By message id: what a message tells."""
_POSITION: Final = int(dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)


@sky.attack(
    "link.eavesdrop",
    technique="T0842",
    counterfactual="mute",
    surface=("gcs", "log", "autopilot", "rid_data"),
    effect="nothing changes for its victims; the attacker knows positions, missions, parameters and system ids",
    knowledge="MAVLink, which is public",
    position="on the path, or within range of a radio that is not encrypted",
    equipment="a computer that forwards or receives the frames",
    budget="none: it sends nothing",
    load="none, because it sends nothing",
    content="none, because it sends nothing; the sham notes nothing",
    placement="the same on a link whose frames are of another aircraft",
)
class Eavesdropping(sky.OnPath):
    """Reads the frames of a link and records what they tell; it alters nothing.

    A fact is noted when it is learnt, and when it changes.
    """

    position_every_s: sky.Number = sky.param(
        "Shortest time in seconds between two notes of a vehicle's position.", default=5.0, gt=0, le=3600
    )
    facts: dict[str, dict[str, Scalar]] = sky.state(dict)
    """What it knows, by fact."""
    positions_due: dict[int | None, sky.Time] = sky.state(dict)
    """By system id: when its position is noted again."""
    signed: dict[int | None, bool] = sky.state(dict)
    """By system id: whether its last frame was signed."""

    def act(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        payload = frame.payload
        number = sky.message_id(payload)
        if number is None:
            return ()
        system = sender_system(payload)
        signed = is_signed(payload)
        notes = []
        if self.signed.get(system) is not signed:
            self.signed[system] = signed
            notes = self._keep(frame, f"signing|{system}", {"signed": signed}, system)
        if number == _POSITION:
            if now < self.positions_due.get(system, -sky.NEVER):
                return notes
            self.positions_due[system] = now + sky.from_seconds(self.position_every_s)
        reader = _READERS.get(number)
        return [*notes, *self._learn(frame, reader)] if reader is not None else notes

    def _learn(self, frame: sky.Frame, reader: Callable[[Any, int], Fact]) -> list[sky.Note]:
        try:
            message = decode(frame.payload)
        except sky.DecodeError:
            return []
        system: int = message.get_srcSystem()
        return self._keep(frame, *reader(message, system), system)

    def _keep(self, frame: sky.Frame, fact: str, says: dict[str, Scalar], system: int | None) -> list[sky.Note]:
        if self.facts.get(fact) == says or (fact not in self.facts and len(self.facts) >= MAX_FACTS):
            return []
        self.facts[fact] = says
        if self.sham:
            return []
        data: dict[str, Scalar] = {"what": fact.partition("|")[0], "system": system, **says}
        return [sky.Note(LEARNED, self.link.partition(":")[2], data, (frame.id,))]
