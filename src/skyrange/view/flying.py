"""The viewer's stream of a run while it flies, of the rows that its recorder writes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Protocol

import pyarrow as pa

from skyrange.core.errors import InputError
from skyrange.record import Recorder, RunRecord, load
from skyrange.record.read.growth import GrowingRun
from skyrange.record.schema import RECORDED
from skyrange.runtime.run import Run
from skyrange.scenario.model.scenario import Scenario
from skyrange.view.folders import encode_folder
from skyrange.view.scan_index import NewestScans
from skyrange.view.scan_queries import FlyingScans
from skyrange.view.stream.growing import GrowingStream
from skyrange.view.stream.messages import Message

PERIOD_S: Final = 0.2
"""Wall time between two messages; what happens in between is in one."""


UNWATCHED_S: Final = 1.0
"""Wall time between two looks whether anybody watches; so often rows are written without a view."""


def require_truth(scenario: Scenario) -> None:
    """Raise `InputError` for a scenario whose record has no truth, which is what is shown."""
    record = scenario.record
    if "truth" not in RECORDED[record.level]:
        problem = ("record.level", record.level, "a level with truth: full or study")
        raise InputError.one("viewer", *problem, "Add --set record.level=full.")
    if not record.truth_hz:
        raise InputError.one("viewer", "record.truth_hz", "0", "a rate at which truth is recorded, such as 5")


class LiveHost(Protocol):
    """Who has the messages of a run for others, as `server.LiveStream`."""

    @property
    def watched(self) -> bool:
        """Whether anybody wants them."""
        ...

    def publish(self, message: Message) -> None:
        """Take a message."""
        ...

    def restart(self) -> None:
        """Forget all messages: they come anew."""
        ...

    def replace(self, data: bytes) -> None:
        """Have a file of the stream in place of all messages."""
        ...


class FlightView:
    """What shows a run while it flies; a `RowReader` of its recorder. A fault of its own ends the view, not the run.

    While nobody watches it does nothing. When somebody does again, it reads what has been recorded so far.
    """

    def __init__(self, scenario: Scenario, host: LiveHost, *, every_s: float = PERIOD_S) -> None:
        """Messages are published every `every_s` of wall time. Raises as `require_truth`."""
        require_truth(scenario)
        self._host = host
        self._every_s = every_s
        self._recorder: Recorder | None = None
        self._stream: GrowingStream | None = None
        """None before the run, and while nobody watches."""
        self.scans = FlyingScans()
        self.fault: Exception | None = None
        """What ended the view before the run."""

    def start(self, run: Run) -> None:
        """Show a run that begins."""
        self._recorder = run.recorder
        self._stream = GrowingStream(load(run.recorder.path), self._host.publish)
        if run.built.scanner is not None:
            self.scans.known = NewestScans(load(run.recorder.path))
        run.recorder.hand_rows_to(self, self._every_s)

    def add(self, table: str, batch: pa.RecordBatch) -> None:
        """Take rows."""
        if table == "scans":
            if (known := self.scans.known) is not None:
                self._guard(lambda: known.add(batch))
        elif (stream := self._stream) is not None:
            self._guard(lambda: stream.add(table, batch))

    def complete(self) -> None:
        """Publish what is known, if anybody watches."""
        self._guard(self._complete)

    def _complete(self) -> None:
        recorder, watched = self._recorder, self._host.watched
        if recorder is None:
            return
        if self._stream is None and watched:
            self._host.restart()
            self._stream = GrowingStream(load(recorder.path), self._host.publish)
            GrowingRun(recorder.path).read(self._stream.add)
            recorder.hand_rows_to(self, self._every_s)
        elif self._stream is not None and not watched:
            self._stream = None
            recorder.hand_rows_to(self, UNWATCHED_S)
        if self._stream is not None:
            self._stream.complete()

    def finish(self, record: RunRecord) -> None:
        """Show the rest of a run that has ended, and its last scene."""
        end_s = float(record.manifest.get("simulated_s") or 0.0)
        stream = self._stream
        if stream is None:
            self._guard(lambda: self._host.replace(encode_folder(record.path)))
            return
        self._guard(lambda: stream.end(record.status, end_s))
        if self.fault is not None:
            stream.break_off("not shown to its end")

    def _guard(self, do: Callable[[], None]) -> None:
        if self.fault is not None:
            return
        try:
            do()
        except Exception as error:  # whatever it is, the run and its record go on
            self.fault = error
