"""Conversion of a finished run's spool to Parquet tables and operator files, batch by batch.

All files are written to `.final/` in the run's folder and moved into place when they are complete. Until the manifest
is replaced, readers use the spool.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from datetime import datetime
from itertools import chain
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from skyrange.core.time import Epoch
from skyrange.record.manifest import origin_of, start_unix_ns_of
from skyrange.record.read.observations import derive_observations
from skyrange.record.read.station_frames import read_station_frames, survey_messages
from skyrange.record.read.tables import Tables, combine_batches, parquet_options
from skyrange.record.read.telemetry import ReceivedMessages, TelemetryBuilder
from skyrange.record.schema import DERIVED, OPTIONAL, TABLES, arrow_schema
from skyrange.record.spool import write_error
from skyrange.record.write.operator_files import OperatorFiles

FINAL = ".final"
"""The folder that holds finished files until all are finished."""

GROUP_ROWS = 131_072
"""Rows of a Parquet row group, the smallest unit that a reader must hold in memory."""

_WIDE_GROUP_ROWS = 32_768  # telemetry has one column per MAVLink field, hundreds with many message types


def finalise(folder: Path, manifest: Mapping[str, Any]) -> dict[str, int]:
    """Write all tables, CSV files and tlogs of the run in `folder` from its spool; returns the row count per table.

    Raises `ComponentError` if writing fails; the record then remains in its spool.
    """
    final = folder.absolute() / FINAL  # absolute, because Arrow reads a relative name with a colon or a tilde as a URI
    tables = Tables(folder, spooled=True)
    counts: dict[str, int] = {}
    try:
        shutil.rmtree(final, ignore_errors=True)
        (final / "operators").mkdir(parents=True)
        for name in TABLES:
            if name not in DERIVED and has_table(name, tables, manifest):
                counts[name] = _write(final / f"{name}.parquet", tables.schema(name), tables.batches(name))
        observed = _write_observations(final / "observations.parquet", tables, manifest)
        if observed:
            counts["observations"] = observed
        counts["telemetry"] = _write_station_data(final, tables, manifest)
        (folder / "operators").mkdir(exist_ok=True)
        for path in sorted(final.rglob("*")):
            if path.is_file():
                path.replace(folder / path.relative_to(final))
    except (OSError, pa.ArrowException) as error:
        raise write_error(final, error) from error
    finally:
        shutil.rmtree(final, ignore_errors=True)
    return counts


def has_table(name: str, tables: Tables, manifest: Mapping[str, Any]) -> bool:
    """Whether the run of `tables` has a file for the table `name`: of alerts, where it has detectors or raised some."""
    return name not in OPTIONAL or bool(manifest.get("detectors")) or tables.rows(name) > 0


def epoch_of(manifest: Mapping[str, Any]) -> Epoch:
    """UTC of simulated time 0 by the manifest's `start_utc` (ISO 8601); the Unix epoch if there is none."""
    text = manifest.get("start_utc")
    return Epoch.from_datetime(datetime.fromisoformat(str(text))) if text else Epoch(0)


def _write(path: Path, schema: pa.Schema, batches: Iterator[pa.RecordBatch], group: int = GROUP_ROWS) -> int:
    rows = 0
    with pq.ParquetWriter(path, schema, **parquet_options(schema)) as writer:
        for table in combine_batches(batches, group):
            writer.write_table(table, row_group_size=group)
            rows += table.num_rows
    return rows


def _write_observations(path: Path, tables: Tables, manifest: Mapping[str, Any]) -> int:
    """Write what the receivers decoded; no file if they decoded nothing."""
    batches = derive_observations(tables, origin_of(manifest), start_unix_ns_of(manifest))
    first = next(batches, None)
    if first is None:
        return 0
    return _write(path, arrow_schema("observations"), chain([first], batches), _WIDE_GROUP_ROWS)


def _write_station_data(final: Path, tables: Tables, manifest: Mapping[str, Any]) -> int:
    """Write telemetry, CSV files and tlogs in one pass over the frames at the ground stations."""
    found = survey_messages(tables)
    builder = TelemetryBuilder(found)
    operators = [str(row["id"]) for row in manifest.get("operators") or []]
    networks = {str(row["id"]): int(row.get("network", 0)) for row in manifest.get("vehicles") or []}
    with OperatorFiles(final / "operators", operators, found, epoch_of(manifest), networks) as files:
        return _write(
            final / "telemetry.parquet",
            builder.schema,
            _telemetry_batches(tables, builder, files),
            _WIDE_GROUP_ROWS,
        )


def _telemetry_batches(tables: Tables, builder: TelemetryBuilder, files: OperatorFiles) -> Iterator[pa.RecordBatch]:
    for block in read_station_frames(tables):
        files.write_tlogs(block)
        rows = ReceivedMessages(block, builder.kinds)
        files.write_csv(rows)
        yield builder.batch(rows)
