"""Decoded receptions joined with the broadcasts that were transmitted: which bytes each receiver decoded.

A row of `receptions` names the frame on `rid_up` that was transmitted; the body that a receiver decodes is that
frame's. Both tables are read once, side by side, with bounded memory.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.contracts.frames.payloads import Ints, Payloads
from skyrange.core.time import NEVER, NS_PER_S, Time
from skyrange.record.dictionaries import dictionary_array
from skyrange.record.read.station_frames import payload_column
from skyrange.record.read.tables import Tables, combine_batches

RADIO_LINK: Final = "rid_up:"
"""Prefix of the links from radios to the medium; the rest of the name is the radio."""

DECODED: Final = "decoded"
"""The outcome of a reception whose receiver got every byte."""

KEPT_NS: Final[Time] = 60 * NS_PER_S
"""How long a frame is kept after its arrival at the medium. The builtin medium transmits within half a second."""

AHEAD_NS: Final[Time] = NS_PER_S
"""Frames are recorded nearly in order of time: those of the last second of a batch may be recorded a little later."""

RECEPTION_COLUMNS: Final = (
    "time_ns", "link", "direction", "sender", "serial", "receiver", "east_m", "north_m", "up_m", "transport", "channel",
    "rssi_dbm", "outcome",
)  # fmt: skip
FRAME_COLUMNS: Final = ("link", "direction", "sender", "serial", "sent_ns", "arrived_ns")
"""The columns of frames that are needed to find those that were transmitted, besides their payloads."""

_BATCH_ROWS: Final = 16_384
_SERIAL_BITS: Final = 40
"""A key is the number of a flow, then the serial number; a flow is a link, a direction and a sender."""


@dataclass(frozen=True, slots=True)
class DecodedReceptions:
    """Some decoded receptions, with the frames that were transmitted."""

    rows: pa.Table
    """n rows of `receptions` with `RECEPTION_COLUMNS`, in the order recorded."""
    place: Ints
    """(n,) the frame of each row in `payloads`; -1 if the record does not have the frame."""
    payloads: Payloads
    """Payloads of the frames, in the format of `codec.remote_id.link_payload`; each frame once."""


def read_decoded_receptions(
    tables: Tables, receivers: Sequence[str] | None = None, batch_rows: int = _BATCH_ROWS
) -> Iterator[DecodedReceptions]:
    """The decoded receptions in the order recorded, `batch_rows` or more at a time; `receivers` limits the receivers.

    Frames are not read if there are no receptions.
    """
    wanted = None if receivers is None else pa.array(list(receivers), pa.string())
    transmissions = Transmissions()
    frames: Iterator[pa.Table] | None = None
    for rows in combine_batches(_decoded(tables, wanted), batch_rows):
        if frames is None:
            frames = tables.frames_with_payloads(FRAME_COLUMNS, encoded=True)
        until = latest_frame_ns(rows)
        while transmissions.read_ns <= until and (batch := next(frames, None)) is not None:
            transmissions.add(batch)
        yield transmissions.join(rows)


def _decoded(tables: Tables, receivers: pa.Array | None) -> Iterator[pa.RecordBatch]:
    for batch in tables.batches("receptions", RECEPTION_COLUMNS):
        rows = decoded_rows(batch)
        if receivers is not None:
            rows = rows.filter(pc.is_in(rows.column("receiver"), value_set=receivers))
        yield rows


def decoded_rows(batch: pa.RecordBatch) -> pa.RecordBatch:
    """The rows of receptions whose receiver got every byte, with `RECEPTION_COLUMNS`."""
    return batch.select(list(RECEPTION_COLUMNS)).filter(pc.equal(batch.column("outcome").cast(pa.string()), DECODED))


def latest_frame_ns(receptions: pa.Table) -> Time:
    """The time of sending by which all frames that receptions may name were recorded."""
    return int(pc.max(receptions.column("time_ns")).as_py()) + AHEAD_NS


@dataclass(frozen=True, slots=True)
class _Batch:
    """Frames that were read together."""

    keys: Ints
    payloads: pa.ChunkedArray
    last_ns: Time
    """Latest arrival."""


class Transmissions:
    """The frames on `rid_up` that receptions may name; the window moves forward with the receptions."""

    def __init__(self) -> None:
        self.read_ns: Time = -NEVER
        """The latest time of sending so far."""
        self._held: list[_Batch] = []
        self._flows: dict[tuple[str, str, str], int] = {}

    def add(self, frames: pa.Table) -> None:
        """Add frames with `FRAME_COLUMNS` and their payloads, in the order recorded."""
        if frames.num_rows:
            self.read_ns = max(self.read_ns, pc.max(frames.column("sent_ns")).as_py())
            self.add_foreign(frames)

    def add_foreign(self, frames: pa.Table) -> None:
        """Add such frames that another process records: how far this one has recorded they do not tell."""
        rows = frames.filter(is_transmission(frames))
        if rows.num_rows:
            times = pc.coalesce(rows.column("arrived_ns"), rows.column("sent_ns"))
            self._held.append(_Batch(self._keys(rows), rows.column("payload"), pc.max(times).as_py()))

    def join(self, receptions: pa.Table) -> DecodedReceptions:
        """The frames of receptions, which are later than all joined before or at most `KEPT_NS` earlier."""
        rows = receptions.combine_chunks()
        self.drop(int(pc.min(rows.column("time_ns")).as_py()) - KEPT_NS)
        payloads, place = self._find(rows)
        return DecodedReceptions(rows, place, payloads)

    def drop(self, before: Time) -> None:
        """Drop the batches whose frames all arrived before a time."""
        self._held = [batch for batch in self._held if batch.last_ns >= before]

    def _find(self, rows: pa.Table) -> tuple[Payloads, Ints]:
        """The payloads of the frames that some receptions name, each once, and the place of each row's frame."""
        wanted, row_of = np.unique(self._keys(rows), return_inverse=True)
        if not self._held:
            return Payloads.of([]), np.full(len(row_of), -1, dtype=np.int64)
        keys = np.concatenate([batch.keys for batch in self._held])
        order = np.argsort(keys, kind="stable")
        found = np.minimum(np.searchsorted(keys, wanted, sorter=order), len(keys) - 1)
        known = keys[order[found]] == wanted
        held = pa.chunked_array([chunk for batch in self._held for chunk in batch.payloads.chunks], pa.binary())
        payloads = payload_column(pa.chunked_array(held.take(pa.array(order[found[known]]))))
        place = np.where(known, np.cumsum(known) - 1, -1)
        return payloads, place[row_of].astype(np.int64)

    def _keys(self, rows: pa.Table) -> Ints:
        """(n,) a number for each frame that rows name by link, direction, sender and serial."""
        codes, names = zip(*(_codes(rows, name) for name in ("link", "direction", "sender")), strict=True)
        joined = (codes[0] * len(names[1]) + codes[1]) * len(names[2]) + codes[2]
        found, number = np.unique(joined, return_inverse=True)
        flows = np.empty(len(found), dtype=np.int64)
        for row, code in enumerate(found.tolist()):
            rest, sender = divmod(code, len(names[2]))
            link, direction = divmod(rest, len(names[1]))
            flow = (names[0][link], names[1][direction], names[2][sender])
            flows[row] = self._flows.setdefault(flow, len(self._flows))
        serial: Ints = rows.column("serial").to_numpy()
        return (flows[number] << _SERIAL_BITS) + serial


def is_transmission(frames: pa.Table) -> pa.ChunkedArray:
    """Which frames are on a link from a radio to the medium; `link` is dictionary-encoded."""
    chunks = []
    for chunk in frames.column("link").chunks:
        on_radio = pc.starts_with(chunk.dictionary, RADIO_LINK)
        chunks.append(on_radio.take(chunk.indices))
    return pa.chunked_array(chunks, pa.bool_())


def _codes(rows: pa.Table, name: str) -> tuple[NDArray[np.int64], list[str]]:
    """A column of names as numbers, and the names."""
    column = dictionary_array(rows.column(name))
    return column.indices.to_numpy(zero_copy_only=False).astype(np.int64), column.dictionary.to_pylist()
