"""Rows that a run at level `study` has in place of its frames and receptions: observations and counts of frames."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pyarrow as pa

from skyrange.core.time import Time
from skyrange.record.manifest import origin_of, start_unix_ns_of
from skyrange.record.read.transmissions import RADIO_LINK
from skyrange.record.write.rows.frame_encoder import FrameEncoder, GatheredFrames
from skyrange.record.write.study.feature_counts import FeatureCounts
from skyrange.record.write.study.observation_rows import ObservationRows


class StudyRows:
    """Makes these rows from what is observed. Deep-copyable."""

    def __init__(self, header: Mapping[str, Any], features_ns: Time) -> None:
        """`header` says where the run's origin is, and when it starts; `features_ns` is the length of the intervals in
        which frames are counted.
        """
        self._observations = ObservationRows(origin_of(header), start_unix_ns_of(header))
        self._counts = FeatureCounts(features_ns)
        self._on_radio = np.zeros(0, dtype=np.bool_)  # of each flow

    def add_frames(self, encoder: FrameEncoder, gathered: GatheredFrames) -> None:
        """Add frames that `encoder` has just gathered, and take their payloads from it."""
        flows, columns = encoder.flows, gathered.columns
        if len(flows) > len(self._on_radio):
            self._on_radio = np.array([key[0].startswith(RADIO_LINK) for key in flows], dtype=np.bool_)
        self._counts.add(flows, columns.flow, columns.sent, columns.arrived, columns.fate, columns.size, columns.group)
        chosen = np.flatnonzero(self._on_radio[columns.flow])
        transmissions = encoder.table(gathered, chosen) if len(chosen) else None
        self._observations.add_frames(transmissions, encoder.take_payloads(), gathered.last_ns)

    def add_receptions(self, batch: pa.RecordBatch) -> None:
        """Add rows of `receptions`."""
        self._observations.add_receptions(batch)

    def add_foreign(self, frames: pa.Table) -> None:
        """Add transmissions that another shard records, with their payloads."""
        self._observations.add_foreign(frames)

    @property
    def is_full(self) -> bool:
        """Whether rows are to be taken before more frames are added."""
        return self._counts.is_full

    def take(self, *, last: bool = False) -> Iterator[tuple[str, pa.RecordBatch]]:
        """New rows with the names of their tables; receptions may wait for their frames, unless these are the last."""
        counts = self._counts.take()
        if counts is not None:
            yield "features", counts
        observations = self._observations.take(last=last)
        if observations is not None:
            yield "observations", observations
