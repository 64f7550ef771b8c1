"""View `remote_id`: the broadcasts that each receiver decoded, with signal strength and claims."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from skyrange.dataset.labels import FrameLabels
from skyrange.dataset.windows import WINDOW_NS, by_whole_windows
from skyrange.record.read.run import RunRecord


def describe_receptions(record: RunRecord, labels: FrameLabels) -> Iterator[pa.Table]:
    """The rows of the view in whole windows, without its first and last columns.

    Receivers are those on the ground and the aircraft; radios of attacks are none of the defenders' sensors.
    """
    rows = [*(record.manifest.get("receivers") or ()), *record.manifest["vehicles"]]
    receivers = pa.array([str(row["id"]) for row in rows], pa.string())

    def observed() -> Iterator[pa.Table]:
        for batch in record.batches("observations"):
            yield pa.Table.from_batches([batch]).filter(pc.is_in(batch.column("receiver"), value_set=receivers))

    for table in by_whole_windows(observed(), "time_ns", WINDOW_NS):
        ordered = table.sort_by([("time_ns", "ascending"), ("receiver", "ascending"), ("frame", "ascending")])
        window = np.asarray(ordered.column("time_ns")) // WINDOW_NS
        found = labels.columns(ordered.column("frame").combine_chunks(), ordered.num_rows)
        for name, column in {"window": pa.array(window), **found}.items():
            ordered = ordered.append_column(name, column)
        yield ordered
