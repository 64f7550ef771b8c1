"""Observer that keeps a run in memory, in lists, for tests and notebooks."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from typing import Any, NamedTuple

import numpy as np

from skyrange.contracts.alerts import Alert
from skyrange.contracts.components import World
from skyrange.contracts.frames import Frame, FrameBlock
from skyrange.contracts.mailboxes import Note
from skyrange.contracts.verdicts import Label
from skyrange.core.time import NS_PER_S, Time
from skyrange.record.digests import Digests
from skyrange.record.notes import outcomes_of_events
from skyrange.record.write.rows.frame_encoder import FrameEncoder
from skyrange.record.write.rows.ticks import TruthTick, truth_tick, truth_words


class TimedNote(NamedTuple):
    """A note with its time and source."""

    time_ns: Time
    source: str
    note: Note


class RaisedAlert(NamedTuple):
    """An alert with the time at which it was raised and the detector that raised it."""

    time_ns: Time
    detector: str
    alert: Alert


class MemoryObserver:
    """An `contracts.components.Observer` that keeps frames, notes, labels, alerts and truth in the order of
    observation.

    Its digests equal those of a `Recorder` with the same truth period. Copies are independent; they share the frames,
    which do not change after they were observed.
    """

    def __init__(self, truth_period_ns: Time = NS_PER_S // 10) -> None:
        """Keep truth every `truth_period_ns` of simulated time."""
        self.truth_period_ns = truth_period_ns
        self.frames: list[Frame] = []
        self.notes: list[TimedNote] = []
        self.labels: list[Label] = []
        self.alerts: list[RaisedAlert] = []
        self.truth: list[TruthTick] = []
        self._truth_due: Time | None = None

    def on_frame(self, frame: Frame) -> None:
        """A frame was delivered, lost or otherwise finished."""
        self.frames.append(frame)

    def on_block(self, block: FrameBlock) -> None:
        """A block of frames was finished."""
        self.frames.extend(block.frames())

    def on_note(self, now: Time, source: str, note: Note) -> None:
        """A decision or an event was noted."""
        self.notes.append(TimedNote(now, source, note))

    def on_label(self, label: Label) -> None:
        """A hostile act was labelled."""
        self.labels.append(label)

    def on_alert(self, now: Time, detector: str, alert: Alert) -> None:
        """A monitor raised an alert."""
        self.alerts.append(RaisedAlert(now, detector, alert))

    def on_truth(self, now: Time, world: World) -> None:
        """A tick ended; truth is kept at the first tick at or after each multiple of the period."""
        vehicles = tuple(world.vehicles)
        if vehicles and (self._truth_due is None or now >= self._truth_due):
            self._truth_due = now - now % self.truth_period_ns + self.truth_period_ns
            tick = truth_tick(now, world)
            columns = {name: np.array(values, dtype=np.float64) for name, values in tick.columns.items()}
            self.truth.append(tick._replace(columns=columns))

    @property
    def digests(self) -> Digests:
        """The digests of everything observed so far."""
        digests = Digests()
        if self.frames:
            digests.add_frames(FrameEncoder(1 << 22).encode(self.frames).words)
        if self.truth:
            digests.add_truth(truth_words(self.truth))
        for time_ns, source, note in self.notes:
            if note.kind.startswith("event."):
                digests.add_event(note.about, time_ns, source, note.kind)
        return digests

    @property
    def outcomes(self) -> dict[str, dict[str, Any]]:
        """`state`, `reason` and `finished_s` of each aircraft whose outcome was noted."""
        return outcomes_of_events((), ((time_ns, note.kind, note.about, note.data) for time_ns, _, note in self.notes))

    def kinds(self, about: str) -> Sequence[str]:
        """The kinds of all notes about a vehicle, operator or endpoint, in order."""
        return [noted.note.kind for noted in self.notes if noted.note.about == about]

    def __deepcopy__(self, memo: dict[int, object]) -> MemoryObserver:
        twin = MemoryObserver(self.truth_period_ns)
        twin.frames = list(self.frames)
        twin.notes = deepcopy(self.notes, memo)
        twin.labels = list(self.labels)
        twin.alerts = deepcopy(self.alerts, memo)
        twin.truth = list(self.truth)
        twin._truth_due = self._truth_due
        return twin
