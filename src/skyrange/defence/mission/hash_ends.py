"""Mission hashes at both ends of a link: messages, what the station sends, what the aircraft holds and verifies.

TUNNEL (https://mavlink.io/en/messages/common.html#TUNNEL) carries 128 bytes of a type that its users agree on; types
above 32767 are free for experiments.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from hmac import compare_digest
from hmac import new as new_hmac
from typing import Final, NamedTuple

from skyrange.attack.bases.mavlink.orders import read
from skyrange.attack.tapped_links import ends_of
from skyrange.codec.mavlink import Message, Packer, encode_payload, message_id, sender_system
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import Schedule
from skyrange.contracts.verdicts import Drop, Inject, Verdict
from skyrange.core.ids import FrameId
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.defence.bases.link_ends import STATION
from skyrange.defence.placement import Alarm, DefenceTap

PAYLOAD_TYPE: Final = 40_385
"""Payload type of these messages, in the range for experiments."""
COMPONENT: Final = int(mav.MAV_COMP_ID_TUNNEL_NODE)
"""Component id of both ends; a number sequence of its own leaves those of station and autopilot alone."""
TAG_BYTES: Final = 16
"""HMAC-SHA-256 truncated to 128 bits, half of its length as RFC 2104, section 5, recommends at least."""
FRAME_BYTES: Final = 16
"""Bytes of a frame's name, its truncated SHA-256."""
_PAYLOAD: Final = 128
_FORMAT: Final = struct.Struct("<BI16s16s16s")

SENT, ASKED, UNKNOWN = 1, 2, 3
"""Kinds: the station's end has sent that frame; the aircraft's end asks whether it did; it did not."""


class HashMessage(NamedTuple):
    """One message: its kind, the number of the upload or of the question, and the frame that it is about."""

    kind: int
    number: int
    frame: bytes
    upload: bytes = bytes(TAG_BYTES)
    """Of `SENT`: the keyed hash of the upload as far as that frame."""
    tag: bytes = bytes(TAG_BYTES)
    """The keyed hash of all before."""

    def sealed(self, key: bytes) -> HashMessage:
        """The same with its tag."""
        return self._replace(tag=make_tag(key, self.kind, self.number, self.frame, self.upload))

    def is_genuine(self, key: bytes) -> bool:
        """Whether its tag is right."""
        return compare_digest(make_tag(key, self.kind, self.number, self.frame, self.upload), self.tag)


def name_frame(payload: bytes) -> bytes:
    """The name of a frame: its SHA-256, truncated."""
    return sha256(payload).digest()[:FRAME_BYTES]


def derive_key(passphrase: str, vehicle: str) -> bytes:
    """The key of one aircraft (32 bytes): the HMAC-SHA-256 of its id under the passphrase."""
    return new_hmac(passphrase.encode(), vehicle.encode(), sha256).digest()


def make_tag(key: bytes, kind: int, number: int, *parts: bytes) -> bytes:
    """The keyed hash (`TAG_BYTES`) of a message of this kind and number about `parts`; each is told with its length."""
    covered = struct.pack("<BI", kind, number) + b"".join(struct.pack("<I", len(part)) + part for part in parts)
    return new_hmac(key, covered, sha256).digest()[:TAG_BYTES]


def pack_message(packer: Packer, target: int, message: HashMessage) -> bytes:
    """The TUNNEL frame of a message to system `target`."""
    body = _FORMAT.pack(*message)
    padded = list(body.ljust(_PAYLOAD, b"\0"))
    return packer.pack(mav.MAVLink_tunnel_message(target, COMPONENT, PAYLOAD_TYPE, len(body), padded))


def read_message(payload: bytes) -> HashMessage | None:
    """The message in a TUNNEL frame; `None` for every other frame."""
    message = read(payload)
    if message is None or message.get_msgId() != mav.MAVLINK_MSG_ID_TUNNEL or message.payload_type != PAYLOAD_TYPE:
        return None
    if message.payload_length != _FORMAT.size:
        return None
    return HashMessage(*_FORMAT.unpack(bytes(message.payload[: _FORMAT.size])))


WRITES: Final = frozenset((
    mav.MAVLINK_MSG_ID_MISSION_COUNT, mav.MAVLINK_MSG_ID_MISSION_ITEM_INT, mav.MAVLINK_MSG_ID_MISSION_ITEM,
    mav.MAVLINK_MSG_ID_MISSION_CLEAR_ALL, mav.MAVLINK_MSG_ID_MISSION_WRITE_PARTIAL_LIST,
))  # fmt: skip
"""Messages towards an aircraft that write what it stores."""
_ITEMS: Final = frozenset((mav.MAVLINK_MSG_ID_MISSION_ITEM_INT, mav.MAVLINK_MSG_ID_MISSION_ITEM))
_MOST_ITEMS: Final = 65_535
_MOST_HELD: Final = 64
"""Frames held at a time: a flood of forged ones fills no memory, and pushes out the oldest."""
_ASK_NS: Final = 100 * NS_PER_MS
"""How long a frame waits before its hash is asked for: several times the jitter of a cellular link."""
_KEPT_NS: Final = 10 * NS_PER_S
"""How long the station's end answers for a frame that it has sent: longer than an upload waits for an item (8 s,
MissionItemProtocol.h `upload_timeout_ms`)."""


class Step(NamedTuple):
    """What a frame that writes adds to an upload: its type of mission, its place, and what of it is hashed."""

    mission_type: int
    seq: int
    """Number of an item; -1 for a frame that begins an upload or clears."""
    content: bytes


def step_of(payload: bytes) -> Step | None:
    """What a frame writes; `None` for a malformed frame and for all that writes nothing."""
    message: Message | None = read(payload)
    if message is None or message.get_msgId() not in WRITES:
        return None
    number = message.get_msgId()
    content = number.to_bytes(3, "little") + encode_payload(message)
    return Step(message.mission_type, message.seq if number in _ITEMS else -1, content)


@dataclass(slots=True)
class Upload:
    """One upload as far as it has passed: its number, how it began, and its items in order."""

    number: int = 0
    first: bytes = b""
    items: list[bytes] = field(default_factory=list)

    def parts(self, step: Step) -> tuple[bytes, ...] | None:
        """What the hash of a further frame covers; `None` where an item does not follow those that it has."""
        kind = bytes((step.mission_type,))
        if step.seq < 0:
            return kind, step.content
        if step.seq > min(len(self.items), _MOST_ITEMS) or not self.first:
            return None
        return kind, self.first, *self.items[: step.seq], step.content

    def add(self, step: Step) -> None:
        """Count a frame in; an item that differs from the one at its place removes those behind it."""
        if step.seq < 0:
            self.first, self.items = step.content, []
        elif self.items[step.seq : step.seq + 1] != [step.content]:
            self.items[step.seq :] = [step.content]

    @property
    def complete(self) -> bool:
        """Whether all items that were announced are there; so is what announces none."""
        number, content = int.from_bytes(self.first[:3], "little"), self.first[3:]
        return number != mav.MAVLINK_MSG_ID_MISSION_COUNT or len(self.items) >= int.from_bytes(content[:2], "little")


@dataclass(slots=True)
class StationEnd(DefenceTap):
    """The station's end: sends the hash of each frame that writes, and answers for the frames of the last seconds."""

    key: bytes
    system: int
    packer: Packer
    uploads: dict[int, Upload] = field(default_factory=dict)
    """By type of mission."""
    number: int = 0
    """Number of the last upload of any type."""
    sent: dict[bytes, tuple[Time, HashMessage]] = field(default_factory=dict)
    """By the frame's name: when it left, and the message about it."""

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Send a hash ahead of a frame that writes; answer a question."""
        number = message_id(frame.payload)
        if frame.direction == "rev":
            return self._answer(now, frame.payload) if number == mav.MAVLINK_MSG_ID_TUNNEL else ()
        if number not in WRITES:
            return ()
        step = step_of(frame.payload)
        if step is None:
            return ()
        self.packer.system = sender_system(frame.payload) or STATION
        upload = self.uploads.setdefault(step.mission_type, Upload())
        if step.seq < 0 and (upload.items or upload.first != step.content):
            self.number += 1
            upload.number = self.number
        parts = upload.parts(step)
        if parts is None:
            return ()
        upload.add(step)
        name = name_frame(frame.payload)
        running = make_tag(self.key, SENT, upload.number, *parts)
        message = HashMessage(SENT, upload.number, name, running).sealed(self.key)
        self.sent = {name: (at, sent) for name, (at, sent) in self.sent.items() if now - at < _KEPT_NS}
        self.sent[name] = (now, message)
        return [self._say(message)]

    def _answer(self, now: Time, payload: bytes) -> Sequence[Verdict]:
        question = read_message(payload)
        if question is None:
            return ()
        if question.kind != ASKED or not question.is_genuine(self.key):
            return [Drop()]
        at, message = self.sent.get(question.frame, (-_KEPT_NS, question))
        if now - at >= _KEPT_NS:
            message = HashMessage(UNKNOWN, question.number, question.frame).sealed(self.key)
        return [Drop(), self._say(message)]

    def _say(self, message: HashMessage) -> Inject:
        return Inject(pack_message(self.packer, self.system, message), "fwd", *ends_of(self.link, "fwd"))


@dataclass(slots=True)
class _Held:
    """A frame that waits for its hash."""

    payload: bytes
    parent: FrameId
    came_ns: Time
    due_ns: Time
    question: int


@dataclass(slots=True)
class AircraftEnd(DefenceTap):
    """The aircraft's end: holds frames that write until their hash is right."""

    key: bytes
    system: int
    packer: Packer
    alarm: Alarm
    schedule: Schedule
    patience_ns: Time
    uploads: dict[int, Upload] = field(default_factory=dict)
    tags: dict[bytes, HashMessage] = field(default_factory=dict)
    """Messages of the station's end by the name of the frame that they are about."""
    held: dict[bytes, _Held] = field(default_factory=dict)
    questions: int = 0

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Hold a frame that writes, or let it pass; take messages of the station's end off the link."""
        if frame.direction == "rev" or not self.schedule.start_ns <= now < self.schedule.stop_ns:
            return ()
        number = message_id(frame.payload)
        if number == mav.MAVLINK_MSG_ID_TUNNEL:
            message = read_message(frame.payload)
            return () if message is None else [Drop(), *self._hear(now, message)]
        if number in WRITES:
            return self._verify(now, frame)
        if number in (mav.MAVLINK_MSG_ID_COMMAND_LONG, mav.MAVLINK_MSG_ID_COMMAND_INT, mav.MAVLINK_MSG_ID_SET_MODE):
            return self._guard(now, frame.payload)
        return ()

    def next_wakeup(self) -> Time | None:
        """When the next question is due."""
        return min((frame.due_ns for frame in self.held.values()), default=None)

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """Ask for the hashes that have not come; give up those that were asked for too long."""
        answer: list[Verdict] = []
        for name, frame in list(self.held.items()):
            if frame.due_ns > now:
                continue
            if now - frame.came_ns >= self.patience_ns:
                del self.held[name]
                answer += self.alarm.raise_at(now, "mission.unanswered", 1.0, what=_describe(frame.payload))
                continue
            frame.due_ns = now + NS_PER_S
            question = HashMessage(ASKED, frame.question, name).sealed(self.key)
            payload = pack_message(self.packer, self.packer.system, question)
            answer.append(Inject(payload, "rev", *ends_of(self.link, "rev")))
        return answer

    def _verify(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        name = name_frame(frame.payload)
        step = step_of(frame.payload)
        if step is None:
            return [Drop(), *self.alarm.raise_at(now, "mission.malformed", 1.0)]
        message = self.tags.get(name)
        if message is not None:
            return () if self._accept(step, message) else [Drop(), *self._report(now, frame.payload, step, message)]
        self.questions += 1
        while len(self.held) >= _MOST_HELD:
            del self.held[next(iter(self.held))]
        self.held[name] = _Held(frame.payload, frame.id, now, now + _ASK_NS, self.questions)
        return [Drop()]

    def _hear(self, now: Time, message: HashMessage) -> Sequence[Verdict]:
        if not message.is_genuine(self.key):
            return self.alarm.raise_at(now, "mission.forged", 1.0, what="TUNNEL with a wrong hash")
        held = self.held.get(message.frame)
        if message.kind == SENT:
            self.tags.pop(message.frame, None)
            self.tags[message.frame] = message
            while len(self.tags) > _MOST_HELD:
                del self.tags[next(iter(self.tags))]
            step = None if held is None else step_of(held.payload)
            if held is None or step is None:
                return ()
            del self.held[message.frame]
            if not self._accept(step, message):
                return self._report(now, held.payload, step, message)
            return [Inject(held.payload, "fwd", *ends_of(self.link, "fwd"), held.parent)]
        if held is None or message.kind != UNKNOWN or message.number != held.question:
            return ()
        del self.held[message.frame]
        return self.alarm.raise_at(now, "mission.forged", 1.0, what=_describe(held.payload))

    def _accept(self, step: Step, message: HashMessage) -> bool:
        """Whether the hash is right for a frame at this place; counts the frame in."""
        upload = self.uploads.setdefault(step.mission_type, Upload())
        if step.seq < 0:
            newest = max(known.number for known in self.uploads.values())
            again = message.number == upload.number and not upload.items and upload.first == step.content
            fits = message.number > newest or again
        else:
            fits = message.number == upload.number
        parts = upload.parts(step) if fits else None
        if parts is None or not compare_digest(make_tag(self.key, SENT, message.number, *parts), message.upload):
            return False
        upload.number = message.number
        upload.add(step)
        return True

    def _report(self, now: Time, payload: bytes, step: Step, message: HashMessage) -> Sequence[Verdict]:
        """An alarm for a frame of the station at a wrong place; none for one that merely comes late."""
        if step.seq < 0 or message.number < self.uploads[step.mission_type].number:
            return ()
        return self.alarm.raise_at(now, "mission.hash", 1.0, what=_describe(payload))

    def _guard(self, now: Time, payload: bytes) -> Sequence[Verdict]:
        """Drop what starts a mission of which a part has not come."""
        upload = self.uploads.get(mav.MAV_MISSION_TYPE_MISSION)
        if upload is None or upload.complete or not _starts_mission(payload):
            return ()
        return [Drop(), *self.alarm.raise_at(now, "mission.incomplete", 1.0, what="start of an incomplete mission")]


def _starts_mission(payload: bytes) -> bool:
    message = read(payload)
    if message is None:
        return False
    if message.get_msgId() == mav.MAVLINK_MSG_ID_SET_MODE:
        return bool(message.custom_mode == mav.COPTER_MODE_AUTO)
    if message.command == mav.MAV_CMD_DO_SET_MODE:
        return bool(message.param2 == mav.COPTER_MODE_AUTO)
    return bool(message.command == mav.MAV_CMD_MISSION_START)


def _describe(payload: bytes) -> str:
    message = read(payload)
    if message is None:
        return "no MAVLink message"
    seq = getattr(message, "seq", None)
    return str(message.get_type()) + ("" if seq is None else f" {seq}")
