"""How does a spool become the folder that people open? Parquet tables and the operators' files, batch by batch.

Everything is written beside the record, in `.final/`, and moved into place when it is whole; until the
manifest is replaced, readers use the spool.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from skyrange.core.time import Epoch
from skyrange.record.schema import OPTIONAL, TABLES
from skyrange.record.spool import cannot_write
from skyrange.record.stationfiles import StationFiles
from skyrange.record.stations import seen, survey
from skyrange.record.tables import Tables, concat, encodings
from skyrange.record.telemetry import Received, TelemetryBuilder

FINAL = ".final"
"""The folder in which finished files wait until all are."""

GROUP_ROWS = 131_072
"""Rows of a Parquet row group: what a reader must hold at least."""

_WIDE_GROUP_ROWS = 32_768  # telemetry has a column per MAVLink field, hundreds where much is asked for


def finalise(folder: Path, manifest: Mapping[str, Any]) -> dict[str, int]:
    """Write all tables, CSVs and tlogs of the run in `folder` from its spool; returns rows by table.

    `ComponentError` where the disk refuses: the record is then as before, still in its spool.
    """
    final = folder.absolute() / FINAL  # a relative name with a colon or a tilde is no file's name to Arrow
    tables = Tables(folder, spooled=True)
    counts: dict[str, int] = {}
    try:
        shutil.rmtree(final, ignore_errors=True)
        (final / "operators").mkdir(parents=True)
        for name in TABLES:
            if name != "telemetry" and has_table(name, tables, manifest):
                counts[name] = _write(final / f"{name}.parquet", tables.schema(name), tables.batches(name))
        counts["telemetry"] = _stations(final, tables, manifest)
        (folder / "operators").mkdir(exist_ok=True)
        for path in sorted(final.rglob("*")):
            if path.is_file():
                path.replace(folder / path.relative_to(final))
    except (OSError, pa.ArrowException) as error:
        raise cannot_write(final, error) from error
    finally:
        shutil.rmtree(final, ignore_errors=True)
    return counts


def has_table(name: str, tables: Tables, manifest: Mapping[str, Any]) -> bool:
    """Whether the run of `tables` has a file for the table `name`: of alerts, where it has detectors or raised some."""
    return name not in OPTIONAL or bool(manifest.get("detectors")) or tables.rows(name) > 0


def epoch_of(manifest: Mapping[str, Any]) -> Epoch:
    """UTC of simulated time 0 by the manifest's `start_utc` (ISO 8601); the Unix epoch where none is given."""
    text = manifest.get("start_utc")
    return Epoch.from_datetime(datetime.fromisoformat(str(text))) if text else Epoch(0)


def _write(path: Path, schema: pa.Schema, batches: Iterator[pa.RecordBatch], group: int = GROUP_ROWS) -> int:
    rows = 0
    with pq.ParquetWriter(path, schema, **encodings(schema)) as writer:
        for table in concat(batches, group):
            writer.write_table(table, row_group_size=group)
            rows += table.num_rows
    return rows


def _stations(final: Path, tables: Tables, manifest: Mapping[str, Any]) -> int:
    """Telemetry, CSV and tlog in one pass over what the ground stations saw."""
    found = survey(tables)
    builder = TelemetryBuilder(found)
    operators = [str(row["id"]) for row in manifest.get("operators") or []]
    networks = {str(row["id"]): int(row.get("network", 0)) for row in manifest.get("vehicles") or []}
    with StationFiles(final / "operators", operators, found, epoch_of(manifest), networks) as files:
        return _write(
            final / "telemetry.parquet",
            builder.schema,
            _received(tables, builder, files),
            _WIDE_GROUP_ROWS,
        )


def _received(tables: Tables, builder: TelemetryBuilder, files: StationFiles) -> Iterator[pa.RecordBatch]:
    for block in seen(tables):
        files.heard(block)
        rows = Received(block, builder.kinds)
        files.received(rows)
        yield builder.batch(rows)
