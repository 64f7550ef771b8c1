"""Measures and page of the study `signing-time`: whether the station is refused or locked out, and replays obeyed."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, Final

import pyarrow as pa

from skyrange.core.time import NS_PER_S, from_seconds
from tools.docs.study_rows import Row, count, format_share, format_verdicts, list_values, select

IN_FLIGHT: Final = "in flight"
IN_FLIGHT_S: Final = 20.0
"""When the replay of commands of the flight itself begins."""
TRUE: Final = "true"
NOT_OBEYED: Final = ("received", "computer", "first-fix", "bounded", "never", "gateway")
"""The arms in which a recording of a known stream is refused."""


def measure(run: Row, kept: Mapping[str, pa.Table], reference: Mapping[str, pa.Table]) -> Row:
    """Whether heartbeats of the station are refused, it is locked out, and a replay is obeyed; `None` without one."""
    replays, in_flight = "replay" in run["time"], run["time"].endswith(IN_FLIGHT)
    connects, refused, begun, obeyed = from_seconds(float(run["connects"])), 0, None, False
    for event in kept["events"].to_pylist():
        data, at = json.loads(event["data"]), event["time_ns"]
        if event["kind"] == "event.signature_refused" and data["message"] == "HEARTBEAT":
            refused += 1
        elif event["kind"] == "event.mode":
            replayed = at >= from_seconds(IN_FLIGHT_S) if in_flight else at < connects
            obeyed |= replayed
            if data["mode"] == "AUTO" and begun is None and not (replayed and replays):
                begun = at
    return {
        "time": run["time"],
        "refused": bool(refused),
        "begun_s": None if begun is None else round(begun / NS_PER_S, 3),
        "obeyed": obeyed if replays else None,
    }


def is_locked_out(row: Row) -> bool:
    """Whether the mission has not begun."""
    return row["begun_s"] is None


def _is_refused(row: Row) -> bool:
    return bool(row["refused"])


def _is_obeyed(row: Row) -> bool:
    return bool(row["obeyed"])


def describe(rows: Sequence[Row]) -> list[str]:
    """The tables of the page."""
    times = list_values(rows, "time")
    replays = [time for time in times if "replay" in time]
    flights = len(list_values(rows, "seed"))
    counts = {count(select(rows, time=t, arm=a), holds) for t in times for a in _arms(rows) for holds in _MEASURES}
    return [
        "Flights with a refused HEARTBEAT / flights that are locked out:",
        "",
        *_table(rows, times, (_is_refused, is_locked_out)),
        "",
        "Flights in which a replay is obeyed:",
        "",
        *_table(rows, replays, (_is_obeyed,)),
        "",
        f"Intervals of the counts that occur: {'; '.join(format_share(hits, flights) for hits in sorted(counts))}.",
        "",
        *format_verdicts(_judge(rows)),
        "",
    ]


def describe_ardupilot(rows: Sequence[Row]) -> list[str]:
    """The table of the flights of an ArduPilot, which does not tell what it refuses."""
    arms, times = _arms(rows), list_values(rows, "time")
    locked = {(time, arm): count(select(rows, time=time, arm=arm), is_locked_out) for time in times for arm in arms}
    flights = len(list_values(rows, "seed"))
    held = all(hits == (flights if cell == ("ahead 1 h", "computer") else 0) for cell, hits in locked.items())
    found = ", ".join(f"{time}, {arm}: {hits}" for (time, arm), hits in locked.items() if hits) or "none"
    return [
        f"ArduCopter, flights of {flights} that are locked out:",
        "",
        *_table(rows, times, (is_locked_out,)),
        "",
        *format_verdicts([(f"locked out: {found}", held)], start=11),
        "",
    ]


_NAMES: Final = {_is_refused: "refused", is_locked_out: "locked out", _is_obeyed: "obeyed"}
_MEASURES: Final = tuple(_NAMES)


def _arms(rows: Sequence[Row]) -> list[str]:
    return sorted(list_values(rows, "arm"), key=[*NOT_OBEYED, "exempt"].index)


def _table(rows: Sequence[Row], times: Sequence[str], measures: Sequence[Any]) -> list[str]:
    arms = _arms(rows)
    lines = [f"| time | {' | '.join(arms)} |", f"|---|{'---|' * len(arms)}"]
    for time in times:
        cells = [select(rows, time=time, arm=arm) for arm in arms]
        shown = [" / ".join(str(count(cell, holds)) for holds in measures) for cell in cells]
        lines.append(f"| {time} | {' | '.join(shown)} |")
    return lines


def _judge(rows: Sequence[Row]) -> list[tuple[str, bool]]:
    """What was found of each prediction of the page, and whether it held."""
    arms, flights = _arms(rows), len(list_values(rows, "seed"))

    def counts(time: str, holds: Any) -> dict[str, int]:
        return {arm: count(select(rows, time=time, arm=arm), holds) for arm in arms}

    def compare(time: str, holds: Any, all_of: Sequence[str]) -> tuple[str, bool]:
        found = counts(time, holds)
        held = all(found[arm] == (flights if arm in all_of else 0) for arm in arms)
        return f"{_NAMES[holds]}, {time}: {_tell(found)}", held

    def join(*results: tuple[str, bool]) -> tuple[str, bool]:
        return "; ".join(text for text, _ in results), all(held for _, held in results)

    quiet = [compare(time, holds, ()) for time in (TRUE, "ahead 30 s") for holds in (_is_refused, is_locked_out)]
    ahead = [compare(time, is_locked_out, ("computer",)) for time in ("ahead 1 h", "ahead 10 years")]
    received = sum(counts(time, _is_refused)["received"] for time in ("ahead 1 h", "ahead 10 years"))
    later = [compare(f"ahead 10 years, {when}", _is_refused, ()) for when in ("connected", IN_FLIGHT)]
    most = [arm for arm in arms if arm != "bounded"]
    return [
        join(*quiet),
        join(*ahead, (f"refused in *received*: {received} of {2 * flights}", received > 0)),
        compare("ahead 10 years, since boot", is_locked_out, ("computer", "first-fix")),
        compare("ahead 20 s more each second", is_locked_out, ("computer", "bounded")),
        join(*later),
        compare("true, replay", _is_obeyed, ("never", "exempt")),
        compare("behind 1 h, replay", _is_obeyed, ("never", "exempt")),
        compare("behind 1 h, since boot, replay", _is_obeyed, most),
        compare("behind 3 days, since boot, old replay", _is_obeyed, ("exempt",)),
        compare("behind 1 h, since boot, replay in flight", _is_obeyed, ("exempt",)),
    ]


def _tell(found: Mapping[str, int]) -> str:
    some = [f"{arm} {hits}" for arm, hits in found.items() if hits]
    return ", ".join(some) or "none"
