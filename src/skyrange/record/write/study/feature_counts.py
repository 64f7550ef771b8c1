"""Counts of frames by directed link and interval, for the `features` table, while frames are recorded.

All counts are sums or maxima of whole numbers. So a link's interval may have several rows in the spool, as many as it
was written in; `read.features` adds them up, and the result does not depend on when they were written.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from skyrange.contracts.frames.frame import Fate
from skyrange.contracts.frames.payloads import Ints
from skyrange.core.compiled import compiled
from skyrange.core.time import Time
from skyrange.record.message_groups import GROUPS
from skyrange.record.read.features import FATE_COLUMNS
from skyrange.record.read.tables import encoded_schema
from skyrange.record.schema import arrow_schema

HELD_ROWS: Final = 65_536
"""Rows that are held in memory at most, besides those of the last frames."""

_SCHEMA: Final = encoded_schema(arrow_schema("features"))
_FATES: Final = len(FATE_COLUMNS)
_DELIVERED: Final = list(Fate).index(Fate.DELIVERED)
# the columns of a row of counts: interval, directed link, a count for each fate, and then
_BYTES: Final = 2 + _FATES
_SUM: Final = _BYTES + 1
_MAX: Final = _BYTES + 2
_GROUP: Final = _BYTES + 3
_WIDTH: Final = _GROUP + len(GROUPS)


@compiled
def _count(
    links: Ints, sent: Ints, arrived: Ints, fates: NDArray[np.int32], sizes: NDArray[np.int32],
    groups: NDArray[np.uint8], period_ns: int, used: int, newest: Ints, rows: Ints,
) -> int:  # fmt: skip
    """Add frames to `rows`, of which `used` are; `newest` has the row of each directed link's last frame, or -1.
    Returns how many are used then.
    """
    for frame in range(links.shape[0]):
        link = links[frame]
        interval = sent[frame] // period_ns
        row = newest[link]
        if row < 0 or rows[row, 0] != interval:
            row = used
            used += 1
            newest[link] = row
            for column in range(_WIDTH):
                rows[row, column] = 0
            rows[row, 0] = interval
            rows[row, 1] = link
            rows[row, _MAX] = -1
        fate = fates[frame]
        rows[row, 2 + fate] += 1
        rows[row, _BYTES] += sizes[frame]
        if fate == _DELIVERED:
            latency = arrived[frame] - sent[frame]
            rows[row, _SUM] += latency
            rows[row, _MAX] = max(rows[row, _MAX], latency)
        if groups[frame]:
            rows[row, _GROUP - 1 + groups[frame]] += 1
    return used


class FeatureCounts:
    """The counts of frames since they were last taken. Deep-copyable."""

    def __init__(self, period_ns: Time) -> None:
        """`period_ns` is the length of an interval."""
        self._period_ns = period_ns
        self._link_of_flow = np.zeros(0, dtype=np.int64)
        self._links: dict[tuple[str, str], int] = {}
        self._newest = np.zeros(0, dtype=np.int64)
        self._rows = np.zeros((0, _WIDTH), dtype=np.int64)
        self._used = 0

    @property
    def is_full(self) -> bool:
        """Whether the counts are to be taken before more is added."""
        return self._used >= HELD_ROWS

    def add(
        self,
        flows: Sequence[tuple[str, ...]],
        flow: Ints,
        sent_ns: Ints,
        arrived_ns: Ints,
        fate: NDArray[np.int32],
        size: NDArray[np.int32],
        group: NDArray[np.uint8],
    ) -> None:
        """Add frames, (n,) each: the number of the flow in `flows`, which begin with link and direction and to which
        later calls may only append; times, the number of the `Fate`, the size and the group (`message_groups`).
        """
        for key in flows[len(self._link_of_flow) :]:
            self._links.setdefault((key[0], key[1]), len(self._links))
        if len(flows) > len(self._link_of_flow):
            numbers = [self._links[key[0], key[1]] for key in flows]
            self._link_of_flow = np.array(numbers, dtype=np.int64)
            new = np.full(len(self._links) - len(self._newest), -1, dtype=np.int64)
            self._newest = np.concatenate([self._newest, new])
        if len(self._rows) < self._used + len(flow):
            grown = np.empty((self._used + len(flow) + HELD_ROWS, _WIDTH), dtype=np.int64)
            grown[: self._used] = self._rows[: self._used]
            self._rows = grown
        self._used = _count(
            self._link_of_flow[flow], sent_ns, arrived_ns, fate, size, group, self._period_ns, self._used,
            self._newest, self._rows,
        )  # fmt: skip

    def take(self) -> pa.RecordBatch | None:
        """Rows of `features`, which count from zero again; a link's interval may have more than one. None if empty."""
        if not self._used:
            return None
        rows = self._rows[: self._used]
        self._used = 0
        self._newest.fill(-1)
        most = rows[:, _MAX]
        counts = rows[:, 2 : 2 + _FATES]
        columns = [
            pa.array(rows[:, 0] * self._period_ns),
            *(self._names(rows[:, 1], place) for place in range(2)),
            *(pa.array(column.astype(np.int32)) for column in (counts.sum(axis=1), *counts.T)),
            pa.array(rows[:, _BYTES].copy()),
            pa.array(rows[:, _SUM].copy()),
            pa.array(most.copy(), mask=most < 0),
            *(pa.array(rows[:, _GROUP + place].astype(np.int32)) for place in range(len(GROUPS))),
        ]
        return pa.RecordBatch.from_arrays(columns, schema=_SCHEMA)

    def _names(self, links: Ints, place: int) -> pa.Array:
        names = [key[place] for key in self._links]
        known = list(dict.fromkeys(names))
        places = {name: number for number, name in enumerate(known)}
        codes = np.array([places[name] for name in names], dtype=np.int32)
        return pa.DictionaryArray.from_arrays(pa.array(codes[links]), pa.array(known, pa.string()))
