"""Eavesdropping on a link: what frames tell of aircraft and missions is recorded, and nothing is altered."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, TypeAlias

import skyrange.plugin as sky
from skyrange.attack.tapped_links import LEARNED
from skyrange.codec.mavlink import Message, decode, dialect, file_transfer, message_id, sender_system
from skyrange.codec.mavlink.file_transfer import Opcode
from skyrange.codec.mavlink.signing import is_signed
from skyrange.contracts.alerts import Scalar
from skyrange.core.errors import DecodeError
from skyrange.core.time import NEVER, Time

MAX_FACTS: Final = 10_000
"""Facts that the attacker keeps of one link; what is new beyond them is not kept, so a flood takes no memory."""

_NAMED_FILES: Final[Mapping[int, str]] = {
    Opcode.OPEN_FILE_RO: "read",
    Opcode.OPEN_FILE_WO: "write",
    Opcode.CREATE_FILE: "write",
    Opcode.REMOVE_FILE: "remove",
}
"""Requests of MAVLink FTP that name a file."""
Fact: TypeAlias = tuple[str, dict[str, Scalar]]
"""Which fact it is (such as parameter and name), and what it says."""


def _position(message: Message, system: int) -> Fact:
    where: dict[str, Scalar] = {"lat_deg": message.lat * 1e-7, "lon_deg": message.lon * 1e-7}
    return f"position|{system}", {**where, "alt_msl_m": message.alt * 1e-3}


def _heartbeat(message: Message, system: int) -> Fact:
    armed = bool(message.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)
    state: dict[str, Scalar] = {"type": message.type, "autopilot": message.autopilot}
    component: int = message.get_srcComponent()
    return f"system|{system}/{component}", {
        "component": component,
        **state,
        "mode": message.custom_mode,
        "armed": armed,
    }


def _home(message: Message, system: int) -> Fact:
    where: dict[str, Scalar] = {"lat_deg": message.latitude * 1e-7, "lon_deg": message.longitude * 1e-7}
    return f"home|{system}", {**where, "alt_msl_m": message.altitude * 1e-3}


def _mission_count(message: Message, system: int) -> Fact:
    return f"mission|{system}", {"items": message.count}


def _mission_item(message: Message, system: int) -> Fact:
    where: dict[str, Scalar] = {"lat_deg": message.x * 1e-7, "lon_deg": message.y * 1e-7, "alt_m": message.z}
    return f"mission_item|{message.seq}", {"seq": message.seq, "command": message.command, **where}


def _parameter(message: Message, system: int) -> Fact:
    return f"parameter|{message.param_id}", {"name": message.param_id, "value": message.param_value}


def _command(message: Message, system: int) -> Fact:
    return f"command|{message.command}", {"command": message.command, "target_system": message.target_system}


def _target(message: Message, system: int) -> Fact:
    where: dict[str, Scalar] = {"lat_deg": message.lat_int * 1e-7, "lon_deg": message.lon_int * 1e-7}
    return "target", {**where, "alt_m": message.alt}


def _file(message: Message, system: int) -> Fact | None:
    request = file_transfer.unpack(bytes(message.payload))
    operation = _NAMED_FILES.get(request.opcode)
    if operation is None:
        return None
    path = file_transfer.text_of(request)
    return f"file|{operation} {path}", {"operation": operation, "path": path, "target_system": message.target_system}


_READERS: Final[Mapping[int, Callable[[Any, int], Fact | None]]] = {
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
    dialect.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL: _file,
}
"""By message id: what a message tells."""
_POSITION: Final = int(dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)


@dataclass(slots=True)
class Overheard:
    """What one listener knows; a fact is news when it is learnt, and when it changes."""

    position_every_ns: Time
    """Shortest time between two positions of a vehicle."""
    facts: dict[str, dict[str, Scalar]] = field(default_factory=dict)
    """What it knows, by fact."""
    positions_due: dict[int | None, Time] = field(default_factory=dict)
    """By system id: when its position is news again."""
    signed: dict[int | None, bool] = field(default_factory=dict)
    """By system id: whether its last frame was signed."""

    def learn(self, now: Time, payload: bytes) -> list[dict[str, Scalar]]:
        """Read a frame. Returns what is news."""
        number = message_id(payload)
        if number is None:
            return []
        system = sender_system(payload)
        signed = is_signed(payload)
        news = []
        if self.signed.get(system) is not signed:
            self.signed[system] = signed
            news = self._keep(f"signing|{system}", {"signed": signed}, system)
        if number == _POSITION:
            if now < self.positions_due.get(system, -NEVER):
                return news
            self.positions_due[system] = now + self.position_every_ns
        reader = _READERS.get(number)
        return [*news, *self._read(payload, reader)] if reader is not None else news

    def _read(self, payload: bytes, reader: Callable[[Any, int], Fact | None]) -> list[dict[str, Scalar]]:
        try:
            message = decode(payload)
        except DecodeError:
            return []
        system: int = message.get_srcSystem()
        fact = reader(message, system)
        return [] if fact is None else self._keep(*fact, system)

    def _keep(self, fact: str, says: dict[str, Scalar], system: int | None) -> list[dict[str, Scalar]]:
        if self.facts.get(fact) == says or (fact not in self.facts and len(self.facts) >= MAX_FACTS):
            return []
        self.facts[fact] = says
        return [{"what": fact.partition("|")[0], "system": system, **says}]


@sky.attack(
    "link.eavesdrop",
    technique="T0842",
    counterfactual="mute",
    surface=("gcs", "log", "autopilot", "rid_data"),
    effect="nothing changes for its victims; the attacker knows positions, missions, parameters and system ids",
    knowledge="MAVLink, which is public",
    position="by place: on the path, or within range of both ends of a Wi-Fi link that is not encrypted",
    equipment="a computer that forwards or receives the frames",
    budget="none: it sends nothing",
    load="none, because it sends nothing",
    content="none, because it sends nothing; the sham notes nothing",
    placement="the same on a link whose frames are of another aircraft",
)
class Eavesdropping(sky.InAir, sky.OnPath):  # type: ignore[misc]  # more places than its base
    """Reads the frames of a link and records what they tell; it alters nothing.

    In the air it reads a frame if it decodes one of its transmissions, and the link is not encrypted or it has the key.
    A fact is noted when it is learnt, and when it changes.
    """

    position_every_s: sky.Number = sky.param("Least seconds between notes of a position.", default=5.0, gt=0, le=3600)
    known: Overheard

    def prepare(self, context: sky.AttackContext) -> None:
        self.known = Overheard(sky.from_seconds(self.position_every_s))

    def act(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        news, victim = self.known.learn(now, frame.payload), self.link.partition(":")[2]
        return [] if self.sham else [sky.Note(LEARNED, victim, data, (frame.id,)) for data in news]
