"""Rows of `observations` made during a run that keeps neither the frames nor the receptions that they come from."""

from __future__ import annotations

from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from skyrange.core.geodesy import Origin
from skyrange.core.time import NEVER, Time
from skyrange.record.dictionaries import unify_dictionaries
from skyrange.record.read.observations import describe_observations
from skyrange.record.read.payload_window import PayloadWindow
from skyrange.record.read.tables import encoded_schema
from skyrange.record.read.transmissions import (
    AHEAD_NS,
    FRAME_COLUMNS,
    KEPT_NS,
    Transmissions,
    decoded_rows,
)
from skyrange.record.schema import arrow_schema

_SCHEMA: Final = encoded_schema(arrow_schema("observations"))


class ObservationRows:
    """Receptions that wait for the frames that they name, and these frames. Deep-copyable.

    Rows come out as `derive_observations` gives them for a run that keeps everything.
    """

    def __init__(self, origin: Origin | None, start_unix_ns: int | None) -> None:
        """The arguments are those of `read.observations.derive_observations`."""
        self._origin, self._start_unix_ns = origin, start_unix_ns
        self._payloads = PayloadWindow()
        self._sent: list[pa.RecordBatch] = []  # transmissions since rows were last taken
        self._sent_ns: Time = -NEVER
        self._transmissions = Transmissions()
        self._waiting: list[pa.RecordBatch] = []

    def add_frames(self, transmissions: pa.RecordBatch | None, payloads: pa.RecordBatch, sent_ns: Time) -> None:
        """Add those of some frames that are on links from radios to the medium, with `FRAME_COLUMNS` and payload ids.

        `payloads` are new among all frames, `sent_ns` is the latest sending time of all.
        """
        self._payloads.add(payloads)
        self._sent_ns = max(self._sent_ns, sent_ns)
        if transmissions is not None:
            self._sent.append(transmissions)

    def add_foreign(self, rows: pa.Table) -> None:
        """Add transmissions that another process records: `FRAME_COLUMNS` and payloads."""
        self._transmissions.add_foreign(rows)

    def add_receptions(self, batch: pa.RecordBatch) -> None:
        """Add rows of `receptions`, soon after the frames that they name."""
        rows = decoded_rows(batch)
        if rows.num_rows:
            self._waiting.append(rows)

    def take(self, *, last: bool = False) -> pa.RecordBatch | None:
        """The rows whose frames must have been added by now, or with `last` all; None if there are none."""
        self._add_transmissions()
        rows = None
        if self._waiting:
            waiting = unify_dictionaries(pa.Table.from_batches(self._waiting))
            latest_ns = np.maximum.accumulate(waiting.column("time_ns").to_numpy()) + AHEAD_NS
            ready = len(latest_ns) if last else int(np.searchsorted(latest_ns, self._transmissions.read_ns))
            if ready:
                joined = self._transmissions.join(waiting.slice(0, ready))
                rows = describe_observations(joined, self._origin, self._start_unix_ns).cast(_SCHEMA)
            self._waiting = waiting.slice(ready).to_batches()
        earliest_ns = min((pc.min(batch.column("time_ns")).as_py() for batch in self._waiting), default=NEVER)
        self._transmissions.drop(min(earliest_ns, self._transmissions.read_ns) - KEPT_NS)
        return rows

    def _add_transmissions(self) -> None:
        if self._sent:
            rows = unify_dictionaries(pa.Table.from_batches(self._sent))
            self._sent = []
            ids = rows.column("payload_id").to_numpy()
            rows = rows.append_column("payload", self._payloads.take(ids))
            self._transmissions.add(rows.select([*FRAME_COLUMNS, "payload"]))
        self._payloads.drop_before_window(max(self._payloads.newest, 0))
        self._transmissions.read_ns = max(self._transmissions.read_ns, self._sent_ns)
