"""External tap: holds a link's frames while a program outside the range decides on them, and records what it does.

No socket and no clock here: frames, verdicts and times come in, and what is to go on is collected. The tap stands at
the border of a node, beyond all taps of its kernel, where payloads leave for a socket or have come from one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from heapq import heappop, heappush
from typing import Any, Final, Literal, Protocol

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from skyrange.codec.mavlink.deframer import Deframer
from skyrange.contracts.frames import Fate, Frame, end_journey
from skyrange.contracts.links import LinkEnds
from skyrange.contracts.mailboxes import Note
from skyrange.contracts.verdicts import Label
from skyrange.core.ids import FrameId
from skyrange.core.time import NEVER, NS_PER_MS, Time, to_seconds

NOTICED_NS: Final[Time] = 20 * NS_PER_MS
"""A frame that was held for longer is labelled as delayed, whether the program asked for that or not."""
MAX_HELD: Final = 10_000
"""Frames that may wait at once; what comes then is dealt with as if no program were there."""
Fail = Literal["open", "closed"]


class Record(Protocol):
    """An observer, as far as a tap needs one."""

    def on_frame(self, frame: Frame) -> None: ...  # noqa: D102
    def on_label(self, label: Label) -> None: ...  # noqa: D102
    def on_note(self, now: Time, source: str, note: Note) -> None: ...  # noqa: D102


class TapTerms(BaseModel):
    """Terms on which a link is tapped."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    link: str
    """Such as `gcs:blue/b1`."""
    name: str = Field(default="tap-process", pattern=r"^[A-Za-z0-9_-]{1,32}$")
    """The attack's name in labels."""
    hold_ms: float = Field(default=200.0, ge=1.0, le=60_000.0)
    """How long a frame waits for its verdict."""
    fail: Fail = "open"
    """Whether a frame that gets no verdict passes ("open") or is dropped ("closed")."""


class TapVerdict(BaseModel):
    """The program's decision on a frame, as one line of JSON."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    do: Literal["pass", "drop", "replace", "delay", "inject"]
    id: int | None = None
    """Of the frame that it decides on; for "inject" the one that it is made of, if any."""
    payload: str | None = Field(default=None, pattern=r"^([0-9a-fA-F]{2})+$")
    """Of "replace" and "inject", in hexadecimal: one protocol unit."""
    delay_ms: float = Field(default=0.0, ge=0.0, le=600_000.0)
    """How long "delay" and "replace" hold it."""
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
    """Frames that got no verdict in time."""
    unasked: int = 0
    """Frames that came while no program was there, or too many waited."""
    strange: int = 0
    """Lines that were no verdict."""


@dataclass(slots=True)
class _Held:
    frame: Frame
    outgoing: bool
    taken_ns: Time


@dataclass(slots=True)
class ExternalTap:
    """One link's tap. `mavlink` tells whether payloads are MAVLink."""

    terms: TapTerms
    spec: LinkEnds
    side: str
    """The endpoint at whose socket it stands."""
    mavlink: bool
    record: Record
    serials: dict[str, int] = field(default_factory=dict)
    """Next serials of its own frames, by direction; continue where an earlier tap of that name ended."""
    present: bool = False
    """Whether a program is there."""
    counts: Counts = field(default_factory=Counts)
    ready: list[tuple[Frame, bool]] = field(default_factory=list)
    """Frames that go on, and whether each leaves this node."""
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
        oldest = next(iter(self._asked.values()), None)
        first = oldest.taken_ns + self._hold_ns if oldest is not None else NEVER
        return min(first, self._later[0][0] if self._later else NEVER)

    @property
    def _hold_ns(self) -> Time:
        return round(self.terms.hold_ms * NS_PER_MS)

    def take(self, now: Time, frame: Frame, *, outgoing: bool, deaf: bool = False) -> dict[str, Any] | None:
        """Take a frame at the border; what to ask the program, `None` where the frame has been dealt with.

        A program that is `deaf`, as it does not read what it was asked before, is not asked.
        """
        held = _Held(frame, outgoing, now)
        if deaf or not self.present or len(self._asked) + len(self._later) >= MAX_HELD:
            self.counts.unasked += 1
            self._fail(now, held)
            return None
        self._numbers += 1
        self._asked[self._numbers] = held
        self._recent[self._numbers] = frame.id
        if len(self._recent) > MAX_HELD:
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
        """Act on the program's verdict `line`; what is wrong with it, "" for nothing. If so the frame waits on."""
        try:
            verdict = TapVerdict.model_validate_json(line)
        except ValidationError as error:
            first = error.errors(include_url=False, include_input=False)[0]
            wrong = f"{'.'.join(map(str, first['loc'])) or 'line'}: {first['msg']}"
        else:
            wrong = self._inject(now, verdict) if verdict.do == "inject" else self._decide(now, verdict)
        self.counts.strange += bool(wrong)
        return wrong

    def turn(self, now: Time) -> None:
        """Deal with the frames that have waited long enough."""
        while self._later and self._later[0][0] <= now:
            self._release(now, heappop(self._later)[2])
        while self._asked:
            number, held = next(iter(self._asked.items()))
            if held.taken_ns + self._hold_ns > now:
                return
            del self._asked[number]
            self.counts.unanswered += 1
            self._fail(now, held)

    def set_present(self, now: Time, *, there: bool) -> None:
        """Set whether a program is there: when it comes or goes, what waits for its verdict gets none."""
        if there == self.present:
            return
        self.present = there
        self.note(now, "came" if there else "went")
        waiting, self._asked = self._asked, {}
        for held in waiting.values():
            self.counts.unanswered += 1
            self._fail(now, held)

    def succeed(self, before: ExternalTap) -> None:
        """Take over the frames that an earlier tap of the link still holds."""
        self.ready, before.ready = before.ready, []
        self._later, before._later = before._later, []

    def note(self, now: Time, what: str) -> None:
        """Record that it was `attached`, or `detached`; that its program `came`, or `went`."""
        data = {"link": self.spec.name, "what": what, "fail": self.terms.fail}
        self.record.on_note(now, self.name, Note("event.tap", self.spec.name.partition(":")[2], data))

    def end(self, now: Time) -> None:
        """Record what is still held as in flight: the run ends."""
        for held in [*self._asked.values(), *(held for _, _, held in self._later)]:
            self._delayed(now, held)
            self.record.on_frame(held.frame)
        for frame, _ in self.ready:
            self.record.on_frame(frame)
        self.ready.clear()
        self._asked.clear()
        self._later.clear()

    # ---------------------------------------------------------------- verdicts

    def _decide(self, now: Time, verdict: TapVerdict) -> str:
        held = self._asked.get(verdict.id) if verdict.id is not None else None
        if held is None or verdict.id is None:
            return f"id: {verdict.id} waits for no answer"
        if verdict.direction is not None:
            return 'direction: only "inject" has one'
        if (verdict.payload is not None) != (verdict.do == "replace"):
            return f'payload: "{verdict.do}" {"needs one" if verdict.do == "replace" else "has none"}'
        if (verdict.do == "delay") > (verdict.delay_ms > 0) or (
            verdict.delay_ms > 0 and verdict.do in ("pass", "drop")
        ):
            return f'delay_ms: not for "{verdict.do}"' if verdict.delay_ms else "delay_ms: more than 0"
        payload = self._unit(verdict.payload) if verdict.payload is not None else None
        if isinstance(payload, str):
            return payload
        del self._asked[verdict.id]
        if verdict.do == "drop":
            self._drop(now, held)
            return ""
        if payload is not None:
            self.counts.replaced += 1
            held = _Held(self._instead(now, held.frame, payload), held.outgoing, held.taken_ns)
        elif verdict.do == "pass":
            self.counts.passed += 1
        if verdict.delay_ms:
            heappush(self._later, (now + round(verdict.delay_ms * NS_PER_MS), verdict.id, held))
        else:
            self._release(now, held)
        return ""

    def _inject(self, now: Time, verdict: TapVerdict) -> str:
        if verdict.payload is None or verdict.direction is None:
            return '"inject" needs a payload and a direction, "fwd" or "rev"'
        if verdict.delay_ms:
            return 'delay_ms: not for "inject"'
        payload = self._unit(verdict.payload)
        if isinstance(payload, str):
            return payload
        if len(self.ready) >= MAX_HELD:
            return "too much at once"
        src, dst = (self.spec.a, self.spec.b) if verdict.direction == "fwd" else (self.spec.b, self.spec.a)
        parent = self._recent.get(verdict.id) if verdict.id is not None else None
        frame = self._own(now, verdict.direction, src, dst, payload, parent)
        self.counts.injected += 1
        self._label(now, "inject", frame.id)
        self.ready.append((frame, verdict.direction == self.outward))
        return ""

    def _unit(self, payload: str) -> bytes | str:
        """The bytes, or what is wrong: a link carries one protocol unit at a time, as taps and agents see it."""
        data = bytes.fromhex(payload)
        if self.mavlink:
            deframer = Deframer()
            pieces = [*deframer.feed(data), *deframer.finish()]
            if len(pieces) != 1:
                return f"payload: {len(pieces)} MAVLink frames or runs of garbage, one was expected"
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
        end_journey(held.frame, Fate.DROPPED)
        self.record.on_frame(held.frame)

    def _instead(self, now: Time, frame: Frame, payload: bytes) -> Frame:
        """Another frame in the place of `frame`."""
        child = self._own(now, frame.direction, frame.src, frame.dst, payload, frame.id)
        self._label(now, "replace", frame.id, child=child.id)
        end_journey(frame, Fate.REPLACED)
        self.record.on_frame(frame)
        return child

    def _own(
        self, now: Time, direction: str, src: str, dst: str, payload: bytes, parent: FrameId | None = None
    ) -> Frame:
        serial = self.serials.get(direction, 0)
        self.serials[direction] = serial + 1
        return Frame(
            self.spec.name, direction, self.name, serial, src, dst, sent_ns=now, payload=payload, parent=parent
        )

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
        """The first message to the program."""
        ends = {"fwd": [self.spec.a, self.spec.b], "rev": [self.spec.b, self.spec.a]}
        return {"tap": self.name, **self.terms.model_dump(), **ends}
