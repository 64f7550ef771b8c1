"""The viewer's stream of recorded runs: one run, or the arms of a comparison on one clock."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from skyrange.core.time import NS_PER_MS, NS_PER_S
from skyrange.metrics.safety import find_mishaps
from skyrange.metrics.time_series import EMPTY_TRACK, end_ns, last_activity_ns, read_notes
from skyrange.record import RunRecord
from skyrange.view.stream.events import EventTables, read_events
from skyrange.view.stream.messages import Head, Message, Part, encode_file
from skyrange.view.stream.positions import Floats, Grid, Layer, Samples, sample_last, sample_line
from skyrange.view.stream.scene import ArmRecord, Span, make_scene
from skyrange.view.stream.tracks import RunTracks, read_tracks

STEP_NS: Final = 200 * NS_PER_MS
"""Time between two positions: 5 Hz, which is what a record has of truth unless it is asked for more or less."""
PART_NS: Final = 30 * NS_PER_S
"""Time of one part of a file."""


@dataclass(frozen=True)
class Detail:
    """How much a stream tells of its runs: the time between two positions, the layers, and tables that are left out."""

    step_ns: int = STEP_NS
    layers: tuple[Layer, ...] = tuple(Layer)
    without: tuple[str, ...] = ()

    @property
    def share(self) -> float:
        """The part of all positions that is told, which is less than the part of all bytes."""
        return STEP_NS / self.step_ns * len(self.layers) / len(Layer) if not self.without else 0.0


WHOLE: Final = Detail()
THINNED: Final = (
    Detail(2 * STEP_NS + STEP_NS // 2),
    Detail(5 * STEP_NS, (Layer.TRUTH, Layer.STATION)),
    Detail(5 * STEP_NS, (Layer.TRUTH,)),
    Detail(5 * STEP_NS, (Layer.TRUTH,), ("status", "receptions", "claims")),
    Detail(10 * STEP_NS, (Layer.TRUTH,), ("status", "receptions", "claims")),
)
"""Details of streams that have to be small, in the order in which they are tried."""


class RecordedArms:
    """The records of some arms, which have the same aircraft, read once to be encoded in one detail or another."""

    def __init__(self, arms: Sequence[ArmRecord], *, name: str, verdict: str = "") -> None:
        self._arms = arms
        self._tracks = [read_tracks(arm.record) for arm in arms]
        self._span = _span(arms, self._tracks)
        self._scene = make_scene(arms, self._span, name=name, verdict=verdict)
        self._events = [_events(arm, run, self._scene.head) for arm, run in zip(self._arms, self._tracks, strict=True)]

    @property
    def records(self) -> list[RunRecord]:
        """The record of each arm."""
        return [arm.record for arm in self._arms]

    def encode(self, detail: Detail = WHOLE) -> bytes:
        """A file of the stream; the scene says what `detail` leaves out."""
        tracks = [_thin(run, detail) for run in self._tracks]
        events = [tables.omit(detail.without) for tables in self._events]
        left_out = self._scene.head["left_out"] | self._count_left_out(detail)
        scene = replace(self._scene, head=self._scene.head | {"left_out": left_out})
        return encode_file(scene, list(_parts(scene.head, self._span, detail.step_ns, tracks, events)))

    def encode_within(self, most_bytes: int) -> bytes | None:
        """The stream in the largest detail with which it has at most `most_bytes`; `None` if it has more in each."""
        stream = self.encode()
        whole_bytes = len(stream)
        for detail in THINNED:
            if len(stream) <= most_bytes:
                return stream
            if whole_bytes * detail.share <= most_bytes:
                stream = self.encode(detail)
        return stream if len(stream) <= most_bytes else None

    def _count_left_out(self, detail: Detail) -> dict[str, list[int | float]]:
        rows = {table: sum(len(tables.rows[table]) for tables in self._events) for table in detail.without}
        counts: dict[str, list[int | float]] = {table: [0, count] for table, count in rows.items() if count}
        if len(detail.layers) < len(Layer):
            counts["layers of positions"] = [len(detail.layers), len(Layer)]
        if detail.step_ns > STEP_NS:
            counts["positions a second"] = [NS_PER_S / detail.step_ns, NS_PER_S / STEP_NS]
        return counts


def _thin(run: RunTracks, detail: Detail) -> RunTracks:
    """The tracks of the layers that are told."""
    nothing = dict.fromkeys(run.truth, EMPTY_TRACK)
    return replace(
        run,
        autopilot=run.autopilot if Layer.AUTOPILOT in detail.layers else nothing,
        station=run.station if Layer.STATION in detail.layers else nothing,
    )


def _span(arms: Sequence[ArmRecord], tracks: Sequence[RunTracks]) -> Span:
    """From the first true position to the last activity of any arm, and a little."""
    starts = [int(track.time_ns[0]) for run in tracks for track in run.truth.values() if len(track)]
    start, ends = min(starts, default=0), []
    for arm, run in zip(arms, tracks, strict=True):
        recorded = end_ns(arm.record, run.truth.values())
        notes = [note for name in ("events", "decisions") for note in read_notes(arm.record, name)]
        calm = last_activity_ns(run.truth.values(), notes)
        ends.append(recorded if calm is None else min(recorded, calm + (calm - start) // 25 + 2 * NS_PER_S))
    return Span(start, max(ends))


def _events(arm: ArmRecord, tracks: RunTracks, scene: Head) -> EventTables:
    ids = [row["id"] for row in (*scene["vehicles"], *scene["radios"])]
    mishaps = find_mishaps(read_notes(arm.record, "events"), tracks.truth)
    return read_events(arm.record, {name: place for place, name in enumerate(ids)}, mishaps)


def _parts(
    scene: Head, span: Span, step_ns: int, tracks: Sequence[RunTracks], events: Sequence[EventTables]
) -> Iterator[Part]:
    ids = [row["id"] for row in scene["vehicles"]]
    for start in range(span.start_ns, span.end_ns, PART_NS):
        end = min(start + PART_NS, span.end_ns)
        # one sample more than the part has, so that its last one is the next part's first
        grid = Grid(start, step_ns, -(-(end - start) // step_ns) + 1)
        from_s, until_s = start / NS_PER_S, end / NS_PER_S
        first, last = (from_s if start > span.start_ns else -np.inf), (until_s if end < span.end_ns else np.inf)
        messages: list[Message] = []
        for arm, (run, tables) in enumerate(zip(tracks, events, strict=True)):
            messages += [samples.encode() for samples in sample_layers(arm, run, ids, grid)]
            messages.append(tables.between(first, last).encode(arm, from_s, until_s))
        yield Part(from_s, until_s, messages)


def sample_layers(arm: int, run: RunTracks, ids: Sequence[str], grid: Grid) -> Iterator[Samples]:
    """The positions of an arm's aircraft in each layer, without aircraft that have none in that time."""
    truth = {place: sample_line(run.truth[name], grid) for place, name in enumerate(ids) if len(run.truth[name])}
    rows = _present(truth)
    if rows:
        heading = np.stack([run.headings[ids[row]].at(grid.times) for row in rows])
        yield Samples(arm, Layer.TRUTH, grid, rows, np.stack([truth[row] for row in rows]), heading)
    for layer, tracks in ((Layer.AUTOPILOT, run.autopilot), (Layer.STATION, run.station)):
        told = {place: sample_last(tracks[name], grid) for place, name in enumerate(ids) if len(tracks[name])}
        rows = _present({place: enu_m for place, (enu_m, _) in told.items()})
        if rows:
            ages = np.stack([told[row][1] for row in rows]) if layer is Layer.STATION else None
            yield Samples(arm, layer, grid, rows, np.stack([told[row][0] for row in rows]), age_s=ages)


def _present(places: Mapping[int, Floats]) -> list[int]:
    """The aircraft with any position."""
    return [place for place, enu_m in places.items() if np.isfinite(enu_m).any()]
