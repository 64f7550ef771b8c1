"""Base of kinds that put frames of their own on links, in rounds."""

from __future__ import annotations

from typing import ClassVar

from skyrange.attack.bases.on_path import LinkTap
from skyrange.attack.contract import Place
from skyrange.attack.tapped_links import Repetition, ends_of
from skyrange.contracts.frames import Frame
from skyrange.contracts.verdicts import Direction, Inject, Verdicts
from skyrange.core.ids import FrameId
from skyrange.core.time import Time, from_seconds


class RoundsOnLink(LinkTap):
    """Puts frames on its links when it begins to act, and then every `every_s`: `send` makes those of a round.

    Frames that pass are let pass, unless a kind defines `on_frame`.
    """

    needs: ClassVar[tuple[str, ...]] = ()

    every_s: float = 0.0
    """Time between two rounds, in seconds: a parameter of the kind, or set in `prepare`; 0 for no rounds."""
    times: int = 0
    """Most rounds, 0 for any number: a parameter of some kinds."""
    way: Direction = "fwd"
    """The direction of its frames."""
    ends: tuple[str, str]
    """Claimed source and destination of its frames."""
    clock: Repetition
    """When it sends; `clock.done` numbers the rounds from 1."""

    def begin(self) -> None:
        """See `LinkTap`."""
        period_ns = self.period_ns()
        self.ends = ends_of(self.link, self.way)
        self.clock = Repetition(self.schedule, period_ns, self.times, due=0 if period_ns else None)

    def period_ns(self) -> Time:
        """Time between two rounds; 0 for no rounds."""
        return from_seconds(self.every_s)

    def marks(self) -> dict[str, Place]:
        """Places to mark on a map, by label."""
        return {}

    def on_frame(self, now: Time, frame: Frame) -> Verdicts:
        """Let it pass."""
        return ()

    def next_wakeup(self) -> Time | None:
        """When the next round is due."""
        return self.clock.due

    def on_wakeup(self, now: Time) -> Verdicts:
        """Send a round, if it is due."""
        return self.send(now) if self.clock.take(now) else ()

    def send(self, now: Time) -> Verdicts:
        """The frames of a round."""
        return ()

    def inject(self, payload: bytes, parent: FrameId | None = None) -> Inject:
        """A frame of its own; `parent` is the frame that it replays, if any."""
        return Inject(payload, self.way, *self.ends, parent)
