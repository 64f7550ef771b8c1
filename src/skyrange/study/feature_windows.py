"""Windows of a run: the features of each window at each link end, collected in flight, and labels of attacks."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from skyrange.contracts.alerts import Alert
from skyrange.contracts.monitors import MonitorPlacement, ObservedFrames, find_ends
from skyrange.core.errors import InputError
from skyrange.core.files import atomic_write
from skyrange.core.time import NS_PER_S, Time, from_seconds
from skyrange.detect.episodes import subject_of_link
from skyrange.detect.series import Floats
from skyrange.detect.window_features import NAMES, WindowFeatures
from skyrange.statistics.clusters import keep_first

WINDOWS: Final = "windows"
"""Name of the table."""
COLLECTOR: Final = "windows"
"""Id of the monitor that collects it."""
SCHEMA: Final = pa.schema(
    [
        pa.field("time_ns", pa.int64(), nullable=False),
        pa.field("link", pa.string(), nullable=False),
        pa.field("vehicle", pa.string(), nullable=False),
        *(pa.field(name, pa.float64(), nullable=False) for name in NAMES),
    ]
)
"""The end of each window, the link and its owner, and the features."""


class WindowCollector:
    """A `skyrange.contracts.monitors.Monitor` that raises no alert, and keeps the features of all windows."""

    def __init__(self, window_ns: Time) -> None:
        self.service_ns: Time = window_ns
        self._features = WindowFeatures(window_ns)
        self._times: list[Time] = []
        self._links: list[str] = []
        self._rows: list[Floats] = []

    def observe(self, now: Time, frames: ObservedFrames) -> Sequence[Alert]:
        """Keep the features of the ends at which something arrived."""
        features = self._features.read(frames)
        rows = np.flatnonzero(np.bincount(frames.places[frames.received], minlength=len(features)) > 0)
        self._times += [now] * len(rows)
        self._links += [frames.ports[row].link for row in rows.tolist()]
        self._rows.append(features[rows])
        return []

    def table(self) -> pa.Table:
        """The windows, in order of time and then of link end, by `SCHEMA`."""
        values = np.concatenate([np.zeros((0, len(NAMES))), *self._rows])
        names = [subject_of_link(link) for link in self._links]
        columns = [pa.array(column, pa.float64()) for column in np.ascontiguousarray(values.T)]
        return pa.table([pa.array(self._times, pa.int64()), pa.array(self._links), pa.array(names), *columns], SCHEMA)


def place_collector(collector: WindowCollector, links: Sequence[str], side: str) -> MonitorPlacement:
    """The placement of a collector, for one run."""
    return MonitorPlacement(COLLECTOR, lambda: collector, links, side)


def check_collector(links: Sequence[str], side: str, ends: Iterable[tuple[str, str, str]]) -> None:
    """Raise `InputError` for patterns that match none of the links `ends`: (name, one end, other end)."""
    try:
        find_ends(MonitorPlacement(COLLECTOR, lambda: WindowCollector(1), links, side), ends)
    except InputError as error:
        prefix = f"monitors.{COLLECTOR}"
        problems = [
            replace(problem, where=f"learned{problem.where.removeprefix(prefix)}") for problem in error.problems
        ]
        raise InputError("study", problems) from None


class CollectedWindows(NamedTuple):
    """Windows whose features a run collects."""

    window_s: float
    """Length of a window, in seconds."""
    links: Sequence[str]
    """Patterns of the links to listen to."""
    side: str
    """End of those links."""


def make_collector(window_s: float) -> WindowCollector:
    """A new collector of windows of this length."""
    return WindowCollector(from_seconds(window_s))


def find_distinct(
    clusters: Sequence[str], windows: pa.Table, features: Floats, nominal: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """(n,) whether a window is the only one of its content, or the one that counts; of nominal windows the first does.

    Windows of one cluster, aircraft and time with equal features are one observation: arms of a block are equal until
    something acts, and the nominal runs of points with one seed may be one flight. `clusters` are those of the blocks.
    """
    ends, vehicles = windows.column("time_ns").to_pylist(), windows.column("vehicle").to_pylist()
    order = np.argsort(~nominal, kind="stable").tolist()
    distinct = np.zeros(len(clusters), dtype=np.bool_)
    distinct[order] = keep_first([(clusters[row], ends[row], vehicles[row], features[row].tobytes()) for row in order])
    return distinct


def write_windows(table: pa.Table, path: Path) -> None:
    """Write the windows of a run: the file is there as a whole or not at all."""
    with atomic_write(path) as file:
        pq.write_table(table, file, compression="zstd")


BENIGN, ATTACKED, UNKNOWN = 0, 1, 2


def label_windows(
    windows: pa.Table,
    acts: Mapping[str, Sequence[Mapping[str, Any]]],
    intruded_s: Mapping[str, float],
    window_ns: Time,
) -> NDArray[np.int64]:
    """(n,) the label of each row of `windows`, which has the columns run, vehicle and time_ns, the window's end.

    `acts` are the attacks by run, with vehicle ("" for all), first_s and last_s. A window is ATTACKED if an attack on
    its aircraft acts within it, and BENIGN in a run without attacks. In an attacked run all other windows are UNKNOWN:
    those before the onset are in the nominal run of the block already, and those after it may be its consequences, as
    those of other aircraft may. `intruded_s` has, by run, the first act of a harmless intrusion: windows that end after
    it are UNKNOWN too, because what a detector sees there is neither an attack nor authorised.
    """
    ends = windows.column("time_ns").to_numpy()
    runs, vehicles = windows.column("run").to_pylist(), windows.column("vehicle").to_pylist()
    labels = np.full(len(ends), BENIGN, dtype=np.int64)
    for row, (run, vehicle) in enumerate(zip(runs, vehicles, strict=True)):
        run_acts = acts.get(run)
        if run_acts is None:
            labels[row] = UNKNOWN if ends[row] > intruded_s.get(run, math.inf) * NS_PER_S else BENIGN
            continue
        labels[row] = UNKNOWN
        end, begin = int(ends[row]), int(ends[row]) - window_ns
        for act in run_acts:
            if (
                act["vehicle"] in ("", vehicle)
                and act["first_s"] * NS_PER_S < end
                and act["last_s"] * NS_PER_S >= begin
            ):
                labels[row] = ATTACKED
                break
    return labels
