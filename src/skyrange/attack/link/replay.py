"""Replay on a link: recorded frames are put on it again later, in place of the true ones or beside them."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, Literal

from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.link.frame_taps import MAX_INJECTS, Rule, benign_payload, inject_again, rule_of
from skyrange.attack.on_path import EVERY_LINK, OnPath, TapMaker, place_taps
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.params import Number
from skyrange.contracts.verdicts import Drop, Inject, Verdict
from skyrange.core.time import NEVER, Time, from_seconds

MAX_FRAMES: Final = 100_000
"""Frames that the record of a link holds; the oldest are discarded."""
_DROP = (Drop(),)


class FrameReplay(OnPath):
    """Records the selected frames until the attack starts, and then plays the record with its own timing.

    Bytes are repeated as they are, so a signed frame is refused by a receiver that checks its timestamp.
    """

    direction: Literal["fwd", "rev", "both"] = Field(
        default="fwd", description="fwd: towards the aircraft on gcs, log and autopilot; rev: from it."
    )
    record_s: Number = Field(
        default=30.0,
        gt=0,
        le=3600,
        description="Length of the record in seconds: what passed within this time before the attack starts.",
    )
    loop: bool = Field(default=False, description="Whether the record is played again and again, without a pause.")
    drop_live: bool = Field(
        default=False,
        description="Whether the selected frames that pass meanwhile are dropped, so that receivers get the record "
        "alone.",
    )


@dataclass(slots=True)
class FrameReplayer:
    """A tap that records before its attack starts, and plays while it acts."""

    link: str
    rule: Rule
    record_ns: Time
    loop: bool
    drop_live: bool
    record: deque[tuple[Time, Inject]] = field(default_factory=lambda: deque(maxlen=MAX_FRAMES))
    """When each frame passed, and its copy; the oldest first."""
    played: int = 0
    """Number of copies put on the link."""
    woken_ns: Time = -NEVER

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Record the frame; later let it pass, or drop it."""
        rule = self.rule
        if now < rule.start_ns:
            if rule.selection.takes(frame):
                copy = inject_again(frame, benign_payload(frame.payload) if rule.sham else frame.payload)
                self.record.append((now, copy))
                self._discard_before(now - self.record_ns)
            return ()
        return _DROP if self.drop_live and rule.acts(now) and rule.selection.takes(frame) else ()

    def next_wakeup(self) -> Time | None:
        """When the next copy is due; `None` while the start of the attack is not known."""
        start = self.rule.start_ns
        if start == NEVER:
            return None
        if self.played == 0:
            self._discard_before(start - self.record_ns)
        due = self._due(start)
        return max(due, self.woken_ns + 1) if due is not None and due < self.rule.schedule.stop_ns else None

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """The copies that are due."""
        self.woken_ns = now
        made: list[Verdict] = []
        while len(made) < MAX_INJECTS:
            due = self._due(self.rule.start_ns)
            if due is None or due > now:
                break
            made.append(self.record[self.played % len(self.record)][1])
            self.played += 1
        return made

    def _due(self, start: Time) -> Time | None:
        """When the next copy is due; `None` at the end of the record."""
        count = len(self.record)
        if count == 0 or (self.played >= count and not self.loop):
            return None
        turn, place = divmod(self.played, count)
        return self.record[place][0] + (turn + 1) * self.record_ns

    def _discard_before(self, oldest: Time) -> None:
        while self.record and self.record[0][0] < oldest:
            self.record.popleft()


def make(params: FrameReplay, context: AttackContext) -> Attack:
    """The attack; its sham plays benign frames of the same length."""
    arguments = (rule_of(params, context), from_seconds(params.record_s), params.loop, params.drop_live)
    return Attack(taps=place_taps(params.links, context, TapMaker(FrameReplayer, arguments)))


REPLAY = AttackPlugin(
    FrameReplay,
    make,
    "Records frames of a link and puts them on it again later, once or in a loop.",
    technique="T0855",
    surface=EVERY_LINK,
    persists="mode",
    effect="an aircraft obeys commands of earlier, or a station sees a flight of earlier",
    threat=ThreatModel(
        knowledge="nothing of the protocol; it learns the frames that it records",
        position="on the path, such as a router between ground station and aircraft, already before the attack",
        equipment="a computer that forwards and records the frames",
        budget="one frame for each frame recorded, again in each turn of a loop",
    ),
    controls=Controls(
        load="the sham: benign frames of the same length at the same times",
        content="a replay of HEARTBEATs alone, which order nothing",
        placement="the same replay on another aircraft's link, or of the other direction",
    ),
)
