"""Rows that a run at level `study` has in place of its frames and receptions: observations and counts of frames.

The counts of frames are by directed link and interval, for the `features` table. All are sums or maxima of whole
numbers. So a link's interval may have several rows in the spool, as many as it was written in; `read.features` adds
them up, and the result does not depend on when they were written.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.contracts.frames import Fate, Ints
from skyrange.core.compiled import compiled
from skyrange.core.geodesy import Origin
from skyrange.core.time import NEVER, Time
from skyrange.record.dictionaries import unify_dictionaries
from skyrange.record.manifest import origin_of, start_unix_ns_of
from skyrange.record.message_groups import GROUPS
from skyrange.record.read.features import FATE_COLUMNS
from skyrange.record.read.observations import (
    AHEAD_NS,
    FRAME_COLUMNS,
    KEPT_NS,
    RADIO_LINK,
    Transmissions,
    decoded_rows,
    describe_observations,
)
from skyrange.record.read.tables import PayloadWindow, encoded_schema
from skyrange.record.schema import arrow_schema
from skyrange.record.write.rows.frame_encoder import FrameEncoder, GatheredFrames

HELD_ROWS: Final = 65_536
"""Rows that are held in memory at most, besides those of the last frames."""

_FEATURES_SCHEMA: Final = encoded_schema(arrow_schema("features"))
_FATES: Final = len(FATE_COLUMNS)
_DELIVERED: Final = list(Fate).index(Fate.DELIVERED)
# the columns of a row of counts: interval, directed link, a count for each fate, and then
_BYTES: Final = 2 + _FATES
_SUM: Final = _BYTES + 1
_MAX: Final = _BYTES + 2
_GROUP: Final = _BYTES + 3
_WIDTH: Final = _GROUP + len(GROUPS)


@compiled
def _count(  # noqa: PLR0917 - compiled
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
        *,
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
            wanted = max(self._used + len(flow), min(2 * len(self._rows), HELD_ROWS))
            grown = np.empty((wanted, _WIDTH), dtype=np.int64)
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
        return pa.RecordBatch.from_arrays(columns, schema=_FEATURES_SCHEMA)

    def _names(self, links: Ints, place: int) -> pa.Array:
        names = [key[place] for key in self._links]
        known = list(dict.fromkeys(names))
        places = {name: number for number, name in enumerate(known)}
        codes = np.array([places[name] for name in names], dtype=np.int32)
        return pa.DictionaryArray.from_arrays(pa.array(codes[links]), pa.array(known, pa.string()))


_OBSERVATIONS_SCHEMA: Final = encoded_schema(arrow_schema("observations"))


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
                rows = describe_observations(joined, self._origin, self._start_unix_ns).cast(_OBSERVATIONS_SCHEMA)
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


class StudyRows:
    """Makes these rows from what is observed. Deep-copyable."""

    def __init__(self, header: Mapping[str, Any], features_ns: Time) -> None:
        """`header` says where the run's origin is, and when it starts; `features_ns` is the length of the intervals in
        which frames are counted.
        """
        self._observations = ObservationRows(origin_of(header), start_unix_ns_of(header))
        self._counts = FeatureCounts(features_ns)
        self._on_radio = np.zeros(0, dtype=np.bool_)  # of each flow

    def add_frames(self, encoder: FrameEncoder, gathered: GatheredFrames, payloads: pa.RecordBatch) -> None:
        """Add frames that `encoder` has gathered; `payloads` are those that were new to it among them."""
        flows, columns = encoder.flows, gathered.columns
        if len(flows) > len(self._on_radio):
            self._on_radio = np.array([key[0].startswith(RADIO_LINK) for key in flows], dtype=np.bool_)
        self._counts.add(
            flows,
            columns.flow,
            sent_ns=columns.sent,
            arrived_ns=columns.arrived,
            fate=columns.fate,
            size=columns.size,
            group=columns.group,
        )
        chosen = np.flatnonzero(self._on_radio[columns.flow])
        transmissions = encoder.table(gathered, chosen) if len(chosen) else None
        self._observations.add_frames(transmissions, payloads, gathered.last_ns)

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
