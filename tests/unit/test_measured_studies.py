"""Measures of the shipped studies that have a page, and that the pages have the tables of their data."""

from __future__ import annotations

import json
import shutil
import statistics
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from tools.docs import accelerometer_failsafe, measure_studies, signing_time
from tools.docs.measure_studies import DOCS, STUDIES, read_data, write_page
from tools.docs.study_rows import select

SECOND = 10**9


def events(*notes: tuple[float, str, dict[str, Any]]) -> pa.Table:
    return pa.table(
        {
            "time_ns": pa.array([round(at_s * SECOND) for at_s, _, _ in notes], pa.int64()),
            "kind": pa.array([kind for _, kind, _ in notes], pa.string()),
            "data": pa.array([json.dumps(data) for _, _, data in notes], pa.string()),
        }
    )


def track(east_m: list[float]) -> pa.Table:
    """A second between rows, from 20 s on."""
    zeros = np.zeros(len(east_m))
    times = (np.arange(len(east_m)) + 20) * SECOND
    return pa.table({"time_ns": times, "east_m": east_m, "north_m": zeros, "up_m": zeros})


@pytest.mark.parametrize(
    ("notes", "east_m", "expected", "end"),
    [
        ([], [0.0, 9.0, 10.0], (None, None, None, 10.0), "nothing"),
        ([(22.0, "event.ekf_failsafe", {"on": True})], [0.0, 11.0, 12.0], (1.5, 0.5, None, 12.0), "leaves"),
        ([(20.8, "event.ekf_failsafe", {"on": True})], [0.0, 11.0, 12.0], (0.3, 0.5, None, 12.0), "failsafe"),
        ([(20.8, "event.ekf_failsafe", {"on": False})], [0.0, 0.0, 0.0], (None, None, None, 0.0), "nothing"),
        ([(20.9, "event.crash", {}), (21.0, "event.crash", {})], [0.0, 0.0, 11.0], (None, 1.5, 0.4, 11.0), "crash"),
        ([(20.4, "event.crash", {}), (45.6, "event.crash", {})], [99.0, 0.0, 0.0], (None, None, None, 0.0), "nothing"),
    ],
)
def test_what_comes_first_in_the_window_of_an_attacked_accelerometer(
    notes: list[Any], east_m: list[float], expected: tuple[Any, ...], end: str
) -> None:
    run = {"onset": 20.5, "signal": "up 4"}
    kept, reference = ({"events": events(*notes), "truth": track(path)} for path in (east_m, [0.0, 0.0, 0.0]))
    row = accelerometer_failsafe.measure(run, kept, reference)
    assert (row["failsafe_s"], row["left_s"], row["crashed_s"], row["farthest_m"]) == expected
    assert accelerometer_failsafe.first_end(row) == end


AUTO, GUIDED = ("event.mode", {"mode": "AUTO"}), ("event.mode", {"mode": "GUIDED"})


@pytest.mark.parametrize(
    ("time", "notes", "refused", "locked_out", "obeyed"),
    [
        ("true", [(7.0, *GUIDED), (15.0, *AUTO)], False, False, None),
        ("ahead 1 h", [(6.5, "event.signature_refused", {"message": "HEARTBEAT"})], True, True, None),
        (
            "true, replay",
            [(3.0, "event.signature_refused", {"message": "COMMAND_LONG"}), (15.0, *AUTO)],
            0,
            False,
            False,
        ),
        ("true, replay", [(3.0, *GUIDED), (15.0, *AUTO)], False, False, True),
        ("replay in flight", [(7.0, *GUIDED), (15.0, *AUTO)], False, False, False),
        ("replay in flight", [(7.0, *GUIDED), (21.0, *AUTO)], False, True, True),
    ],
)
def test_what_false_time_does_to_a_station(
    time: str, notes: list[Any], refused: bool, locked_out: bool, obeyed: bool | None
) -> None:
    row = signing_time.measure({"time": time, "connects": 6.0}, {"events": events(*notes)}, {})
    assert (row["refused"], signing_time.is_locked_out(row), row["obeyed"]) == (refused, locked_out, obeyed)


@pytest.mark.parametrize("name", sorted(STUDIES))
def test_the_page_has_the_tables_of_its_data(name: str, tmp_path: Path) -> None:
    page = DOCS / "explanation" / f"{STUDIES[name].page}.md"
    copy = tmp_path / "page.md"
    shutil.copyfile(page, copy)
    write_page(name, read_data(name), copy)
    assert copy.read_text() == page.read_text()


def test_figures_in_the_text_are_those_of_the_data() -> None:
    rows = read_data("accelerometer-failsafe")

    def cell(signal: str, arm: str = "default") -> list[Any]:
        return select(rows, signal=signal, arm=arm)

    def ends(signal: str, arm: str = "default") -> Counter[str]:
        return Counter(map(accelerometer_failsafe.first_end, cell(signal, arm)))

    def farthest(signal: str) -> int:
        return round(float(statistics.median(row["farthest_m"] for row in cell(signal))))

    text = " ".join((DOCS / "explanation" / "accelerometer-failsafe.md").read_text().split())
    first = sum(ends(f"forward {size}")["failsafe"] for size in (2, 4, 10))
    assert f"comes first in {first} of 60 flights with forward 2, 4 and 10" in text
    assert ends("up 1", "strict")["failsafe"] == 20
    assert f"of which {ends('up 1')['nothing']} would have stayed within 10 m" in text
    assert f"climbs out of its height by {farthest('up 10 Hz 60')} m" in text
    assert f"with down 20 the aircraft climbs by {farthest('down 20')} m" in text
    assert f"the median of the largest distance is {farthest('up 2')} and {farthest('down 2')} m" in text
    assert all(row["failsafe_s"] is None for signal in ("up 2", "down 2", "up 20") for row in cell(signal))
    assert all(row["crashed_s"] < 5.0 for arm in accelerometer_failsafe.ARMS for row in cell("up 20", arm))


def test_a_study_with_a_run_that_failed_is_not_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "plan.json").write_text('{"blocks": 1}')
    runs = pa.table({"block": ["p0000-s1"], "arm": ["default"], "error": ["it fell"], "point": [0], "seed": [1]})
    monkeypatch.setattr(measure_studies, "read_results", lambda folder, table: runs)
    with pytest.raises(ValueError, match="it fell"):
        measure_studies.measure("accelerometer-failsafe", tmp_path)
