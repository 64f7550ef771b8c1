"""Rows of the `receptions` table: which radio received which frame, where, and how strong."""

from __future__ import annotations

from typing import Final, Protocol, runtime_checkable

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from skyrange.codec.remote_id.link_payload import Transport
from skyrange.contracts.medium import ReceptionOutcome, Receptions

_OUTCOMES: Final = pa.array([outcome.name.lower() for outcome in ReceptionOutcome], pa.string())
_TRANSPORTS: Final = pa.array(["other", *(transport.name.lower() for transport in Transport)], pa.string())
"""Names by number; `Transport` counts from 1."""


class ReceptionSource(Protocol):
    """Source of receptions: the owner of a radio medium."""

    def drain_receptions(self) -> Receptions | None:
        """Receptions since the last call, or `None`."""
        ...


@runtime_checkable
class ForeignSource(Protocol):
    """Source of receptions of frames that other processes of the run record."""

    def drain_foreign(self) -> pa.Table | None:
        """Those frames since the last call: link, direction, sender, serial, times and payload as in `frames`."""
        ...


def reception_batch(receptions: Receptions) -> pa.RecordBatch:
    """Rows of the `receptions` table, in the given order."""
    rows = receptions.rows
    place = rows.place_enu_m.astype(np.float32)
    named = [pa.array([name[part] for name in receptions.names], pa.string()) for part in range(3)]
    return pa.RecordBatch.from_arrays(
        [
            pa.array(rows.time_ns),
            *(_dictionary_array(rows.number, names) for names in named),
            pa.array(rows.serial),
            _dictionary_array(rows.radio, pa.array(receptions.radios, pa.string())),
            *(pa.array(place[:, axis]) for axis in range(3)),
            _dictionary_array(rows.transport, _TRANSPORTS),
            pa.array(rows.channel),
            pa.array(rows.rssi_dbm.astype(np.float32)),
            pa.array(rows.snir_db.astype(np.float32)),
            _dictionary_array(rows.outcome, _OUTCOMES),
        ],
        names=[
            "time_ns", "link", "direction", "sender", "serial", "receiver", "east_m", "north_m", "up_m", "transport",
            "channel", "rssi_dbm", "snir_db", "outcome",
        ],
    )  # fmt: skip


def _dictionary_array(numbers: NDArray[np.int64], names: pa.Array) -> pa.DictionaryArray:
    """A dictionary array of `names[numbers]`. Several numbers may have one name, so the dictionary is made unique."""
    unique, place = np.unique(np.array(names.to_pylist(), dtype=object), return_inverse=True)
    codes = place[numbers].astype(np.int32)
    return pa.DictionaryArray.from_arrays(pa.array(codes), pa.array(unique.tolist(), pa.string()))
