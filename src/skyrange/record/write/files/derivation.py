"""Derivation of telemetry and observations from frames and receptions while they are recorded.

Rows come out as `read_station_frames` and `derive_observations` would give them for the whole run. A frame at a ground
station waits until no earlier one is expected; if one comes later still, telemetry is derived anew at the end.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from skyrange.core.geodesy import Origin
from skyrange.core.time import NEVER, NS_PER_S, Time
from skyrange.record.dictionaries import unify_dictionaries
from skyrange.record.read.observations import (
    FRAME_COLUMNS,
    KEPT_NS,
    Transmissions,
    decoded_rows,
    derive_observations,
    describe_observations,
    is_transmission,
    latest_frame_ns,
)
from skyrange.record.read.station_frames import (
    StationLinks,
    decode_station_frames,
    read_station_frames,
    select_received,
    sort_received,
)
from skyrange.record.read.tables import PayloadWindow, Tables, combine_batches
from skyrange.record.read.telemetry import FOLDER
from skyrange.record.schema import arrow_schema
from skyrange.record.spool import OPEN, SPOOL
from skyrange.record.write.files.parquet import open_parquet
from skyrange.record.write.files.table_files import WIDE_GROUP_ROWS, TelemetryFiles

BLOCK_ROWS: Final = 65_536
"""Frames at ground stations that are decoded together."""

HELD_NS: Final[Time] = NS_PER_S // 4
"""How much later than its arrival a frame at a ground station may be recorded. The kernel records it within a tick."""

_RECEPTION_ROWS: Final = 16_384


class Derivation:
    """The derived tables of one run, in files beside its spool, whose rows are added as they are recorded."""

    def __init__(self, folder: Path, origin: Origin | None, start_unix_ns: int | None) -> None:
        """`folder` is the run's; the others are those of `read.observations.derive_observations`."""
        self._folder = folder.absolute()
        self._origin, self._start_unix_ns = origin, start_unix_ns
        self._payloads = PayloadWindow()
        self._telemetry = _Telemetry(self.telemetry_folder)
        self._observations = _Observations(self.observations_file, origin, start_unix_ns)
        self.is_whole = True
        """Whether all rows were added; otherwise `finish` reads the tables."""
        self.observes = True
        """Whether receptions are added near the frames that they name; otherwise `finish` reads the tables."""

    @property
    def telemetry_folder(self) -> Path:
        """The folder of a file for each message."""
        return self._folder / SPOOL / f"{FOLDER}{OPEN}"

    @property
    def observations_file(self) -> Path:
        """The file of observations, if there are any."""
        return self._folder / SPOOL / f"observations.parquet{OPEN}"

    def add(
        self,
        frames: pa.Table | None,
        payloads: Iterable[pa.RecordBatch],
        receptions: Iterable[pa.RecordBatch],
        foreign: Iterable[pa.Table] = (),
    ) -> None:
        """Add what was recorded since the last call, as it is in the spool: payloads include those of the frames.

        `foreign` are transmissions that another process records: `FRAME_COLUMNS` and payloads.
        """
        if not self.is_whole:
            return
        for transmissions in foreign:
            self._observations.add_foreign(transmissions)
        for batch in payloads:
            self._payloads.add(batch)
        for batch in receptions if self.observes else ():  # before the frames, so that none that they name is dropped
            self._observations.add_receptions(batch)
        if frames is not None:
            frames = unify_dictionaries(frames)
            self._telemetry.add(frames, self._payloads)
            if self.observes:
                self._observations.add_frames(frames, self._payloads)
            self._payloads.drop_before_window(pc.max(frames.column("payload_id")).as_py())

    def finish(self, tables: Tables) -> tuple[dict[str, int], int]:
        """Write the rest; returns how many rows each message and observations have. `tables` has all rows."""
        if self.is_whole and not self._telemetry.is_late:
            self._telemetry.finish()
            messages = self._telemetry.files.counts
        else:
            self._telemetry.files.abandon()
            shutil.rmtree(self.telemetry_folder, ignore_errors=True)
            with TelemetryFiles(self.telemetry_folder) as files:
                for block in read_station_frames(tables, BLOCK_ROWS):
                    files.write(block)
            messages = files.counts
        if self.is_whole and self.observes:
            self._observations.finish()
            return messages, self._observations.file.rows
        self._observations.file.abandon()
        file = _ObservationsFile(self.observations_file)
        for batch in derive_observations(tables, self._origin, self._start_unix_ns):
            file.write(batch)
        file.close()
        return messages, file.rows

    def abandon(self) -> None:
        """Close and delete the files."""
        self.is_whole = False
        self._telemetry.files.abandon()
        self._observations.file.abandon()
        shutil.rmtree(self.telemetry_folder, ignore_errors=True)


class _Telemetry:
    """Frames at ground stations that are put in order and decoded."""

    def __init__(self, folder: Path) -> None:
        self.files = TelemetryFiles(folder)
        self.is_late = False
        """Whether a frame came after later ones had been written."""
        self._links = StationLinks()
        self._waiting: pa.Table | None = None
        self._ready: list[pa.RecordBatch] = []
        self._ready_rows = 0
        self._written_ns: Time = -NEVER
        self._latest_ns: Time = -NEVER

    def add(self, frames: pa.Table, payloads: PayloadWindow) -> None:
        chosen, rows = select_received(self._links, frames)
        if self.is_late or not len(chosen):
            return
        times = rows.column("time_ns").to_numpy()
        if times.min() < self._written_ns:
            self.is_late = True
            self._waiting, self._ready = None, []
            return
        ids = frames.column("payload_id").take(pa.array(chosen)).to_numpy()
        rows = rows.append_column("payload", payloads.take(ids))
        rows = sort_received(rows if self._waiting is None else pa.concat_tables([self._waiting, rows]))
        self._latest_ns = max(self._latest_ns, int(times.max()))
        self._written_ns = self._latest_ns - HELD_NS
        due = int(np.searchsorted(rows.column("time_ns").to_numpy(), self._written_ns))
        self._waiting = rows.slice(due)
        self._decode(rows.slice(0, due))

    def _decode(self, rows: pa.Table, *, last: bool = False) -> None:
        self._ready += rows.to_batches()
        self._ready_rows += rows.num_rows
        if self._ready_rows < BLOCK_ROWS and not last:
            return
        blocks = list(combine_batches(self._ready, BLOCK_ROWS))
        self._ready, self._ready_rows = [], 0
        for block in blocks:
            if block.num_rows < BLOCK_ROWS and not last:
                self._ready, self._ready_rows = block.to_batches(), block.num_rows
            else:
                self.files.write(decode_station_frames(unify_dictionaries(block)))

    def finish(self) -> None:
        if self._waiting is not None:
            self._decode(self._waiting, last=True)
        self.files.close()


class _Observations:
    """Receptions that wait for the frames that they name."""

    def __init__(self, path: Path, origin: Origin | None, start_unix_ns: int | None) -> None:
        self.file = _ObservationsFile(path)
        self._origin, self._start_unix_ns = origin, start_unix_ns
        self._transmissions = Transmissions()
        self._waiting: list[pa.RecordBatch] = []

    def add_frames(self, frames: pa.Table, payloads: PayloadWindow) -> None:
        rows = frames.filter(is_transmission(frames))
        rows = rows.append_column("payload", payloads.take(rows.column("payload_id").to_numpy()))
        self._transmissions.add(rows.select([*FRAME_COLUMNS, "payload"]))
        self._transmissions.read_ns = max(self._transmissions.read_ns, pc.max(frames.column("sent_ns")).as_py())
        self._join()
        earliest_ns = min((pc.min(batch.column("time_ns")).as_py() for batch in self._waiting), default=NEVER)
        self._transmissions.drop(min(earliest_ns, self._transmissions.read_ns) - KEPT_NS)

    def add_foreign(self, rows: pa.Table) -> None:
        self._transmissions.add_foreign(rows)

    def add_receptions(self, batch: pa.RecordBatch) -> None:
        rows = decoded_rows(batch)
        if rows.num_rows:
            self._waiting.append(rows)

    def _join(self, *, last: bool = False) -> None:
        left: list[pa.RecordBatch] = []
        for rows in combine_batches(self._waiting, _RECEPTION_ROWS):
            whole = rows.num_rows == _RECEPTION_ROWS and latest_frame_ns(rows) < self._transmissions.read_ns
            if left or not (whole or last):
                left += rows.to_batches()
            else:
                joined = self._transmissions.join(unify_dictionaries(rows))
                self.file.write(describe_observations(joined, self._origin, self._start_unix_ns))
        self._waiting = left

    def finish(self) -> None:
        self._join(last=True)
        self.file.close()


class _ObservationsFile:
    """The Parquet file of observations, made with its first rows."""

    def __init__(self, path: Path) -> None:
        self.rows = 0
        self._path = path
        self._writer: pq.ParquetWriter | None = None
        self._held: list[pa.RecordBatch] = []
        self._held_rows = 0

    def write(self, batch: pa.RecordBatch) -> None:
        self._held.append(batch)
        self._held_rows += batch.num_rows
        self.rows += batch.num_rows
        if self._held_rows >= WIDE_GROUP_ROWS:
            self._write_groups(last=False)

    def _write_groups(self, *, last: bool) -> None:
        schema = arrow_schema("observations")
        groups: Sequence[pa.Table] = list(combine_batches(self._held, WIDE_GROUP_ROWS))
        self._held, self._held_rows = [], 0
        for group in groups:
            if group.num_rows < WIDE_GROUP_ROWS and not last:
                self._held, self._held_rows = group.to_batches(), group.num_rows
                return
            if self._writer is None:
                self._writer = open_parquet(self._path, schema)
            self._writer.write_table(group.cast(self._writer.schema), row_group_size=WIDE_GROUP_ROWS)

    def close(self) -> None:
        self._write_groups(last=True)
        if self._writer is not None:
            self._writer.close()

    def abandon(self) -> None:
        self._held = []
        if self._writer is not None:
            with suppress(OSError, pa.ArrowException):
                self._writer.close()
            self._path.unlink(missing_ok=True)
