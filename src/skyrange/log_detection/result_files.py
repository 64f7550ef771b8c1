"""Results of detection as plain data and files: JSON, and alerts as Parquet and CSV."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq

from skyrange.core.files import atomic_write
from skyrange.core.time import NS_PER_S
from skyrange.export.csv_tables import write_csv
from skyrange.log_detection.airborne import airborne_ns
from skyrange.log_detection.false_alarms import DetectorRates, FalseAlarmRate, warn_of_copies
from skyrange.log_detection.judging import Findings
from skyrange.record.notes import alert_batch, alert_row, parse_details

PARQUET: Final = "alerts.parquet"
CSV: Final = "alerts.csv"
JSON: Final = "detection.json"


def describe(findings: Sequence[Findings], rates: Sequence[DetectorRates] | None) -> dict[str, Any]:
    """The findings as plain data for JSON; `rates` are those of benign logs, None if they were not said to be."""
    return {
        "logs": [_describe_log(found) for found in findings],
        "false_alarms": None if rates is None else [_describe_rates(rate) for rate in rates],
        "warnings": [] if rates is None else warn_of_copies(findings),
    }


def _describe_log(found: Findings) -> dict[str, Any]:
    log, epoch = found.log, found.log.epoch
    return {
        "log": str(log.path),
        "format": log.format,
        "time_0_utc": epoch.iso(0),
        "first_s": found.first_ns / NS_PER_S,
        "last_s": found.last_ns / NS_PER_S,
        "frames": found.frames,
        "observed": [
            {
                "subject": one.subject,
                "observed_s": one.observed_ns / NS_PER_S,
                "airborne_s": airborne_ns(one.airborne) / NS_PER_S,
                "flights_s": [[begin / NS_PER_S, end / NS_PER_S] for begin, end in one.airborne],
            }
            for one in found.exposures
        ],
        "remarks": [one._asdict() for one in found.remarks],
        "not_run": [one._asdict() for one in found.choice.left_out],
        "detectors": [
            {
                "id": one.id,
                "kind": one.kind,
                "ends": [f"{port.endpoint} of {port.link}" for port in one.ends],
                "less": list(one.less),
                "note": one.note,
            }
            for one in found.choice.chosen
        ],
        "alerts": [_describe_alert(row) for row in map(alert_row_of, found.alerts)],
    }


def alert_row_of(raised: Any) -> tuple[Any, ...]:
    """An alert as a row of the table `alerts` of a run. Raises `ComponentError` if its details are not scalars."""
    return alert_row(raised.time_ns, raised.detector, raised.alert)


def _describe_alert(row: Sequence[Any]) -> dict[str, Any]:
    time_ns, detector, kind, subject, score, at_ns, data = row
    return {
        "time_ns": time_ns, "detector": detector, "kind": kind, "subject": subject, "score": score, "at_ns": at_ns,
        "data": parse_details(data),
    }  # fmt: skip


def _describe_rates(rates: DetectorRates) -> dict[str, Any]:
    return {
        "detector": rates.detector,
        "kind": rates.kind,
        "logs": rates.logs,
        "alerts": rates.alerts,
        "whole": _describe_rate(rates.whole),
        "airborne": _describe_rate(rates.airborne),
    }


def _describe_rate(rate: FalseAlarmRate) -> dict[str, Any]:
    low, high = rate.limits
    return {
        "episodes": rate.episodes,
        "hours": rate.hours,
        "per_h": rate.per_h,
        "limits_per_h": [low, high if math.isfinite(high) else None],
        "lowest_claimable_per_h": rate.lowest_per_h if math.isfinite(rate.lowest_per_h) else None,
    }


def alert_table(findings: Sequence[Findings]) -> pa.Table:
    """The alerts of all logs: the columns of a run's `alerts`, after the log and the UTC of what they are about."""
    tables = []
    for found in findings:
        batch = alert_batch([alert_row_of(raised) for raised in found.alerts])
        utc_us = [found.log.epoch.utc_us(int(at)) for at in batch.column("at_ns").to_pylist()]
        head = pa.table(
            {
                "log": pa.array([str(found.log.path)] * batch.num_rows, pa.string()),
                "utc": pa.array(utc_us, pa.timestamp("us", tz="UTC")),
            }
        )
        table = pa.Table.from_batches([batch])
        fields = [*head.schema, *table.schema]
        tables.append(pa.table([*head.columns, *table.columns], schema=pa.schema(fields)))
    return pa.concat_tables(tables)


def write_results(findings: Sequence[Findings], rates: Sequence[DetectorRates] | None, folder: Path) -> dict[str, Path]:
    """Write JSON, Parquet and CSV into a folder that exists; their paths by name. Raises `OSError`."""
    table = alert_table(findings)
    with atomic_write(folder / PARQUET) as file:
        pq.write_table(table, file)
    write_csv(folder / CSV, iter(table.to_batches()), table.schema)
    with atomic_write(folder / JSON) as file:
        file.write((json.dumps(describe(findings, rates), indent=1, ensure_ascii=False) + "\n").encode())
    return {name: folder / name for name in (PARQUET, CSV, JSON)}
