"""Replay on a link: recorded frames are put on it again later, in place of the true ones or beside them."""

from __future__ import annotations

from functools import partial
from typing import Final, Literal

import skyrange.plugin as sky
from skyrange.attack.bases.links import WaitingFrames

MAX_FRAMES: Final = 100_000
"""Frames that the record of a link holds; the oldest are discarded."""


@sky.attack(
    "link.replay",
    technique="T0855",
    intrudes=True,
    persists="mode",
    effect="an aircraft obeys commands of earlier, or a station sees a flight of earlier",
    knowledge="nothing of the protocol; it learns the frames that it records",
    position="by place: on the path, or within range of both ends of a Wi-Fi link, already before the attack",
    equipment="a computer that forwards and records the frames",
    budget="one frame for each frame recorded, again in each turn of a loop",
    load="the sham: benign frames of the same length at the same times",
    content="a replay of HEARTBEATs alone, which order nothing",
    placement="the same replay on another aircraft's link, or of the other direction",
)
class FrameReplay(sky.InAir, sky.OnPath):  # type: ignore[misc]  # more places than its base
    """Records frames of a link and puts them on it again later, once or in a loop.

    It records the selected frames until the attack starts, and then plays the record with its own timing. Bytes are
    repeated as they are, so a signed frame is refused by a receiver that checks its timestamp.
    """

    direction: Literal["fwd", "rev", "both"] = sky.param(
        "fwd: towards the aircraft on gcs, log and autopilot; rev: from it.", default="fwd"
    )
    record_s: sky.Number = sky.param("Length of the record, in seconds before the start.", default=30.0, gt=0, le=3600)
    loop: bool = sky.param("Whether the record is played again and again, without a pause.", default=False)
    drop_live: bool = sky.param(
        "Whether selected frames that pass meanwhile are dropped: receivers get the record alone.", default=False
    )
    waiting_frames: WaitingFrames = sky.state(partial(WaitingFrames, MAX_FRAMES))
    """The record, due as long after each frame as the record lasts."""

    def find_problems(self) -> sky.Problems:
        if self.place == "air" and self.drop_live:
            yield sky.Problem("drop_live", "true", "false for place 'air': a radio beside the link holds no frame")

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        if now < self.schedule.start_ns and self.selects(frame):
            self.waiting_frames.add(now + sky.from_seconds(self.record_s), self.copy_of(frame))
            self.waiting_frames.discard_before(now)
        return super().on_frame(now, frame)

    def act(self, now: sky.Time, frame: sky.Frame) -> sky.Verdicts:
        return (sky.Drop(),) if self.drop_live else ()

    def next_wakeup(self) -> sky.Time | None:
        """When the next copy is due; `None` while the start of the attack is not known."""
        if self.schedule.start_ns == sky.NEVER:
            return None
        self.waiting_frames.discard_before(self.schedule.start_ns)
        due = super().next_wakeup()
        return due if due is not None and due < self.schedule.stop_ns else None

    def on_wakeup(self, now: sky.Time) -> sky.Verdicts:
        return self.waiting_frames.take(now, sky.from_seconds(self.record_s) if self.loop else 0)
