"""Input of scoring: the tables of flights, attacks, intrusions and alerts, with their columns, units and rules."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import pyarrow as pa
import pyarrow.compute as pc

from skyrange.core.errors import InputError, Problem, nearest
from skyrange.statistics.clusters import keep_first

SPLITS: Final = ("train", "validation", "test")
"""Parts of a study: detectors are trained on the first, thresholds chosen on the second, scores are of the third."""
NOMINAL: Final = "nominal"
"""The arm without attack, sham or fault: its flights give the false-alarm rate."""
TRIVIAL: Final = ("always", "by-time", "never")
"""Names of the trivial detectors; no other detector may have them."""


def _field(name: str, kind: pa.DataType, about: str) -> pa.Field:
    return pa.field(name, kind, nullable=False, metadata={"about": about})


FLIGHTS: Final = pa.schema(
    [
        _field("run", pa.string(), "Id of the run, unique in the study."),
        _field("block", pa.string(), "Scenario draw: all arms of one draw form a block, and lie in one split."),
        _field(
            "cluster",
            pa.string(),
            "Blocks that share a seed or a flight are a cluster: it lies in one split, and is one independent sample.",
        ),
        _field(
            "flight",
            pa.string(),
            "Runs with the same text are one flight, which counts once. Empty: not known.",
        ),
        _field("arm", pa.string(), "Arm of the block: nominal, attacked, sham, fault, …"),
        _field("split", pa.string(), "Part of the study: train, validation or test."),
        _field("city", pa.string(), "City over which the run was flown; may be empty."),
        _field("aircraft", pa.int64(), "Number of aircraft of the run."),
        _field("vehicle", pa.string(), "Id of the aircraft; one row for each aircraft of each run."),
        _field("duration_s", pa.float64(), "Airborne time of this aircraft, in seconds."),
        _field(
            "own_from_s",
            pa.float64(),
            "Time from which the run differs from the nominal one of its block, in seconds; 0 where there is none.",
        ),
        _field("shared_s", pa.float64(), "Airborne time of this aircraft before that, which counts in that run."),
        _field("hostile", pa.bool_(), "Whether an attack acts in this run."),
        _field("fault", pa.bool_(), "Whether a benign fault acts in this run."),
    ]
)
"""One row for each aircraft of each run."""
ATTACKS: Final = pa.schema(
    [
        _field("run", pa.string(), "Id of the run."),
        _field("vehicle", pa.string(), "Aircraft that the attack affects; empty if it affects the whole run."),
        _field("attack_id", pa.string(), "Id of the attack in its scenario."),
        _field("kind", pa.string(), "Dotted kind of the attack, such as gnss.drift."),
        _field("family", pa.string(), "Family of mechanisms that the kind belongs to."),
        _field("active_s", pa.float64(), "Time at which it starts to act, in seconds of simulated time."),
        _field("stop_s", pa.float64(), "Time at which it stops, in seconds; not before active_s."),
        _field(
            "effect_end_s",
            pa.float64(),
            "Time at which its effect ends, by the record of the run, in seconds; not before stop_s.",
        ),
        _field("observable_s", pa.float64(), "First time at which the sensor could see it, in seconds; NaN if never."),
        _field("effect_s", pa.float64(), "First effect on the outcome of the aircraft, in seconds; NaN if none."),
    ]
)
"""One row for each attack on each aircraft that it affects, or for each attack on a whole run."""
INTRUSIONS: Final = pa.schema(
    [
        _field("run", pa.string(), "Id of the run."),
        _field("vehicle", pa.string(), "Aircraft that the act is about; empty if it is about the whole run."),
        _field("attack_id", pa.string(), "Id of the attack in its scenario whose sham it is."),
        _field("kind", pa.string(), "Dotted kind of that attack, such as mavlink.mode."),
        _field("active_s", pa.float64(), "Time at which it starts to act, in seconds of simulated time."),
        _field("stop_s", pa.float64(), "Time at which it stops, in seconds; not before active_s."),
    ]
)
"""One row for each harmless intrusion about each aircraft, or about a whole run."""
ALERTS: Final = pa.schema(
    [
        _field("run", pa.string(), "Id of the run."),
        _field("detector", pa.string(), "Name of the detector."),
        _field("time_s", pa.float64(), "Time of the alert, in seconds of simulated time."),
        _field("subject", pa.string(), "Aircraft that the alert is about; empty if it names none of the run."),
        _field("kind", pa.string(), "Kind of the alert, as the detector says; scoring does not use it."),
        _field("score", pa.float64(), "Score: the higher, the surer. Not compared between detectors."),
    ]
)
"""One row for each alert, of all detectors, with all scores: scoring applies the threshold."""
_NAN_ALLOWED = frozenset({"observable_s", "effect_s"})
_PER_RUN = ("block", "cluster", "flight", "arm", "split", "city", "aircraft", "own_from_s", "hostile", "fault")


@dataclass(frozen=True, slots=True)
class StudyTables:
    """The tables of a study, checked: their schemas are `FLIGHTS`, `ATTACKS`, `ALERTS` and `INTRUSIONS`."""

    flights: pa.Table
    attacks: pa.Table
    alerts: pa.Table
    intrusions: pa.Table

    def detectors(self) -> list[str]:
        """Names of the detectors that raised alerts, sorted."""
        return sorted(set(self.alerts.column("detector").unique().to_pylist()))


def check_tables(
    flights: pa.Table, attacks: pa.Table, alerts: pa.Table, intrusions: pa.Table | None = None
) -> StudyTables:
    """The tables of a study, cast to their schemas; further columns are dropped. Without `intrusions` there are none.

    Raises InputError that lists missing columns, values of another type, null and non-finite numbers, aircraft listed
    twice, runs whose rows disagree, blocks, clusters and
    flights in two splits, and attacks, intrusions and alerts that do not belong to the flights.
    """
    tables = [
        _cast(given, schema, name)
        for given, schema, name in (
            (flights, FLIGHTS, "flights"),
            (attacks, ATTACKS, "attacks"),
            (alerts, ALERTS, "alerts"),
            (INTRUSIONS.empty_table() if intrusions is None else intrusions, INTRUSIONS, "intrusions"),
        )
    ]
    checked = StudyTables(*tables)
    problems = _flight_problems(checked.flights)
    if not problems:
        problems = _attack_problems(checked) + _intrusion_problems(checked) + _alert_problems(checked)
    if problems:
        raise InputError("tables of the study", problems)
    return checked


def keep_each_flight_once(tables: StudyTables) -> tuple[StudyTables, int]:
    """The tables without runs that are the same flight as another one, and how many these are.

    Of the runs of one flight the nominal one stays, else the first by name. Runs with other attacks stay beside each
    other: an attack that only listens leaves the flight as it is, and is none the less to be found.
    """
    acts: dict[str, set[tuple[str, str, float, float]]] = {}
    for row in tables.attacks.to_pylist():
        acts.setdefault(row["run"], set()).add((row["kind"], row["vehicle"], row["active_s"], row["stop_s"]))
    rows = {row["run"]: row for row in tables.flights.to_pylist()}
    runs = sorted(rows, key=lambda run: (rows[run]["arm"] != NOMINAL, run))
    first = keep_first([(rows[run]["flight"] or run, frozenset(acts.get(run, ()))) for run in runs])
    kept = pa.array([run for run, is_first in zip(runs, first, strict=True) if is_first], pa.string())
    chosen = (
        table.filter(pc.is_in(table.column("run"), value_set=kept))
        for table in (tables.flights, tables.attacks, tables.alerts, tables.intrusions)
    )
    return StudyTables(*chosen), len(runs) - len(kept)


def _cast(table: pa.Table, schema: pa.Schema, name: str) -> pa.Table:
    """`table` with exactly the columns of `schema`. Raises InputError."""
    problems, columns = [], []
    for field in schema:
        if field.name not in table.column_names:
            hint = nearest(field.name, table.column_names)
            problems.append(Problem(name, f"no column {field.name}", f"a column {field.name} ({field.type})", hint))
            continue
        column = table.column(field.name)
        try:
            column = column.cast(field.type)
        except (pa.ArrowInvalid, pa.ArrowNotImplementedError):
            problems.append(Problem(f"{name}.{field.name}", str(column.type), f"values of type {field.type}"))
            continue
        if column.null_count:
            problems.append(Problem(f"{name}.{field.name}", f"{column.null_count} nulls", "a value in each row"))
        elif pa.types.is_floating(field.type):
            bad = [str(value) for value in _unbounded(column, field.name)]
            if bad:
                problems.append(Problem(f"{name}.{field.name}", ", ".join(bad[:3]), "finite numbers"))
        columns.append(column)
    if problems:
        raise InputError("tables of the study", problems)
    return pa.table(columns, schema=schema)


def _unbounded(column: pa.ChunkedArray, name: str) -> list[float]:
    import numpy as np

    values = column.to_numpy()
    bad = np.isinf(values) if name in _NAN_ALLOWED else ~np.isfinite(values)
    return [float(value) for value in np.unique(values[bad])]


def _flight_problems(flights: pa.Table) -> list[Problem]:
    problems: list[Problem] = []
    seen: set[tuple[str, str]] = set()
    first: dict[str, dict[str, object]] = {}
    split_of: dict[tuple[str, str], str] = {}
    for number, row in enumerate(flights.to_pylist()):
        where = f"flights, row {number}"
        key = (row["run"], row["vehicle"])
        if not row["vehicle"]:
            problems.append(Problem(f"{where}, vehicle", "''", "the id of an aircraft"))
        if key in seen:
            problems.append(Problem(where, f"{row['run']}, {row['vehicle']}", "each aircraft of a run once"))
        seen.add(key)
        if row["split"] not in SPLITS:
            problems.append(Problem(f"{where}, split", row["split"], "train, validation or test"))
        if row["duration_s"] < 0:
            problems.append(Problem(f"{where}, duration_s", f"{row['duration_s']:g}", "no negative time"))
        if row["aircraft"] < 1:
            problems.append(Problem(f"{where}, aircraft", str(row["aircraft"]), "at least 1"))
        shared = {name: row[name] for name in _PER_RUN}
        for name, value in first.setdefault(row["run"], shared).items():
            if row[name] != value:
                expected = f"{value!r}, as in the other rows of run {row['run']}"
                problems.append(Problem(f"{where}, {name}", repr(row[name]), expected))
        if not 0 <= row["shared_s"] <= row["duration_s"]:
            expected = f"0 to duration_s, {row['duration_s']:g}"
            problems.append(Problem(f"{where}, shared_s", f"{row['shared_s']:g}", expected))
        for name in ("block", "cluster", "flight"):
            first_split = split_of.setdefault((name, row[name]), row["split"])
            if first_split != row["split"] and row[name]:
                expected = f"{first_split}, as in the other runs of {name} {row[name]}"
                problems.append(Problem(f"{where}, split", row["split"], expected))
    return problems


def _attack_problems(tables: StudyTables) -> list[Problem]:
    problems: list[Problem] = []
    vehicles = vehicles_by_run(tables.flights)
    hostile = dict(
        zip(tables.flights.column("run").to_pylist(), tables.flights.column("hostile").to_pylist(), strict=True)
    )
    family_of: dict[str, str] = {}
    seen: set[tuple[str, str, str, float]] = set()
    for number, row in enumerate(tables.attacks.to_pylist()):
        where = f"attacks, row {number}"
        run, vehicle = row["run"], row["vehicle"]
        problems += _act_problems(where, row, vehicles)
        if run not in vehicles:
            continue
        if not hostile[run]:
            problems.append(Problem(f"{where}, run", run, "a run whose flights are hostile"))
        if row["effect_end_s"] < row["stop_s"]:
            expected = f"not before stop_s, {row['stop_s']:g}"
            problems.append(Problem(f"{where}, effect_end_s", f"{row['effect_end_s']:g}", expected))
        problems += [
            Problem(f"{where}, {name}", f"{row[name]:g}", f"not before active_s, {row['active_s']:g}, or NaN")
            for name in ("observable_s", "effect_s")
            if row[name] < row["active_s"]
        ]
        if family_of.setdefault(row["kind"], row["family"]) != row["family"]:
            expected = f"{family_of[row['kind']]}, as in the other rows of kind {row['kind']}"
            problems.append(Problem(f"{where}, family", row["family"], expected))
        key = (run, vehicle, row["attack_id"], row["active_s"])
        if key in seen:
            problems.append(Problem(where, f"{run}, {vehicle}, {row['attack_id']}", "each episode of acting once"))
        seen.add(key)
    attacked = set(tables.attacks.column("run").to_pylist())
    problems += [
        Problem("flights, hostile", f"run {run}", "an attack of this run in the table of attacks")
        for run, acts in sorted(hostile.items())
        if acts and run not in attacked
    ]
    return problems


def _intrusion_problems(tables: StudyTables) -> list[Problem]:
    vehicles = vehicles_by_run(tables.flights)
    rows = enumerate(tables.intrusions.to_pylist())
    return [problem for number, row in rows for problem in _act_problems(f"intrusions, row {number}", row, vehicles)]


def _act_problems(where: str, row: Mapping[str, Any], vehicles: Mapping[str, list[str]]) -> Iterator[Problem]:
    """What is wrong with the run, aircraft and times of an attack or intrusion."""
    run, vehicle = row["run"], row["vehicle"]
    if run not in vehicles:
        yield Problem(f"{where}, run", run, "a run of the flights", nearest(run, vehicles))
        return
    if vehicle and vehicle not in vehicles[run]:
        hint = nearest(vehicle, vehicles[run])
        yield Problem(f"{where}, vehicle", vehicle, f"an aircraft of run {run}, or ''", hint)
    if row["stop_s"] < row["active_s"]:
        yield Problem(f"{where}, stop_s", f"{row['stop_s']:g}", f"not before {row['active_s']:g}")


def _alert_problems(tables: StudyTables) -> list[Problem]:
    vehicles = vehicles_by_run(tables.flights)
    problems = [
        Problem("alerts, detector", repr(name), f"a name that is not empty and none of {', '.join(TRIVIAL)}")
        for name in tables.detectors()
        if not name or name in TRIVIAL
    ]
    pairs = tables.alerts.select(["run", "subject"]).group_by(["run", "subject"]).aggregate([])
    for row in sorted(pairs.to_pylist(), key=lambda row: (row["run"], row["subject"])):
        run, subject = row["run"], row["subject"]
        if run not in vehicles:
            problems.append(Problem("alerts, run", run, "a run of the flights", nearest(run, vehicles)))
        elif subject and subject not in vehicles[run]:
            hint = nearest(subject, vehicles[run]) or "A subject that is no aircraft of the run is written as ''."
            problems.append(Problem("alerts, subject", subject, f"an aircraft of run {run}, or ''", hint))
    return problems


def vehicles_by_run(flights: pa.Table) -> dict[str, list[str]]:
    """By run, its aircraft, sorted."""
    vehicles: dict[str, list[str]] = {}
    for run, vehicle in sorted(
        zip(flights.column("run").to_pylist(), flights.column("vehicle").to_pylist(), strict=True)
    ):
        vehicles.setdefault(run, []).append(vehicle)
    return vehicles
