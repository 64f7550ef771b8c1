"""Duplication on a link: copies of selected frames arrive some time after them."""

from __future__ import annotations

from heapq import heappop, heappush

from skyrange.attack.bases.on_path import MAX_INJECTS, OnPath, inject_again
from skyrange.attack.bases.shams import benign_payload
from skyrange.attack.contract import AttackContext
from skyrange.attack.declaration import attack
from skyrange.attack.presets import benign_frames, on_path
from skyrange.attack.tapped_links import EVERY_LINK
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.params import Number, Whole
from skyrange.contracts.plugins.fields import param, state
from skyrange.contracts.verdicts import Inject, Verdict, Verdicts
from skyrange.core.time import NEVER, Time, from_seconds


@attack(
    "link.duplicate",
    technique="T0830",
    surface=EVERY_LINK,
    persists="mode",
    effect="receivers get frames a second time, and obey a command again that a later one replaced",
    threat=on_path(
        "nothing for all frames; the message ids to select some", budget="up to 10 frames for each frame copied"
    ),
    controls=benign_frames(
        content="copies after 1 ms, before the next frame changes what they mean",
        placement="the same copies on another aircraft's link, or of other messages",
    ),
)
class Duplication(OnPath):
    """Puts copies of selected frames on a link, some time after them."""

    after_s: Number = param(
        "Time in seconds from a frame to its copy, and from copy to copy.", default=0.5, ge=0.001, le=60
    )
    copies: Whole = param("Number of copies of a frame.", default=1, ge=1, le=10)
    probability: Number = param(
        "Probability that a selected frame is copied, more than 0 and at most 1.", default=1.0, gt=0, le=1
    )
    after_ns: Time
    waiting: list[tuple[Time, int, Inject]] = state(list)
    """A heap: when a copy is due, its number, and the copy."""
    made: int = 0
    woken_ns: Time = -NEVER

    def prepare(self, context: AttackContext) -> None:
        """Set the time from copy to copy."""
        self.after_ns = from_seconds(self.after_s)

    def act(self, now: Time, frame: Frame) -> Verdicts:
        """Let it pass, and keep copies."""
        if self.probability < 1.0 and self.draw(frame)[0] >= self.probability:
            return ()
        copy = inject_again(frame, benign_payload(frame.payload) if self.sham else frame.payload)
        for turn in range(1, self.copies + 1):
            heappush(self.waiting, (now + turn * self.after_ns, self.made, copy))
            self.made += 1
        return ()

    def next_wakeup(self) -> Time | None:
        """When the next copy is due."""
        return max(self.waiting[0][0], self.woken_ns + 1) if self.waiting else None

    def on_wakeup(self, now: Time) -> Verdicts:
        """The copies that are due."""
        self.woken_ns = now
        due: list[Verdict] = []
        while self.waiting and self.waiting[0][0] <= now and len(due) < MAX_INJECTS:
            due.append(heappop(self.waiting)[2])
        return due
