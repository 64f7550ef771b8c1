"""Duplication on a link: copies of selected frames arrive some time after them."""

from __future__ import annotations

from heapq import heappop, heappush

import skyrange.plugin as sky
from skyrange.attack.bases.on_path import MAX_INJECTS, inject_again
from skyrange.attack.bases.shams import benign_payload


@sky.attack(
    "link.duplicate",
    technique="T0830",
    persists="mode",
    effect="receivers get frames a second time, and obey a command again that a later one replaced",
    knowledge="nothing for all frames; the message ids to select some",
    budget="up to 10 frames for each frame copied",
    load="the sham: benign frames of the same length in place of the copies",
    content="copies after 1 ms, before the next frame changes what they mean",
    placement="the same copies on another aircraft's link, or of other messages",
)
class Duplication(sky.OnPath):
    """Puts copies of selected frames on a link, some time after them."""

    after_s: sky.Number = sky.param(
        "Time in seconds from a frame to its copy, and from copy to copy.", default=0.5, ge=0.001, le=60
    )
    copies: sky.Whole = sky.param("Number of copies of a frame.", default=1, ge=1, le=10)
    probability: sky.Number = sky.param(
        "Probability that a selected frame is copied, more than 0 and at most 1.", default=1.0, gt=0, le=1
    )
    after_ns: sky.Time
    waiting: list[tuple[sky.Time, int, sky.Inject]] = sky.state(list)
    """A heap: when a copy is due, its number, and the copy."""
    made: int = 0
    woken_ns: sky.Time = -sky.NEVER

    def prepare(self, context: sky.AttackContext) -> None:
        self.after_ns = sky.from_seconds(self.after_s)

    def act(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        if self.probability < 1.0 and self.draw(frame)[0] >= self.probability:
            return ()
        copy = inject_again(frame, benign_payload(frame.payload) if self.sham else frame.payload)
        for turn in range(1, self.copies + 1):
            heappush(self.waiting, (now + turn * self.after_ns, self.made, copy))
            self.made += 1
        return ()

    def next_wakeup(self) -> sky.Time | None:
        return max(self.waiting[0][0], self.woken_ns + 1) if self.waiting else None

    def on_wakeup(self, now: sky.Time) -> sky.Verdicts:
        self.woken_ns = now
        due: list[sky.Verdict] = []
        while self.waiting and self.waiting[0][0] <= now and len(due) < MAX_INJECTS:
            due.append(heappop(self.waiting)[2])
        return due
