"""Comparison of two runs within a tolerance in time, for runs that cannot repeat to the byte.

These are live runs, and runs with programs that keep their own time. Events, decisions, outcomes and flown paths are
compared.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_S, to_seconds
from skyrange.metrics.aircraft import Ticks, departures, read_ticks
from skyrange.metrics.time_series import vehicles
from skyrange.record.notes import parse_details
from skyrange.record.read.run import RunRecord, load

Key = tuple[str, str, str, str, str]
"""Table, kind, about, source, and as JSON the details that are text, Boolean values or whole numbers."""

_COUNTER = "count"
"""A detail that is a running count: one additional note at the start would change it in all later notes."""
_SHOWN = 20


@dataclass(frozen=True, slots=True)
class Unmatched:
    """A note without a counterpart within the tolerance; `a_s` and `b_s` are its times, `None` if a run lacks it."""

    table: str
    kind: str
    about: str
    source: str
    details: str
    a_s: float | None
    b_s: float | None

    def __str__(self) -> str:
        what = f"{self.about}: {self.kind} {self.details}".removesuffix(" {}")
        if self.a_s is None or self.b_s is None:
            return f"{what}: only in {'a' if self.b_s is None else 'b'}, at {self.a_s or self.b_s or 0.0:.3f} s"
        return f"{what}: at {self.a_s:.3f} s | {self.b_s:.3f} s"


@dataclass(frozen=True, slots=True)
class KindAgreement:
    """The notes of one kind: how many have a counterpart, and the time differences, a's minus b's, in s."""

    found: int
    median_s: float
    """Median of the absolute differences."""
    least_s: float
    most_s: float


@dataclass(frozen=True, slots=True)
class PathDifference:
    """Largest distances in m between an aircraft's positions in the two runs."""

    apart_m: float
    """At the same time."""
    off_m: float
    """From the path in b within the tolerance in time: the deviation that a mere delay does not explain."""


@dataclass(frozen=True, slots=True)
class Agreement:
    """How two runs agree. `a` and `b` are their folders; the comparison ends at `until_s`, the shorter run's end."""

    a: str
    b: str
    tolerance_s: float
    until_s: float
    kinds: Mapping[str, KindAgreement]
    odd: Sequence[Unmatched]
    """In order of time."""
    outcomes: Mapping[str, tuple[Any, Any]]
    """By aircraft, if state or reason differ."""
    ways: Mapping[str, PathDifference]
    """By aircraft; empty if the fleets differ."""

    @property
    def agree(self) -> bool:
        """Whether every note has a counterpart and all outcomes agree."""
        return not self.odd and not self.outcomes

    def to_dict(self) -> dict[str, Any]:
        """The result as JSON values."""
        return {**asdict(self), "agree": self.agree}

    def __str__(self) -> str:
        lines = [f"a: {self.a}", f"b: {self.b}"]
        paired = sum(kind.found for kind in self.kinds.values())
        verdict = "agree" if self.agree else "do not agree"
        lines.append(
            f"they {verdict} within {self.tolerance_s:g} s until {self.until_s:g} s, by {paired} notes in both"
        )
        for name, kind in sorted(self.kinds.items(), key=lambda item: -max(-item[1].least_s, item[1].most_s)):
            lines.append(f"  {kind.found:>5} {name}: {kind.least_s:+.3f} to {kind.most_s:+.3f} s")
        lines += [str(odd) for odd in self.odd[:_SHOWN]]
        if len(self.odd) > _SHOWN:
            lines.append(f"and {len(self.odd) - _SHOWN} more")
        for vehicle, (first, second) in self.outcomes.items():
            lines.append(f"outcome of {vehicle}: {_said(first)} | {_said(second)}")
        for vehicle, difference in self.ways.items():
            lines.append(
                f"{vehicle}: up to {difference.apart_m:.3g} m apart, {difference.off_m:.3g} m off the other's way"
            )
        return "\n".join(lines)


def agreement(a: RunRecord | Path | str, b: RunRecord | Path | str, tolerance_s: float) -> Agreement:
    """Compare two runs; raises `InputError` for a folder that is not a run's and for an invalid tolerance.

    Two notes are counterparts if they have the same kind, subject and source, the same text, Boolean values and whole
    numbers among their details (measured values and running counts may differ), and times at most `tolerance_s` apart.
    A note without a counterpart is unmatched; it is listed with the next such note of the other run, if there is one.
    Notes missing in the last `tolerance_s` of the shorter run are ignored, since they may have come just after its end.
    """
    if not 0.0 < tolerance_s < 3600.0:
        raise InputError.one("diff", "tolerance", f"{tolerance_s:g}", "seconds, more than 0 and less than 3600")
    left, right = (run if isinstance(run, RunRecord) else load(run) for run in (a, b))
    until_s = min(left.duration, right.duration)
    first_times, second_times = (_noted(run, round(until_s * NS_PER_S)) for run in (left, right))
    apart: dict[str, list[float]] = {}
    odd: list[Unmatched] = []
    for key in {**first_times, **second_times}:
        for at, other_ns in _paired(first_times.get(key, []), second_times.get(key, []), round(tolerance_s * NS_PER_S)):
            if at is not None and other_ns is not None:
                apart.setdefault(key[1], []).append(to_seconds(at) - to_seconds(other_ns))
                if abs(at - other_ns) <= tolerance_s * NS_PER_S:
                    continue
            elif to_seconds(at if at is not None else other_ns or 0) > until_s - tolerance_s:
                continue
            odd.append(
                Unmatched(*key, *(None if time_ns is None else to_seconds(time_ns) for time_ns in (at, other_ns)))
            )
    return Agreement(
        a=str(left.path),
        b=str(right.path),
        tolerance_s=tolerance_s,
        until_s=until_s,
        kinds={name: _kind(values) for name, values in apart.items()},
        odd=sorted(
            odd,
            key=lambda unmatched: (
                unmatched.b_s if unmatched.a_s is None else unmatched.a_s,
                unmatched.about,
                unmatched.kind,
            ),
        ),
        outcomes=_outcomes(left, right, until_s),
        ways=_ways(left, right, tolerance_s),
    )


def _noted(run: RunRecord, until_ns: int) -> dict[Key, list[int]]:
    """The times of all notes by key, in ascending order."""
    times_by_key: dict[Key, list[int]] = {}
    for table in ("events", "decisions"):
        for row in run.table(table, ["time_ns", "kind", "about", "source", "data"]).to_pylist():
            if row["time_ns"] <= until_ns:
                data = parse_details(row["data"]).items()
                whole = {name: value for name, value in data if not isinstance(value, float) and name != _COUNTER}
                details = json.dumps(whole, sort_keys=True, ensure_ascii=False)
                times_by_key.setdefault((table, row["kind"], row["about"], row["source"], details), []).append(
                    row["time_ns"]
                )
    for times in times_by_key.values():
        times.sort()
    return times_by_key


def _paired(a: Sequence[int], b: Sequence[int], tolerance_ns: int) -> Iterator[tuple[int | None, int | None]]:
    """Counterparts within the tolerance, then the remaining notes paired in order, then those left over."""
    left: tuple[list[int], list[int]] = [], []
    i = j = 0
    while i < len(a) and j < len(b):
        if abs(a[i] - b[j]) <= tolerance_ns:
            yield a[i], b[j]
            i, j = i + 1, j + 1
        elif a[i] < b[j]:
            left[0].append(a[i])
            i += 1
        else:
            left[1].append(b[j])
            j += 1
    first, second = [*left[0], *a[i:]], [*left[1], *b[j:]]
    both = min(len(first), len(second))
    yield from zip(first[:both], second[:both], strict=True)
    yield from ((at, None) for at in first[both:])
    yield from ((None, at) for at in second[both:])


def _kind(apart_s: Sequence[float]) -> KindAgreement:
    amounts = sorted(map(abs, apart_s))
    return KindAgreement(len(amounts), amounts[len(amounts) // 2], min(apart_s), max(apart_s))


def _outcomes(a: RunRecord, b: RunRecord, until_s: float) -> dict[str, tuple[Any, Any]]:
    """Outcomes that differ in more than their time; one after the shorter run's end counts as unfinished."""
    differing = {}
    for vehicle in sorted({*a.outcomes, *b.outcomes}):
        first, second = (_until(run.outcomes.get(vehicle), until_s) for run in (a, b))
        if [first.get(name) for name in ("state", "reason")] != [second.get(name) for name in ("state", "reason")]:
            differing[vehicle] = first, second
    return differing


def _until(entry: Mapping[str, Any] | None, until_s: float) -> dict[str, Any]:
    if not entry or entry.get("finished_s") is None or entry["finished_s"] > until_s:
        return {"state": "unfinished", "reason": "", "finished_s": None}
    return dict(entry)


def _said(entry: Mapping[str, Any]) -> str:
    return f"{entry.get('state')} {entry.get('reason') or ''}".strip()


def _ways(a: RunRecord, b: RunRecord, tolerance_s: float) -> dict[str, PathDifference]:
    names = [vehicle.id for vehicle in vehicles(a)]
    if not names or names != [vehicle.id for vehicle in vehicles(b)]:
        return {}
    first_ticks, second_ticks = read_ticks(a), read_ticks(b)
    apart_m, _ = departures(first_ticks, second_ticks)
    off_m = _off_m(first_ticks, second_ticks, tolerance_s)
    return {
        name: PathDifference(float(far), float(off_m[k]))
        for k, (name, far) in enumerate(zip(names, apart_m, strict=True))
    }


def _off_m(a: Ticks, b: Ticks, tolerance_s: float) -> NDArray[np.float64]:
    """(n,) the largest distance of each aircraft from the part of its path in b within the tolerance in time.

    Times near either end, for which that part of the path is incomplete, are left out.
    """
    _, first_rows, second_rows = np.intersect1d(a.time_ns, b.time_ns, assume_unique=True, return_indices=True)
    if len(first_rows) < 2:
        return np.zeros(a.enu_m.shape[1])
    here, other_path = a.enu_m[first_rows], b.enu_m[second_rows]
    steps = max(1, int(tolerance_s * NS_PER_S // max(int(np.median(np.diff(b.time_ns[second_rows]))), 1)))
    best = ((here - other_path) ** 2).sum(axis=2)
    for shift in range(-steps, steps):
        first = np.clip(np.arange(len(other_path)) + shift, 0, len(other_path) - 1)
        start, leg = other_path[first], other_path[np.minimum(first + 1, len(other_path) - 1)] - other_path[first]
        length2 = np.maximum((leg**2).sum(axis=2), 1e-12)
        share = np.clip(((here - start) * leg).sum(axis=2) / length2, 0.0, 1.0)
        best = np.minimum(best, ((here - start - share[:, :, None] * leg) ** 2).sum(axis=2))
    off: NDArray[np.float64] = np.sqrt(best[steps:-steps]).max(axis=0, initial=0.0)
    return off
