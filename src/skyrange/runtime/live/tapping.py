"""What becomes of a link's frames while a program outside judges them? Held, numbered, released, written down.

No socket and no clock here: frames, answers and times come in, and what is to go on is collected. The tap stands at
the border of a node, beyond all taps of its kernel, where payloads leave for a socket or have come from one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from heapq import heappop, heappush
from typing import Any, Final, Literal, Protocol

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from skyrange.agent.frames import Fate, Frame
from skyrange.agent.links import LinkSpec
from skyrange.agent.messages import Note
from skyrange.agent.verdicts import Label
from skyrange.codec.deframe import Deframer
from skyrange.core.ids import FrameId
from skyrange.core.time import NEVER, NS_PER_MS, Time, to_seconds

NOTICED_NS: Final[Time] = 20 * NS_PER_MS
"""A frame that was kept for longer is labelled as delayed, whether that was said or not."""
MOST_HELD: Final = 10_000
"""Frames that may wait at once; what comes then is dealt with as if no program were there."""
Fail = Literal["open", "closed"]


class Record(Protocol):
    """Where what happens is written down, as an observer is told."""

    def on_frame(self, frame: Frame) -> None: ...  # noqa: D102
    def on_label(self, label: Label) -> None: ...  # noqa: D102
    def on_note(self, now: Time, source: str, note: Note) -> None: ...  # noqa: D102


class Terms(BaseModel):
    """How a link is tapped."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    link: str
    """Such as `gcs:blue/b1`."""
    name: str = Field(default="tap-process", pattern=r"^[A-Za-z0-9_-]{1,32}$")
    """What labels call it: the attack."""
    hold_ms: float = Field(default=200.0, ge=1.0, le=60_000.0)
    """So long a frame waits for its answer."""
    fail: Fail = "open"
    """A frame that gets no answer passes, or is dropped."""


class Answer(BaseModel):
    """What the program says, as one line of JSON."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    do: Literal["pass", "drop", "replace", "delay", "inject"]
    id: int | None = None
    """Of the frame that is judged; for "inject" the one that it is made of, if any."""
    payload: str | None = Field(default=None, pattern=r"^([0-9a-fA-F]{2})+$")
    """Of "replace" and "inject", in hexadecimal: one protocol unit."""
    delay_ms: float = Field(default=0.0, ge=0.0, le=600_000.0)
    """How long "delay" and "replace" keep it."""
    direction: Literal["fwd", "rev"] | None = None
    """Of "inject": from the link's first end to its second, or back."""


@dataclass(slots=True)
class Counts:
    """What has happened at a tap."""

    handed: int = 0
    """Frames handed to the program."""
    passed: int = 0
    dropped: int = 0
    replaced: int = 0
    delayed: int = 0
    injected: int = 0
    unanswered: int = 0
    """Frames that got no answer in time."""
    unasked: int = 0
    """Frames that came while no program was there, or too many waited."""
    strange: int = 0
    """Lines that were no answer."""


@dataclass(slots=True)
class _Held:
    frame: Frame
    outgoing: bool
    taken_ns: Time


@dataclass(slots=True)
class OutsideTap:
    """One link's tap. `outward` is the direction that leaves this node; `units`, whether payloads are MAVLink."""

    terms: Terms
    spec: LinkSpec
    side: str
    """The endpoint at whose socket it stands."""
    units: bool
    record: Record
    serials: dict[str, int] = field(default_factory=dict)
    """Of its own frames, by direction; goes on where an earlier tap of that name ended."""
    present: bool = False
    """Whether a program is there."""
    counts: Counts = field(default_factory=Counts)
    ready: list[tuple[Frame, bool]] = field(default_factory=list)
    """What is to go on, and whether it leaves this node."""
    _asked: dict[int, _Held] = field(default_factory=dict)
    _later: list[tuple[Time, int, _Held]] = field(default_factory=list)
    _numbers: int = 0
    _recent: dict[int, FrameId] = field(default_factory=dict)

    @property
    def outward(self) -> str:
        """The direction that leaves this node."""
        return "fwd" if self.spec.a == self.side else "rev"

    @property
    def name(self) -> str:
        """The tap's own endpoint, which is the true sender of what it puts on the link."""
        return f"{self.terms.name}@{self.spec.name}.{self.side.rpartition('.')[2]}"

    @property
    def due(self) -> Time:
        """When `turn` has something to do; `NEVER` where it waits for the program alone."""
        asked = next(iter(self._asked.values()), None)
        first = asked.taken_ns + self._hold_ns if asked is not None else NEVER
        return min(first, self._later[0][0] if self._later else NEVER)

    @property
    def _hold_ns(self) -> Time:
        return round(self.terms.hold_ms * NS_PER_MS)

    def take(self, now: Time, frame: Frame, outgoing: bool, *, deaf: bool = False) -> dict[str, Any] | None:
        """A frame is at the border: what to ask the program; `None` where it has been dealt with.

        A program that is `deaf`, as it does not read what it was asked before, is not asked.
        """
        held = _Held(frame, outgoing, now)
        if deaf or not self.present or len(self._asked) + len(self._later) >= MOST_HELD:
            self.counts.unasked += 1
            self._fail(now, held)
            return None
        self._numbers += 1
        self._asked[self._numbers] = held
        self._recent[self._numbers] = frame.id
        if len(self._recent) > MOST_HELD:
            del self._recent[next(iter(self._recent))]
        self.counts.handed += 1
        return {
            "id": self._numbers,
            "link": frame.link,
            "direction": frame.direction,
            "src": frame.src,
            "dst": frame.dst,
            "at_s": to_seconds(now),
            "payload": frame.payload.hex(),
        }

    def answer(self, now: Time, line: bytes) -> str:
        """The program has said `line`: what is wrong with it, "" for nothing. The frame waits on where it is wrong."""
        try:
            said = Answer.model_validate_json(line)
        except ValidationError as error:
            first = error.errors(include_url=False, include_input=False)[0]
            wrong = f"{'.'.join(map(str, first['loc'])) or 'line'}: {first['msg']}"
        else:
            wrong = self._inject(now, said) if said.do == "inject" else self._judge(now, said)
        self.counts.strange += bool(wrong)
        return wrong

    def turn(self, now: Time) -> None:
        """Deal with what has waited long enough."""
        while self._later and self._later[0][0] <= now:
            self._release(now, heappop(self._later)[2])
        while self._asked:
            number, held = next(iter(self._asked.items()))
            if held.taken_ns + self._hold_ns > now:
                return
            del self._asked[number]
            self.counts.unanswered += 1
            self._fail(now, held)

    def come(self, now: Time, there: bool) -> None:
        """A program has come, or has gone: what waits for its answer gets none."""
        if there == self.present:
            return
        self.present = there
        self.note(now, "came" if there else "went")
        asked, self._asked = self._asked, {}
        for held in asked.values():
            self.counts.unanswered += 1
            self._fail(now, held)

    def succeed(self, before: OutsideTap) -> None:
        """Take over what an earlier tap of the link still holds."""
        self.ready, before.ready = before.ready, []
        self._later, before._later = before._later, []

    def note(self, now: Time, what: str) -> None:
        """Write down that it was `attached`, or `detached`; that its program `came`, or `went`."""
        data = {"link": self.spec.name, "what": what, "fail": self.terms.fail}
        self.record.on_note(now, self.name, Note("event.tap", self.spec.name.partition(":")[2], data))

    def end(self, now: Time) -> None:
        """The run ends: what is held is under way for ever."""
        for held in [*self._asked.values(), *(held for _, _, held in self._later)]:
            self._delayed(now, held)
            self.record.on_frame(held.frame)
        for frame, _ in self.ready:
            self.record.on_frame(frame)
        self.ready.clear()
        self._asked.clear()
        self._later.clear()

    # ---------------------------------------------------------------- verdicts

    def _judge(self, now: Time, said: Answer) -> str:
        held = self._asked.get(said.id) if said.id is not None else None
        if held is None or said.id is None:
            return f"id: {said.id} waits for no answer"
        if said.direction is not None:
            return 'direction: only "inject" has one'
        if (said.payload is not None) != (said.do == "replace"):
            return f'payload: "{said.do}" {"needs one" if said.do == "replace" else "has none"}'
        if (said.do == "delay") > (said.delay_ms > 0) or (said.delay_ms > 0 and said.do in ("pass", "drop")):
            return f'delay_ms: not for "{said.do}"' if said.delay_ms else "delay_ms: more than 0"
        payload = self._unit(said.payload) if said.payload is not None else None
        if isinstance(payload, str):
            return payload
        del self._asked[said.id]
        if said.do == "drop":
            self._drop(now, held)
            return ""
        if payload is not None:
            self.counts.replaced += 1
            held = _Held(self._instead(now, held.frame, payload), held.outgoing, held.taken_ns)
        elif said.do == "pass":
            self.counts.passed += 1
        if said.delay_ms:
            heappush(self._later, (now + round(said.delay_ms * NS_PER_MS), said.id, held))
        else:
            self._release(now, held)
        return ""

    def _inject(self, now: Time, said: Answer) -> str:
        if said.payload is None or said.direction is None:
            return '"inject" needs a payload and a direction, "fwd" or "rev"'
        if said.delay_ms:
            return 'delay_ms: not for "inject"'
        payload = self._unit(said.payload)
        if isinstance(payload, str):
            return payload
        if len(self.ready) >= MOST_HELD:
            return "too much at once"
        src, dst = (self.spec.a, self.spec.b) if said.direction == "fwd" else (self.spec.b, self.spec.a)
        parent = self._recent.get(said.id) if said.id is not None else None
        frame = self._own(now, said.direction, src, dst, payload, parent)
        self.counts.injected += 1
        self._label(now, "inject", frame.id)
        self.ready.append((frame, said.direction == self.outward))
        return ""

    def _unit(self, payload: str) -> bytes | str:
        """The bytes, or what is wrong: a link carries one protocol unit at a time, as taps and agents see them."""
        data = bytes.fromhex(payload)
        if self.units:
            deframer = Deframer()
            found = [*deframer.feed(data), *deframer.finish()]
            if len(found) != 1:
                return f"payload: {len(found)} MAVLink frames or runs of garbage, one was expected"
        return data

    def _fail(self, now: Time, held: _Held) -> None:
        if self.terms.fail == "open":
            self._release(now, held)
        else:
            self._drop(now, held)

    def _release(self, now: Time, held: _Held) -> None:
        self._delayed(now, held)
        self.ready.append((held.frame, held.outgoing))

    def _drop(self, now: Time, held: _Held) -> None:
        self.counts.dropped += 1
        self._label(now, "drop", held.frame.id)
        held.frame.fate = Fate.DROPPED
        self.record.on_frame(held.frame)

    def _instead(self, now: Time, frame: Frame, payload: bytes) -> Frame:
        """Another frame in a frame's place."""
        child = self._own(now, frame.direction, frame.src, frame.dst, payload, frame.id)
        self._label(now, "replace", frame.id, child=child.id)
        frame.fate = Fate.REPLACED
        self.record.on_frame(frame)
        return child

    def _own(
        self, now: Time, direction: str, src: str, dst: str, payload: bytes, parent: FrameId | None = None
    ) -> Frame:
        serial = self.serials.get(direction, 0)
        self.serials[direction] = serial + 1
        return Frame(self.spec.name, direction, self.name, serial, src, dst, now, payload, parent)

    def _delayed(self, now: Time, held: _Held) -> None:
        if now - held.taken_ns > NOTICED_NS:
            self.counts.delayed += 1
            self._label(held.taken_ns, "delay", held.frame.id, until=now)

    def _label(
        self, at: Time, action: str, frame: FrameId, *, child: FrameId | None = None, until: Time | None = None
    ) -> None:
        self.record.on_label(Label(at, self.terms.name, self.name, action, frame, child, until))

    @property
    def hello(self) -> Mapping[str, Any]:
        """What the program is told first."""
        ends = {"fwd": [self.spec.a, self.spec.b], "rev": [self.spec.b, self.spec.a]}
        return {"tap": self.name, **self.terms.model_dump(), **ends}
