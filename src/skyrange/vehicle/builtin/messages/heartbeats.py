"""Heartbeats of ground stations, processed in columns; all other frames of an inbox are left to be read singly.

A heartbeat only shows that its sender is there, and in quiet flight a fleet receives nothing else.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import dialect
from skyrange.codec.mavlink.message_columns import KIND_TABLES, kind_at, kind_of_message
from skyrange.contracts.frames import Bytes, Ints
from skyrange.contracts.mailboxes import Columns
from skyrange.core.compiled import compiled
from skyrange.vehicle.builtin.fleet import Fleet
from skyrange.vehicle.builtin.parameters.table import INDEX, MAX_VALUES, MIN_VALUES

_HEARTBEAT: Final = kind_of_message(dialect.MAVLINK_MSG_ID_HEARTBEAT)
_SYSTEM_ID_OFFSET: Final = 5  # offset of the sender's system id in a frame
_GCS_INDEX: Final = INDEX["SYSID_MYGCS"]


@compiled
def _mark_heartbeats(
    now: int, data: Bytes, starts: Ints, sizes: Ints, places: Ints, kinds: NDArray[np.int32], extras: Ints,
    crcs: NDArray[np.uint16], stations: Ints, systems: Ints, heard_ns: Ints, single: NDArray[np.bool_],
) -> None:  # fmt: skip
    """Write to `heard_ns` who heard its ground station; set `single` for all other frames."""
    for row in range(starts.shape[0]):
        place = places[row]
        at = starts[row]
        single[row] = True
        if kind_at(data, at, sizes[row], kinds, extras, crcs) == _HEARTBEAT:
            sender = data[at + _SYSTEM_ID_OFFSET]
            if sender == stations[place] and sender != systems[place]:
                heard_ns[place] = max(now, 1)
                single[row] = False


def consume_heartbeats(fleet: Fleet, mail: Columns) -> Ints:
    """Process the heartbeats of each aircraft's own ground station and return the rows of `mail` that remain.

    Same effect as `failsafes.ground_station.on_heartbeat` for one heartbeat. Heartbeats of other senders remain,
    because they may have to be refused.
    """
    column = fleet.stored_params[:, _GCS_INDEX]
    stations = np.clip(column, MIN_VALUES[_GCS_INDEX], MAX_VALUES[_GCS_INDEX]).astype(np.int64)
    single = np.empty(len(mail.payloads), dtype=np.bool_)
    payloads = mail.payloads
    _mark_heartbeats(
        fleet.now, *payloads.arrays, mail.places, *KIND_TABLES, stations,
        fleet.system_ids, fleet.checks["gcs_heard_ns"], single,
    )  # fmt: skip
    return np.flatnonzero(single)
