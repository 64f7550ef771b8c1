"""Window of payloads that the frames being read may refer to; it moves forward with the frames."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from skyrange.record.schema import PAYLOAD_WINDOW


class PayloadWindow:
    """Payloads by id. Rows are added in ascending order of their ids, and dropped when no frame can refer to them."""

    def __init__(self) -> None:
        self.newest = -1
        """The greatest id so far."""
        self._held: list[pa.RecordBatch] = []
        self._table: pa.Table | None = None
        """What is held, in one piece; None when it has changed."""

    def add(self, batch: pa.RecordBatch) -> None:
        """Add rows of `payloads`."""
        if batch.num_rows:
            self._held.append(batch)
            self._table = None
            self.newest = int(batch.column("payload_id")[-1].as_py())

    def take(self, ids: NDArray[np.int64]) -> pa.Array:
        """The payloads of `ids` up to the first that is missing."""
        if not len(ids) or not self._held:
            return pa.array([], pa.binary())
        if self._table is None:
            self._table = pa.Table.from_batches(self._held).combine_chunks()
        known = self._table.column("payload_id").to_numpy()
        places = np.minimum(np.searchsorted(known, ids), len(known) - 1)
        missing = np.flatnonzero(known[places] != ids)
        places = places[: missing[0]] if len(missing) else places
        column = self._table.column("payload").take(pa.array(places))
        return column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column

    def drop_before_window(self, newest: int) -> None:
        """Drop the payloads of earlier windows than that of id `newest`, to which a frame has referred."""
        start = newest - newest % PAYLOAD_WINDOW  # later frames do not refer to earlier windows
        if self._held and self._held[0].column("payload_id")[-1].as_py() < start:
            self._held = [batch for batch in self._held if batch.column("payload_id")[-1].as_py() >= start]
            self._table = None
