"""Index of a study's tables for scoring: numbers instead of names, times in ns, and the windows of attacks.

Rows are sorted by name, so the order of the tables' rows has no effect on any score.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from typing import Final, Literal, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.core.time import NEVER, NS_PER_S
from skyrange.scoring.tables import NOMINAL, StudyTables

STRATA: Final = ("nominal", "sham", "fault", "hostile")
"""Kinds of flights by which false alarms are counted, in the order of the numbers below."""
NOMINAL_STRATUM, SHAM_STRATUM, FAULT_STRATUM, HOSTILE_STRATUM = range(4)


@dataclass(frozen=True, slots=True)
class Subjects:
    """What an alert can be about: each aircraft of each run, then each run, for alerts that name no aircraft."""

    runs: tuple[str, ...]
    vehicles: tuple[str, ...]
    """Empty for a run."""
    blocks: NDArray[np.int64]
    """Rank of the block's name, shape (n,), as all arrays here."""
    clusters: NDArray[np.int64]
    """Rank of the cluster's name."""
    strata: NDArray[np.int64]
    """Index in `STRATA`."""
    splits: NDArray[np.str_]
    cities: NDArray[np.str_]
    aircraft: NDArray[np.int64]
    duration_ns: NDArray[np.int64]
    """Airborne time; 0 for a run."""
    own_from_ns: NDArray[np.int64]
    """Alarms before it are those of the nominal run of the block, and count there."""
    exposure_ns: NDArray[np.int64]
    """Airborne time from then on, less that of attacks on and intrusions about this aircraft, with their grace; 0 for a
    run."""


@dataclass(frozen=True, slots=True)
class Attacks:
    """The attacks, sorted by run, aircraft, id and onset; all arrays of shape (n,)."""

    runs: tuple[str, ...]
    kinds: NDArray[np.str_]
    families: NDArray[np.str_]
    clusters: NDArray[np.int64]
    splits: NDArray[np.str_]
    cities: NDArray[np.str_]
    aircraft: NDArray[np.int64]
    begin_ns: NDArray[np.int64]
    """When it could first be detected; `NEVER` if not before the end of its window."""
    end_ns: NDArray[np.int64]
    """When its window ends: its stop, or the end of its effect, and the grace."""
    effect_ns: NDArray[np.int64]
    """`NEVER` without an effect."""
    affected: NDArray[np.int64]
    """Number of aircraft on which an alarm counts as detection."""

    @property
    def observable(self) -> NDArray[np.bool_]:
        """Which attacks the sensor could have seen."""
        return np.not_equal(self.begin_ns, NEVER)


class Windows(NamedTuple):
    """The spans in which alarms about a subject are not false; one row for each attack and subject, shape (n,)."""

    attacks: NDArray[np.int64]
    subjects: NDArray[np.int64]
    act_ns: NDArray[np.int64]
    """When the attack starts to act: from here on alarms are not false."""
    begin_ns: NDArray[np.int64]
    """When it could first be detected: from here on alarms are detections; `NEVER` if it could not."""
    end_ns: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Intrusions:
    """The harmless intrusions, sorted by run, aircraft, id and onset; all arrays of shape (n,)."""

    runs: tuple[str, ...]
    clusters: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class AlertList:
    """Alerts of one detector, sorted by subject, then time; all arrays of shape (n,)."""

    subjects: NDArray[np.int64]
    times_ns: NDArray[np.int64]
    scores: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class StudyIndex:
    """All that scoring reads of the flights and attacks of a study."""

    subjects: Subjects
    attacks: Attacks
    windows: Windows
    intrusions: Intrusions
    intrusion_windows: Windows
    """The spans in which alarms are about intrusions: neither detections nor false."""
    numbers: dict[tuple[str, str], int]
    """By run and aircraft, the index of the subject; an empty aircraft stands for the run."""
    digest: str
    """BLAKE2b of the rows of flights, attacks and intrusions, sorted: equal for the same study."""


WindowKind = Literal["acts", "effect"]
"""What ends the window of an attack: its stop, or the end of its effect. The grace comes after it."""


def index_study(tables: StudyTables, grace_s: float, window: WindowKind = "acts") -> StudyIndex:
    """The index of checked tables; an attack's window ends `grace_s` after its stop, or after the end of its effect,
    that of a harmless intrusion after its stop.
    """
    flights = sorted(tables.flights.to_pylist(), key=lambda row: (row["run"], row["vehicle"]))
    first = {row["run"]: row for row in reversed(flights)}
    runs = sorted(first)
    rows = flights + [first[run] | {"vehicle": "", "duration_s": 0.0, "shared_s": 0.0} for run in runs]
    numbers = {(row["run"], row["vehicle"]): number for number, row in enumerate(rows)}
    blocks, clusters = (_rank(row[name] for row in flights) for name in ("block", "cluster"))
    acts, harmless = (
        sorted(table.to_pylist(), key=lambda row: (row["run"], row["vehicle"], row["attack_id"], row["active_s"]))
        for table in (tables.attacks, tables.intrusions)
    )
    affected, grace_ns = _affected(acts, runs, flights, numbers), round(grace_s * NS_PER_S)
    windows = _windows(acts, affected, grace_ns, "stop_s" if window == "acts" else "effect_end_s", "observable_s")
    touched = _affected(harmless, runs, flights, numbers)
    harmless_windows = _windows(harmless, touched, grace_ns, "stop_s", "active_s")
    duration_ns = _to_ns([row["duration_s"] for row in rows])
    subjects = Subjects(
        runs=tuple(row["run"] for row in rows),
        vehicles=tuple(row["vehicle"] for row in rows),
        blocks=np.array([blocks[row["block"]] for row in rows], dtype=np.int64),
        clusters=np.array([clusters[row["cluster"]] for row in rows], dtype=np.int64),
        strata=np.array([_stratum(row) for row in rows], dtype=np.int64),
        splits=np.array([row["split"] for row in rows], dtype=np.str_),
        cities=np.array([row["city"] for row in rows], dtype=np.str_),
        aircraft=np.array([row["aircraft"] for row in rows], dtype=np.int64),
        duration_ns=duration_ns,
        own_from_ns=_to_ns([row["own_from_s"] for row in rows]),
        exposure_ns=np.maximum(
            duration_ns
            - _to_ns([row["shared_s"] for row in rows])
            - _covered_ns((windows, harmless_windows), len(rows)),
            0,
        ),
    )
    homes = [first[row["run"]] for row in acts]
    first_windows = np.searchsorted(windows.attacks, np.arange(len(acts)))
    attacks = Attacks(
        runs=tuple(row["run"] for row in acts),
        kinds=np.array([row["kind"] for row in acts], dtype=np.str_),
        families=np.array([row["family"] for row in acts], dtype=np.str_),
        clusters=np.array([clusters[row["cluster"]] for row in homes], dtype=np.int64),
        splits=np.array([row["split"] for row in homes], dtype=np.str_),
        cities=np.array([row["city"] for row in homes], dtype=np.str_),
        aircraft=np.array([row["aircraft"] for row in homes], dtype=np.int64),
        begin_ns=windows.begin_ns[first_windows],
        end_ns=windows.end_ns[first_windows],
        effect_ns=_to_ns([row["effect_s"] for row in acts]),
        affected=np.array(
            [sum(1 for number in numbers_of if number < len(flights)) for numbers_of in affected], dtype=np.int64
        ),
    )
    intrusions = Intrusions(
        runs=tuple(row["run"] for row in harmless),
        clusters=np.array([clusters[first[row["run"]]["cluster"]] for row in harmless], dtype=np.int64),
    )
    digest = _digest(flights, acts, harmless)
    return StudyIndex(subjects, attacks, windows, intrusions, harmless_windows, numbers, digest)


def _rank(names: Iterable[str]) -> dict[str, int]:
    return {name: rank for rank, name in enumerate(sorted(set(names)))}


def index_alerts(index: StudyIndex, alerts: pa.Table, detector: str) -> AlertList:
    """The alerts of `detector` in a checked table of alerts."""
    detector_alerts = alerts.filter(pc.equal(alerts.column("detector"), detector)).combine_chunks()
    runs = detector_alerts.column("run").combine_chunks().dictionary_encode()
    names = detector_alerts.column("subject").combine_chunks().dictionary_encode()
    pairs = np.stack([runs.indices.to_numpy(), names.indices.to_numpy()], axis=1)
    distinct, inverse = np.unique(pairs, axis=0, return_inverse=True)
    run_names, subject_names = runs.dictionary.to_pylist(), names.dictionary.to_pylist()
    known = np.array([index.numbers[run_names[run], subject_names[name]] for run, name in distinct], dtype=np.int64)
    subjects = known[inverse.reshape(-1)] if len(known) else np.zeros(0, dtype=np.int64)
    times_ns = np.rint(detector_alerts.column("time_s").to_numpy() * NS_PER_S).astype(np.int64)
    return sort_alerts(subjects, times_ns, detector_alerts.column("score").to_numpy())


def sort_alerts(subjects: NDArray[np.int64], times_ns: NDArray[np.int64], scores: NDArray[np.float64]) -> AlertList:
    """Alerts in the order of an `AlertList`."""
    order = np.lexsort((scores, times_ns, subjects))
    return AlertList(subjects[order], times_ns[order], scores[order])


def _stratum(row: dict[str, object]) -> int:
    if row["hostile"]:
        return HOSTILE_STRATUM
    if row["fault"]:
        return FAULT_STRATUM
    return NOMINAL_STRATUM if row["arm"] == NOMINAL else SHAM_STRATUM


def _affected(
    acts: list[dict[str, object]],
    runs: list[str],
    flights: list[dict[str, object]],
    numbers: dict[tuple[str, str], int],
) -> list[list[int]]:
    """By attack, the subjects on which an alarm detects it: its aircraft, or all of its run and the run itself."""
    whole: dict[str, list[int]] = {run: [] for run in runs}
    for number, row in enumerate(flights):
        whole[str(row["run"])].append(number)
    affected = []
    for row in acts:
        run, vehicle = str(row["run"]), str(row["vehicle"])
        affected.append([numbers[run, vehicle]] if vehicle else [*whole[run], numbers[run, ""]])
    return affected


def _windows(acts: list[dict[str, object]], affected: list[list[int]], grace_ns: int, end: str, begin: str) -> Windows:
    """The windows of acts; `end` and `begin` name their columns."""
    counts = [len(numbers) for numbers in affected]
    which = np.repeat(np.arange(len(acts)), counts).astype(np.int64)
    end_ns = _to_ns([row[end] for row in acts]) + grace_ns
    begin_ns = _to_ns([row[begin] for row in acts])
    return Windows(
        attacks=which,
        subjects=np.array([number for numbers in affected for number in numbers], dtype=np.int64),
        act_ns=_to_ns([row["active_s"] for row in acts])[which],
        begin_ns=np.where(begin_ns > end_ns, NEVER, begin_ns)[which],
        end_ns=end_ns[which],
    )


def _covered_ns(windows: Sequence[Windows], subjects: int) -> NDArray[np.int64]:
    """By subject, the time within any of its windows; overlapping spans count once."""
    total = np.zeros(subjects, dtype=np.int64)
    reached: dict[int, int] = {}
    who, acts, ends = (
        np.concatenate([getattr(group, name) for group in windows]) for name in ("subjects", "act_ns", "end_ns")
    )
    for row in np.lexsort((acts, who)).tolist():
        subject, act, end = int(who[row]), int(acts[row]), int(ends[row])
        begin = max(act, reached.get(subject, act))
        total[subject] += max(0, end - begin)
        reached[subject] = max(end, reached.get(subject, end))
    return total


def _to_ns(seconds: list[object]) -> NDArray[np.int64]:
    """Whole nanoseconds; `NEVER` for NaN."""
    values = np.array(seconds, dtype=np.float64)
    never = np.isnan(values)
    return np.where(never, NEVER, np.rint(np.where(never, 0.0, values) * NS_PER_S).astype(np.int64))


def _digest(*tables: list[dict[str, object]]) -> str:
    text = repr([tuple(row.values()) for rows in tables for row in rows])
    return blake2b(text.encode(), digest_size=16).hexdigest()
