"""Conversion of a finished run's spool to Parquet tables, batch by batch, and to operator files if they are wanted.

All files are written to `.final/` in the run's folder and moved into place when they are complete. Until the manifest
is replaced, readers use the spool.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from itertools import chain
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from skyrange.record.manifest import origin_of, start_unix_ns_of
from skyrange.record.read.observations import derive_observations
from skyrange.record.read.station_frames import read_station_frames
from skyrange.record.read.tables import Tables, combine_batches, encoded_schema, parquet_options
from skyrange.record.read.telemetry import FOLDER
from skyrange.record.schema import DERIVED, OPTIONAL, TABLES, arrow_schema
from skyrange.record.spool import write_error
from skyrange.record.write.operator_files import OPERATORS, write_operator_files
from skyrange.record.write.telemetry_files import GROUP_ROWS, TelemetryFiles

FINAL = ".final"
"""The folder that holds finished files until all are finished."""

BLOCK_ROWS = 65_536
"""Frames at ground stations that are decoded together."""

_WIDE_GROUP_ROWS = 32_768  # observations have a column for each field of Remote ID


def finalise(folder: Path, manifest: Mapping[str, Any]) -> tuple[dict[str, int], dict[str, int]]:
    """Write all tables of the run in `folder` from its spool, and with `csv` in the manifest's `record` CSV files and
    tlogs; returns the row count per table, and that of telemetry per message.

    Raises `ComponentError` if writing fails; the record then remains in its spool.
    """
    final = folder.absolute() / FINAL  # absolute, because Arrow reads a relative name with a colon or a tilde as a URI
    tables = Tables(folder, spooled=True, trusted=True)
    counts: dict[str, int] = {}
    try:
        shutil.rmtree(final, ignore_errors=True)
        final.mkdir()
        for name in TABLES:
            if name not in DERIVED and has_table(name, tables, manifest):
                counts[name] = _write(
                    final / f"{name}.parquet", tables.schema(name), tables.batches(name, encoded=True)
                )
        observed = _write_observations(final / "observations.parquet", tables, manifest)
        if observed:
            counts["observations"] = observed
        with TelemetryFiles(final / FOLDER) as telemetry:
            for block in read_station_frames(tables, BLOCK_ROWS):
                telemetry.write(block)
        if (manifest.get("record") or {}).get("csv"):
            (final / OPERATORS).mkdir()
            write_operator_files(final / OPERATORS, tables, manifest)
        for path in sorted(final.rglob("*")):
            if path.is_file():
                target = folder / path.relative_to(final)
                target.parent.mkdir(exist_ok=True)
                path.replace(target)
    except (OSError, pa.ArrowException) as error:
        raise write_error(final, error) from error
    finally:
        shutil.rmtree(final, ignore_errors=True)
    return counts, dict(sorted(telemetry.counts.items()))


def has_table(name: str, tables: Tables, manifest: Mapping[str, Any]) -> bool:
    """Whether the run of `tables` has a file for the table `name`: of alerts, where it has detectors or raised some."""
    return name not in OPTIONAL or bool(manifest.get("detectors")) or tables.rows(name) > 0


def _write(path: Path, schema: pa.Schema, batches: Iterator[pa.RecordBatch], group: int = GROUP_ROWS) -> int:
    """Write a table with names as dictionaries, which are half as large and quicker to write than plain strings."""
    rows = 0
    with pq.ParquetWriter(path, encoded_schema(schema), **parquet_options(schema)) as writer:
        for table in combine_batches(batches, group):
            writer.write_table(table.cast(writer.schema), row_group_size=group)
            rows += table.num_rows
    return rows


def _write_observations(path: Path, tables: Tables, manifest: Mapping[str, Any]) -> int:
    """Write what the receivers decoded; no file if they decoded nothing."""
    batches = derive_observations(tables, origin_of(manifest), start_unix_ns_of(manifest))
    first = next(batches, None)
    if first is None:
        return 0
    return _write(path, arrow_schema("observations"), chain([first], batches), _WIDE_GROUP_ROWS)
