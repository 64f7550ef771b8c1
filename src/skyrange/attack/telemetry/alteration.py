"""Taps that alter telemetry: fields of valid MAVLink 2 frames of an aircraft's autopilot, with a checksum that fits.

Where a tap is decides who is deceived. On `autopilot` it is all receivers, on `log` and `gcs` the ground station, on
`rid_data` the companion computer: its Remote ID broadcasts and its avoidance. A tap of the attacker has no key: a
signed frame keeps its signature, which no longer fits, so receivers with a key refuse it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from fnmatch import fnmatchcase
from math import isfinite
from typing import Annotated, Any, Final, Protocol

import numpy as np
from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, Controls, ThreatModel
from skyrange.attack.exclusive import Exclusive
from skyrange.attack.on_path import Names, side_of
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink import message_id
from skyrange.codec.mavlink.frame_layout import CHECKSUM, HEADER_V2, LAYOUTS, MAGIC_V2, SIGNATURE, SIGNED, checksum
from skyrange.codec.mavlink.message_columns import payload_dtype
from skyrange.contracts.components import Tap
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.links import Schedule, TapPlacement
from skyrange.contracts.params import Params
from skyrange.contracts.verdicts import Direction, Replace, Verdict
from skyrange.core.errors import InputError, nearest
from skyrange.core.ids import link_name
from skyrange.core.time import Time

FROM_AIRCRAFT: Final[Mapping[str, Direction]] = {"gcs": "rev", "log": "rev", "autopilot": "rev", "rid_data": "fwd"}
"""By role of a link that carries telemetry: the direction in which it does."""
_AUTOPILOT: Final = int(mav.MAV_COMP_ID_AUTOPILOT1)


class TelemetryLinks(Params):
    """The links on which telemetry is altered."""

    links: Annotated[Names, Field(min_length=1)] = Field(
        description="Links by name or pattern, such as ['gcs:blue/b1']. gcs and log: the ground station is deceived; "
        "rid_data: Remote ID broadcasts and avoidance on board; autopilot: all of them."
    )


class Alteration(Protocol):
    """Alters messages of one aircraft on one link. It can be deep-copied and holds no reference to others' state."""

    @property
    def messages(self) -> frozenset[int]:
        """Ids of the messages that it sees."""
        ...

    def alter(self, since_ns: Time, number: int, fields: Any) -> bool:
        """Write into the fields of a message, named as in MAVLink; returns whether it is one to replace.

        `since_ns` counts from the start of the attack. Before the start it is negative, and what is written is not
        sent: an alteration learns from the messages then.
        """
        ...


def read_fields(payload: bytes, number: int) -> Any:
    """The fields of a whole MAVLink 2 frame with a correct checksum, as a writable record; `None` for anything else."""
    layout = LAYOUTS.get(number)
    if layout is None or len(payload) < HEADER_V2 + CHECKSUM or payload[0] != MAGIC_V2 or payload[2] & ~SIGNED:
        return None
    end = HEADER_V2 + payload[1]
    if len(payload) != end + CHECKSUM + (SIGNATURE if payload[2] else 0):
        return None
    crc = payload[end : end + CHECKSUM] if end + CHECKSUM <= len(payload) else b""
    if int.from_bytes(crc, "little") != checksum(payload[1:end], layout.crc_extra):
        return None
    body = bytearray(payload[HEADER_V2:end][: layout.size].ljust(layout.size, b"\0"))
    return np.frombuffer(body, dtype=payload_dtype(number))[0]


def write_fields(payload: bytes, number: int, fields: Any, length: int = 0) -> bytes:
    """The frame with other fields: trailing zeros cut, but not below `length` bytes; a signed one keeps its length.

    Sequence number and signature stay.
    """
    whole: bytes = fields.tobytes()
    size = payload[1] if payload[2] else max(len(whole.rstrip(b"\0")), length, 1)
    end = HEADER_V2 + payload[1]
    covered = bytes([size]) + payload[2:HEADER_V2] + whole[:size].ljust(size, b"\0")
    crc = checksum(covered, LAYOUTS[number].crc_extra).to_bytes(CHECKSUM, "little")
    return payload[:1] + covered + crc + payload[end + CHECKSUM :]


def put(fields: Any, name: str, value: float) -> None:
    """Set a field of a record; an integer is rounded and clipped to its range, and not set to NaN or infinity."""
    kind = fields.dtype[name]
    if kind.kind in "iu":
        if not isfinite(value):
            return
        limits = np.iinfo(kind)
        value = min(max(round(value), int(limits.min)), int(limits.max))
    fields[name] = value


@dataclass(slots=True)
class AlteringTap:
    """Replaces the messages of one autopilot by altered ones; the sham by themselves, with as many bytes."""

    direction: Direction
    system: int
    alteration: Alteration
    schedule: Schedule
    sham: bool

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Alter it, or let it pass."""
        if frame.direction != self.direction:
            return ()
        payload = frame.payload
        number = message_id(payload)
        if number is None or number not in self.alteration.messages:
            return ()
        fields = read_fields(payload, number)
        if fields is None or payload[5] != self.system or payload[6] != _AUTOPILOT:
            return ()
        true = fields.copy()
        since_ns = now - self.schedule.start_ns
        if not self.alteration.alter(since_ns, number, fields) or since_ns < 0:
            return ()
        length = max(len(true.tobytes().rstrip(b"\0")), len(fields.tobytes().rstrip(b"\0")))
        return [Replace(write_fields(payload, number, true if self.sham else fields, length))]

    def next_wakeup(self) -> Time | None:
        """It acts on frames alone."""
        return None

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """It acts on frames alone."""
        return ()


@dataclass(frozen=True, slots=True)
class _MakeTap:
    """Makes the tap of a link, with an alteration of its own."""

    systems: Mapping[str, int]
    alteration: Alteration
    schedule: Schedule
    sham: bool

    def __call__(self, link: str) -> Tap:
        role, _, vehicle = link.partition(":")
        return AlteringTap(
            FROM_AIRCRAFT[role], self.systems[vehicle], deepcopy(self.alteration), self.schedule, self.sham
        )


_CHAINS: Final = (("autopilot", "log"), ("autopilot", "gcs"), ("autopilot", "rid_data"), ("log", "gcs"))
"""Roles of links that one frame of an aircraft passes, one after the other."""


def telemetry_links(patterns: Sequence[str], context: AttackContext, roles: Sequence[str]) -> list[str]:
    """The links that match, each once.

    Raises `InputError` for a pattern without a link, and for a link of another role than `roles`.
    """
    chosen = []
    for place, pattern in enumerate(patterns):
        found = [name for name in context.links if fnmatchcase(name, pattern)]
        wrong = [name for name in found if name.partition(":")[0] not in roles]
        if not found or wrong:
            usable = [name for name in context.links if name.partition(":")[0] in roles]
            expected = f"a link of the scenario: {', '.join(roles)}"
            raise InputError.one(
                context.id, f"links.{place}", wrong[0] if wrong else pattern, expected, nearest(pattern, usable)
            )
        chosen += found
    return list(dict.fromkeys(chosen))


def alter_telemetry(patterns: Sequence[str], context: AttackContext, alteration: Alteration) -> Attack:
    """The attack by a tap with a copy of the alteration on each link that matches.

    Raises `InputError` as `telemetry_links` does, and for two links that the same frame passes: it would be altered
    twice.
    """
    systems = {name: aircraft.system_id for name, aircraft in context.vehicles.items()}
    make = _MakeTap(systems, alteration, context.schedule, context.sham)
    links = telemetry_links(patterns, context, list(FROM_AIRCRAFT))
    for first, later in _CHAINS:
        for name in links:
            role, _, vehicle = name.partition(":")
            second = link_name(later, vehicle)
            if role == first and second in links:
                expected = f"{name} or {second}, not both"
                raise InputError.one(context.id, "links", f"{name}, {second}", expected, "One frame passes both.")
    return Attack(
        taps=[TapPlacement(name, side_of(name), make) for name in links],
        exclusive=[
            exclusive_messages(name, FROM_AIRCRAFT[name.partition(":")[0]], alteration.messages) for name in links
        ],
    )


def exclusive_messages(link: str, direction: Direction, numbers: Collection[int]) -> Exclusive:
    """Messages of one direction of a link, by number, as something that one attack alone may alter."""
    return Exclusive(f"{link} ({direction})", frozenset(mav.mavlink_map[number].msgname for number in numbers))


def threat(knowledge: str) -> ThreatModel:
    """The threat model of an on-path attacker who alters telemetry."""
    return ThreatModel(
        knowledge=knowledge,
        position="on the path between autopilot and receiver: a router, the companion computer or its proxy",
        equipment="a computer that decodes and rewrites MAVLink frames",
        budget="no frames of its own; each altered frame is at most some bytes longer",
    )


CONTROLS: Final = Controls(
    load="the sham: the same frames are replaced by themselves, with as many bytes",
    content="none, because the sham has the true content",
    placement="the same alteration on another link: rid_data instead of gcs",
)
"""Controls of an alteration of telemetry."""
