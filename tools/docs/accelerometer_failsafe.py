"""Measures and page of the study `accelerometer-failsafe`: what comes first, a crash, a departure or the failsafe."""

from __future__ import annotations

import json
import statistics
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np
import pyarrow as pa

from skyrange.core.time import NS_PER_S, from_seconds
from skyrange.statistics.means import adjust_by_holm, sign_test
from tools.docs.study_rows import Row, count, format_share, format_verdicts, list_values, select

WINDOW_S: Final = 25.0
LEAVES_M: Final = 10.0
NONE: Final = "none"
ARMS: Final = ("default", "strict", "off")
ENDS: Final = ("crash", "leaves", "failsafe", "nothing")
_POSITION: Final = ("east_m", "north_m", "up_m")


_COLUMNS: Final = (
    "signal",
    "arm",
    *ENDS,
    "silent",
    "crash in the end",
    "no failsafe",
    "failsafe after, s",
    "farthest, m",
)


def measure(run: Row, kept: Mapping[str, pa.Table], reference: Mapping[str, pa.Table]) -> Row:
    """How long after the begin of the attack the failsafe acted, the aircraft left and crashed, `None` for never; and
    how far from the reference it came in the window.
    """
    begin = from_seconds(float(run["onset"]))
    end = begin + from_seconds(WINDOW_S)
    crashes, failsafes = [], []
    for event in kept["events"].to_pylist():
        if event["kind"] == "event.crash":
            crashes.append(event["time_ns"])
        elif event["kind"] == "event.ekf_failsafe" and json.loads(event["data"])["on"]:
            failsafes.append(event["time_ns"])
    own, other = (_positions(tables["truth"]) for tables in (kept, reference))
    common, mine, theirs = np.intersect1d(own[0], other[0], assume_unique=True, return_indices=True)
    distances = np.sqrt(((own[1][mine] - other[1][theirs]) ** 2).sum(axis=1))
    window = (common >= begin) & (common <= end)
    return {
        "signal": run["signal"],
        "failsafe_s": _first(failsafes, begin, end),
        "left_s": _first(common[distances > LEAVES_M].tolist(), begin, end),
        "crashed_s": _first(crashes, begin, end),
        "farthest_m": round(float(distances[window].max()), 1),
    }


def _positions(truth: pa.Table) -> tuple[Any, Any]:
    return truth["time_ns"].to_numpy(), np.stack([truth[name].to_numpy() for name in _POSITION], axis=1)


def _first(times: Iterable[int], begin: int, end: int) -> float | None:
    inside = [time for time in times if begin <= time <= end]
    return round((min(inside) - begin) / NS_PER_S, 3) if inside else None


def first_end(row: Row) -> str:
    """What comes first in a flight, one of `ENDS`; at the same time, in their order."""
    times = {"crash": row["crashed_s"], "leaves": row["left_s"], "failsafe": row["failsafe_s"]}
    known = {name: time for name, time in times.items() if time is not None}
    return min(known, key=known.__getitem__) if known else "nothing"


def is_silent(row: Row) -> bool:
    """Whether a flight crashes or leaves before the failsafe acts."""
    return first_end(row) in ("crash", "leaves")


def _crashes(row: Row) -> bool:
    return row["crashed_s"] is not None


def describe(rows: Sequence[Row]) -> list[str]:
    """The tables of the page."""
    return [*_list_ends(rows), "", *_compare(rows), "", *format_verdicts(_judge(rows)), ""]


def _list_ends(rows: Sequence[Row]) -> list[str]:
    lines = [
        f"| {' | '.join(_COLUMNS)} |",
        f"|{'---|' * len(_COLUMNS)}",
    ]
    for signal in list_values(rows, "signal"):
        for arm in ARMS:
            cell = select(rows, signal=signal, arm=arm)
            ends = [first_end(row) for row in cell]
            shares = [format_share(count(cell, holds), len(cell)) for holds in (is_silent, _crashes)]
            times = [row["failsafe_s"] for row in cell if row["failsafe_s"] is not None]
            after = f"{statistics.median(times):.1f} ({min(times):.1f} to {max(times):.1f})" if times else "–"
            counts = [str(ends.count(end)) for end in ENDS]
            farthest = f"{statistics.median(row['farthest_m'] for row in cell):.0f}"
            lines.append(
                f"| {' | '.join([signal, arm, *counts, *shares, str(len(cell) - len(times)), after, farthest])} |"
            )
    return lines


def _compare(rows: Sequence[Row]) -> list[str]:
    """What differs between arms, seed by seed: silent flights of default and strict, and the farthest distances of
    default and off.
    """
    signals = [signal for signal in list_values(rows, "signal") if signal != NONE]
    pairs = (
        ("strict", "default", lambda row: int(is_silent(row))),
        ("off", "default", lambda row: row["farthest_m"]),
    )
    counted = [
        [_count_differences(rows, signal, first, second, value) for signal in signals] for first, second, value in pairs
    ]
    adjusted = [adjust_by_holm([_two_sided(*counts) for counts in column]) for column in counted]
    lines = [
        "| signal | silent only in default : only in strict | p, Holm | farther in default : in off | p, Holm |",
        "|---|---|---|---|---|",
    ]
    for place, signal in enumerate(signals):
        cells = [
            f"{column[place][0]} : {column[place][1]} | {p[place]:.2g}"
            for column, p in zip(counted, adjusted, strict=True)
        ]
        lines.append(f"| {signal} | {' | '.join(cells)} |")
    return lines


def _two_sided(more: int, fewer: int) -> float:
    """The p of a sign test in both directions."""
    return min(1.0, 2.0 * sign_test(max(more, fewer), more + fewer))


def _count_differences(rows: Sequence[Row], signal: str, first: str, second: str, value: Any) -> tuple[int, int]:
    """Seeds in which a value is larger in the arm `second`, and in `first`."""
    mine, other = ({row["seed"]: value(row) for row in select(rows, signal=signal, arm=arm)} for arm in (first, second))
    return sum(other[seed] > mine[seed] for seed in mine), sum(mine[seed] > other[seed] for seed in mine)


def _judge(rows: Sequence[Row]) -> list[tuple[str, bool]]:
    """What was found of each prediction of the page, and whether it held."""

    def number(signal: str, arm: str, holds: Any) -> int:
        return count(select(rows, signal=signal, arm=arm), holds)

    def silent(signal: str, arm: str = "default") -> int:
        return number(signal, arm, is_silent)

    def first(signal: str, arm: str = "default") -> int:
        return number(signal, arm, lambda row: first_end(row) == "failsafe")

    def failed(signal: str, arm: str = "default") -> int:
        return number(signal, arm, lambda row: row["failsafe_s"] is not None)

    fast = number("up 20", "default", lambda row: row["crashed_s"] is not None and row["crashed_s"] <= 5.0)
    left = {signal: silent(signal) for signal in ("up 4", "down 4")}
    strict = {signal: first(signal, "strict") for signal in ("up 4", "down 4", "forward 4", "up 20")}
    small = {signal: (failed(signal), silent(signal)) for signal in ("up 1", "forward 1")}
    crashes = {
        (signal, arm): number(signal, arm, _crashes)
        for signal in ("forward 4", "forward 10")
        for arm in ("strict", "off")
    }
    return [
        (f"crash within 5 s in {fast}, silent in {silent('up 20')}", fast == 20 and silent("up 20") >= 18),
        (_tell("silent", left), all(value > 10 for value in left.values())),
        (
            _tell("failsafe first", {signal: first(signal) for signal in ("forward 10", "forward 4")}),
            first("forward 10") >= 18 and first("forward 4") < 18,
        ),
        (
            _tell("failsafe first", strict),
            all(value >= 18 for signal, value in strict.items() if signal != "up 20") and strict["up 20"] <= 2,
        ),
        (_tell("failsafe, silent", small), all(value == (0, 0) for value in small.values())),
        (f"silent in {silent('up 10 Hz 60')}", silent("up 10 Hz 60") <= 2),
        (
            f"failsafe in {failed(NONE)} and {failed(NONE, 'strict')}",
            failed(NONE) == failed(NONE, "strict") == 0,
        ),
        (
            _tell("crash", {f"{signal}, {arm}": value for (signal, arm), value in crashes.items()}),
            all(crashes[signal, "strict"] >= crashes[signal, "off"] for signal in ("forward 4", "forward 10")),
        ),
    ]


def describe_ardupilot(rows: Sequence[Row], builtin: Sequence[Row]) -> list[str]:
    """The tables of the flights of an ArduCopter with and without its vibration failsafe, beside the builtin ones."""
    flights = _pair_flights(rows, builtin, (("default", "no-vibe"), ("default",)))
    lines = _list_flights(flights, ("ArduCopter", "without vibration failsafe", "builtin"))
    seeds = len(list_values(rows, "seed"))
    same = count(flights, lambda trio: first_end(trio[0]) == first_end(trio[2]))
    changed = count(flights, lambda trio: first_end(trio[0]) != first_end(trio[1]))
    calm = count(flights, lambda trio: trio[0]["signal"] == NONE and {*map(first_end, trio[:2])} == {"nothing"})
    falls = count(flights, lambda trio: trio[0]["signal"] == "up 20" and _crashes(trio[0]) and _crashes(trio[1]))
    verdicts = [
        (f"the same comes first in {same} of {len(flights)}", same >= 12),
        (
            f"nothing in {calm} of {seeds} without a signal, crash in {falls} of {seeds} with up 20",
            calm == falls == seeds,
        ),
        (f"another comes first in {changed} of {len(flights)}", changed <= 2),
    ]
    return [*lines, "", *format_verdicts(verdicts, start=9), ""]


def describe_second_ardupilot(rows: Sequence[Row], builtin: Sequence[Row]) -> list[str]:
    """The tables of the second set of flights of an ArduCopter, in two arms, beside the builtin ones."""
    arms = ("default", "strict")
    flights = [four for four in _pair_flights(rows, builtin, (arms, arms)) if four[0]["signal"] != NONE]
    names = ("ArduCopter, default", "ArduCopter, strict", "builtin, default", "builtin, strict")
    constant = [four for four in flights if four[0]["signal"] in ("up 2", "down 2")]
    silent = count(constant, lambda four: first_end(four[0]) == "leaves" and four[0]["failsafe_s"] is None)
    acted = count(constant, lambda four: first_end(four[1]) == "failsafe")
    seeds = len(list_values(rows, "seed"))
    left = count(flights, lambda four: four[0]["signal"] == "up 10 Hz 60" and four[0]["left_s"] is not None)
    found = f"leaves without any failsafe in {silent} of {len(constant)}; strict: failsafe first in {acted}"
    verdicts = [(found, silent == acted == len(constant)), (f"{left} of {seeds} leave", left <= 1)]
    return [*_list_flights(flights, names), "", *format_verdicts(verdicts, start=12), ""]


def describe_lanes(rows: Sequence[Row], others: Sequence[Row]) -> list[str]:
    """The table of the flights of an ArduCopter with an error in one of its IMUs or in both; `others` are those with
    the same errors that the world made.
    """
    seeds = list_values(rows, "seed")
    lines = [f"| signal | {' | '.join(f'seed {seed}' for seed in seeds)} |", f"|---|{'---|' * len(seeds)}"]
    for signal in list_values(rows, "signal"):
        cells = [_tell_end(row) for seed in seeds for row in select(rows, signal=signal, seed=seed)]
        lines.append(f"| {signal} | {' | '.join(cells)} |")
    calm = {
        signal: count(select(rows, signal=signal), lambda row: first_end(row) == "nothing")
        for signal in ("one up 2", "one up 4")
    }
    falls = count(select(rows, signal="one up 20"), _crashes)
    both = [row for row in rows if row["signal"].startswith("both ")]
    same = count(both, lambda row: first_end(row) == first_end(_find_like(row, others)))
    verdicts = [
        (_tell("nothing", calm), all(value >= 2 for value in calm.values())),
        (f"crash in {falls} of {len(seeds)}", falls >= 2),
        (f"the same comes first in {same} of {len(both)}", same >= 7),
    ]
    return [*lines, "", *format_verdicts(verdicts, start=14), ""]


def _find_like(row: Row, others: Sequence[Row]) -> Row:
    """The flight of the same error and seed in the arm *default*."""
    signal = row["signal"].removeprefix("both ")
    (found,) = select(others, signal=signal, seed=row["seed"], arm="default")
    return found


def _pair_flights(
    rows: Sequence[Row], builtin: Sequence[Row], arms: tuple[Sequence[str], Sequence[str]]
) -> list[list[Row]]:
    """The flights of each signal and seed: those of `rows` in the first arms, and the builtin ones in the others."""
    flights = []
    for row in select(rows, arm="default"):
        where = {"signal": row["signal"], "seed": row["seed"]}
        flights.append(
            [
                one
                for source, chosen in zip((rows, builtin), arms, strict=True)
                for arm in chosen
                for one in select(source, arm=arm, **where)
            ]
        )
    return flights


def _list_flights(flights: Sequence[Sequence[Row]], names: Sequence[str]) -> list[str]:
    lines = [f"| signal | seed | {' | '.join(names)} |", f"|---|---|{'---|' * len(names)}"]
    lines += [f"| {rows[0]['signal']} | {rows[0]['seed']} | {' | '.join(map(_tell_end, rows))} |" for rows in flights]
    return lines


def _tell_end(row: Row) -> str:
    """What comes first and when, and a crash and a failsafe later."""
    end = first_end(row)
    times = {"leaves": row["left_s"], "failsafe": row["failsafe_s"], "crash": row["crashed_s"]}
    known = sorted((time, name) for name, time in times.items() if time is not None)
    told = ", ".join(f"{name} {time:.1f} s" for time, name in known)
    return f"**{end}**: {told}; {row['farthest_m']:.0f} m" if known else f"**{end}**; {row['farthest_m']:.0f} m"


def _tell(what: str, values: Mapping[str, Any]) -> str:
    shown = {
        name: " and ".join(map(str, value)) if isinstance(value, tuple) else value for name, value in values.items()
    }
    return f"{what}: " + "; ".join(f"{name}: {value}" for name, value in shown.items())
