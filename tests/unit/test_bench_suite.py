"""All benchmarks in one command: what becomes of cases, how results are read, compared and shown."""

from __future__ import annotations

import json
import re
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from skyrange.bench.isolation import run_in_process
from skyrange.bench.suite import cases, execution
from skyrange.bench.suite import machine as observation
from skyrange.bench.suite import page as figures
from skyrange.bench.suite.cases import BENCHMARKS, Benchmark, Case, Quantity, find_benchmarks
from skyrange.bench.suite.comparison import compare_results, list_differences, list_warnings
from skyrange.bench.suite.execution import run_benchmarks
from skyrange.bench.suite.machine import MAX_VALUES, Observation, list_descendants, make_series
from skyrange.bench.suite.page import make_markdown, make_page
from skyrange.bench.suite.results import Results, read_results, write_results
from skyrange.bench.suite.tables import format_value, make_tables
from skyrange.cli.app import app
from skyrange.core.errors import ComponentError, InputError

MEGABYTE = 1_000_000


def hold_memory() -> dict[str, Any]:
    held = bytearray(200 * MEGABYTE)
    held[::4096] = b"x" * len(held[::4096])
    time.sleep(1.0)
    return {"held": len(held)}


def measured(
    name: str = "sums", *, fail: bool = False, lacking: str = "", rows: Sequence[Mapping[str, Any]] = ()
) -> Benchmark:
    """A benchmark that measures nothing, at once."""

    def measure() -> Sequence[Mapping[str, Any]]:
        if fail:
            raise ComponentError("adder", "overflowed")
        return [{"sums_per_s": 1000.0, "yardstick_us": 5.0, "cpu_ms": 2.0, "bad": float("nan"), "kind": "one"}]

    def require() -> None:
        if lacking:
            raise InputError.one("adder", "PATH", "no adder", "an installed adder", lacking)

    return Benchmark(
        name,
        "Sums <b>of</b> numbers.",
        (
            Quantity("sums", "1/s", "higher", cases._key("sums_per_s")),
            Quantity("a sum", "yardsticks", "lower", cases._yardsticks("cpu_ms", 1e3), relative=True),
            Quantity("speed", "×", "higher", cases._key("sums_per_s", 0.001)),
        ),
        (Case("10 numbers", measure), Case("20 numbers", measure)),
        (Case("10 numbers", measure),),
        require=require,
    )


@pytest.fixture
def suite(monkeypatch: pytest.MonkeyPatch) -> list[Benchmark]:
    """The benchmarks that there are, which a test chooses."""
    chosen = [measured()]
    monkeypatch.setattr(observation, "yardstick_us", lambda: 8.0)
    monkeypatch.setattr(cases, "BENCHMARKS", chosen)
    return chosen


def changed(results: Results, **changes: Any) -> Results:
    """Results with other values at paths such as `benchmarks.0.cases.0.load.wall_s` (dots are double underscores)."""
    data = results.model_dump(mode="json")
    for path, value in changes.items():
        place: Any = data
        *keys, last = [int(key) if key.isdigit() else key for key in path.split("__")]
        for key in keys:
            place = place[key]
        place[last] = value
    return Results.model_validate(data)


@pytest.mark.slow
def test_memory_and_time_of_the_processes_of_a_case_are_observed() -> None:
    with Observation() as seen:
        run_in_process("held memory", hold_memory)
    peak = seen.memory.peak_mb
    assert peak is not None
    assert peak > 200.0
    assert max(seen.memory.resident_mb) == peak
    assert len(seen.memory.resident_mb) >= 3  # a second at least
    assert seen.memory.processes == 1
    assert seen.load.wall_s > 1.0
    assert seen.load.cpu_s > 0.0
    assert seen.load.yardstick_before_us > 0.0


def test_a_process_is_found_below_its_parents(tmp_path: Path) -> None:
    import os
    import subprocess

    script = "import subprocess, sys; subprocess.run([sys.executable, '-c', 'print(1, flush=True); input()'])"
    with subprocess.Popen(
        [sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        process.stdout.readline()
        found = list_descendants(os.getpid())
        assert process.pid in found
        assert set(list_descendants(process.pid)) < set(found)
        assert len(list_descendants(process.pid)) == 1
        process.communicate("\n")


def test_a_long_series_keeps_its_peak() -> None:
    samples = [float(n % 100) for n in range(5 * MAX_VALUES + 3)]
    series = make_series(samples, 2)
    assert len(series.resident_mb) <= MAX_VALUES
    assert max(series.resident_mb) == series.peak_mb == 99.0
    assert series.every_s * len(series.resident_mb) >= 0.25 * len(samples)
    assert make_series([], 0).peak_mb is None


def test_each_case_runs_and_tells(suite: list[Benchmark]) -> None:
    told: list[tuple[str, int, int]] = []
    results = run_benchmarks(on_case=lambda *one: told.append(one))
    assert told == [("sums: 10 numbers", 0, 2), ("sums: 20 numbers", 1, 2), ("benchmarks", 2, 2)]
    (benchmark,) = results.benchmarks
    assert [case.name for case in benchmark.cases] == ["10 numbers", "20 numbers"]
    (row,) = benchmark.cases[0].rows
    assert [measure.value for measure in row.measures] == [1000.0, 400.0, 1.0]
    assert row.data["bad"] is None, "JSON has no NaN"
    assert len(run_benchmarks(quick=True).benchmarks[0].cases) == 1


def test_what_cannot_run_is_skipped_and_what_fails_does_not_end_the_rest(suite: list[Benchmark]) -> None:
    suite[:] = [measured("lacks", lacking="Install it."), measured("fails", fail=True), measured("runs")]
    lacks, fails, runs = run_benchmarks().benchmarks
    assert lacks.skipped == "adder: PATH: no adder — expected an installed adder. Install it."
    assert lacks.cases == ()
    assert [case.failed for case in fails.cases] == ["adder: overflowed"] * 2
    assert [len(case.rows) for case in runs.cases] == [1, 1]
    assert not runs.skipped


def test_a_case_that_compiled_functions_runs_again(suite: list[Benchmark], monkeypatch: pytest.MonkeyPatch) -> None:
    counts = iter([10, 12, 12, 12, 12, 12])
    monkeypatch.setattr(execution, "list_compiled", lambda: next(counts))
    ran: list[int] = []
    inner = suite[0].cases[0].measure

    def measure() -> Sequence[Mapping[str, Any]]:
        ran.append(1)
        return inner()

    execution.run_case(suite[0], Case("10 numbers", measure))
    assert len(ran) == 2
    execution.run_case(suite[0], Case("10 numbers", measure))
    assert len(ran) == 3


def test_names_are_checked_before_anything_runs() -> None:
    assert find_benchmarks([]) == list(BENCHMARKS)
    assert [one.name for one in find_benchmarks(["utm", "radio"])] == ["radio", "utm"]
    with pytest.raises(InputError, match=r"bench all: --only: fleet-lite — expected .*\. Did you mean 'fleet-light'\?"):
        run_benchmarks(["fleet-lite"])


def test_every_benchmark_has_names_of_its_own() -> None:
    assert len({one.name for one in BENCHMARKS}) == len(BENCHMARKS)
    for one in BENCHMARKS:
        assert len({case.name for case in one.cases}) == len(one.cases) > 0
        assert len({quantity.name for quantity in one.quantities}) == len(one.quantities)


def test_a_measure_that_one_row_lacks_moves_no_other_one(suite: list[Benchmark]) -> None:
    data = run_benchmarks().model_dump(mode="json")
    whole = make_tables(Results.model_validate(data))[0]
    lacks = data["benchmarks"][0]["cases"][0]["rows"][0]["measures"].pop(0)["name"]
    table = make_tables(Results.model_validate(data))[0]
    assert sorted(table.head) == sorted(whole.head)
    for before, after in zip(whole.rows, table.rows, strict=True):
        cells = dict(zip(table.head, after, strict=True))
        expected = dict(zip(whole.head, before, strict=True))
        if before is whole.rows[0]:
            expected |= {head: "–" for head in whole.head if head.split(",")[0] == lacks}
        assert cells == expected


def test_results_are_read_as_they_were_written(suite: list[Benchmark], tmp_path: Path) -> None:
    results = run_benchmarks()
    write_results(results, tmp_path / "results.json")
    assert read_results(tmp_path / "results.json") == results


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", r"file:1: .* — expected JSON"),
        ("[]", r'format: not there — expected "skyrange.bench".* skyrange bench all --output FILE'),
        ('{"format": "other"}', r"format: 'other' — expected"),
        ('{"format": "skyrange.bench", "version": 2}', r"version: 2 — expected 1\. The file is of another version"),
        ('{"format": "skyrange.bench", "version": 1}', r"machine"),
    ],
)
def test_a_foreign_file_is_rejected(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "other.json"
    path.write_text(text)
    with pytest.raises(InputError, match=said) as caught:
        read_results(path)
    assert caught.value.who == str(path)


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.json: no such file or directory — expected a file of results"):
        read_results(tmp_path / "none.json")


def test_better_and_worse_follow_the_direction(suite: list[Benchmark]) -> None:
    old = run_benchmarks()
    row = "benchmarks__0__cases__0__rows__0__measures"
    new = changed(old, **{f"{row}__0__value": 1500.0, f"{row}__1__value": 500.0, f"{row}__2__value": 1.05})
    sums, cost, speed, *others = compare_results(old, new)
    assert (sums.ratio, sums.verdict) == (1.5, "better")
    assert (cost.ratio, cost.verdict) == (1.25, "worse")
    assert speed.verdict == ""
    assert {one.ratio for one in others} == {1.0}
    missing = changed(old, **{f"{row}__0__value": None})
    assert compare_results(missing, old)[0].ratio is None


def test_a_comparison_warns_of_other_machines_loads_and_sizes(suite: list[Benchmark]) -> None:
    old = changed(run_benchmarks(), benchmarks__0__cases__0__load__elsewhere_cores=0.0)
    yardsticks = {
        f"benchmarks__0__cases__{n}__load__yardstick_{when}_us": 5.0 for n in (0, 1) for when in ("before", "after")
    }
    old = changed(old, **yardsticks)
    assert list_differences(old, old) == []
    (machine,) = list_differences(old, changed(old, machine__cores=64, machine__numba="0.1"))
    assert re.search(r"machines differ.* Old: \d+; new: 64\..* new: 0\.1\.", machine)
    (load,) = list_differences(old, changed(old, benchmarks__0__cases__0__load__elsewhere_cores=1.5))
    assert "used 0.00 cores in the old and 1.50 cores in the new results during sums, 10 numbers" in load
    (speed,) = list_differences(old, changed(old, **dict.fromkeys(list(yardsticks)[:2], 10.0)))
    assert "2.00 times as long in the new results during sums, 10 numbers" in speed
    (sizes,) = list_differences(old, changed(old, quick=True))
    assert "--quick" in sizes


def test_warnings_name_the_busiest_case_and_failures(suite: list[Benchmark]) -> None:
    results = run_benchmarks()
    quiet = {f"benchmarks__0__cases__{n}__load__elsewhere_cores": 0.0 for n in (0, 1)}
    assert list_warnings(changed(results, **quiet)) == []
    busy, failed = list_warnings(
        changed(
            results,
            **quiet
            | {"benchmarks__0__cases__1__load__elsewhere_cores": 1.25, "benchmarks__0__cases__0__failed": "overflowed"},
        )
    )
    assert "1 of 2 cases, at most 1.25 cores (sums, 20 numbers)" in busy
    assert failed == "Failed: sums, 10 numbers: overflowed"


def test_relative_measures_come_first(suite: list[Benchmark]) -> None:
    (table,) = make_tables(run_benchmarks())
    assert table.head == ["case", "a sum, yardsticks", "sums, 1/s", "speed, ×"]
    assert table.rows[0] == ["10 numbers", "400", "1\u202f000", "1.00"]


@pytest.mark.parametrize(
    ("value", "text"),
    [(None, "–"), (0.0, "0"), (0.1234, "0.123"), (1.234, "1.23"), (12.34, "12.3"), (1234.5, "1\u202f234")],
)
def test_values_have_three_digits(value: float | None, text: str) -> None:
    assert format_value(value) == text


def test_a_page_shows_all_and_lets_nothing_of_the_data_be_markup(suite: list[Benchmark]) -> None:
    suite.append(measured("lacks", lacking="<script>alert(1)</script>"))
    results = run_benchmarks()
    results = changed(results, benchmarks__0__cases__0__memory__resident_mb=[10.0, 20.0, 15.0])
    results = changed(results, benchmarks__0__cases__0__memory__peak_mb=20.0)
    page = make_page(results)
    assert "<script" not in page
    assert "Sums &lt;b&gt;of&lt;/b&gt; numbers." in page
    assert "peak 20 MB" in page
    assert "peak – MB" in make_page(changed(results, benchmarks__0__cases__0__memory__peak_mb=None))
    assert page.count("Memory: sums, 10 numbers") == 2  # the figure's label and its title
    assert "Speed of each case" in page
    compared = make_page(results, changed(results, machine__cores=64))
    assert "The machines differ." in compared
    assert "Costs in yardsticks, new over old" in compared


def test_markdown_has_the_same_tables(suite: list[Benchmark]) -> None:
    text = make_markdown(run_benchmarks())
    assert "## sums\n\nSums <b>of</b> numbers.\n\n| case | a sum, yardsticks |" in text
    assert "| 10 numbers | 400 |" in text
    assert "## Load" in text


# --- the commands ----------------------------------------------------------------------------------


def test_the_command_prints_one_document_and_writes_the_same(suite: list[Benchmark], tmp_path: Path) -> None:
    output, page = tmp_path / "results.json", tmp_path / "page.html"
    done = CliRunner().invoke(app, ["bench", "all", "--json", "--output", str(output), "--page", str(page)])
    assert done.exit_code == 0, done.output
    assert Results.model_validate(json.loads(done.stdout)) == read_results(output)
    assert page.read_text().startswith("<!doctype html>")
    shown = CliRunner().invoke(app, ["bench", "all", "--quick"])
    assert re.search(r"1\.00 +400 .* sums: 10 numbers", shown.stdout)


def test_a_failed_case_is_in_the_exit_code(suite: list[Benchmark], tmp_path: Path) -> None:
    suite[:] = [measured("fails", fail=True)]
    done = CliRunner().invoke(app, ["bench", "all", "--output", str(tmp_path / "results.json")])
    assert isinstance(done.exception, ComponentError)
    assert "2 cases failed: fails, 10 numbers: adder: overflowed" in str(done.exception)
    assert len(read_results(tmp_path / "results.json").failures()) == 2


def test_a_folder_that_is_missing_is_told_before_anything_runs(suite: list[Benchmark], tmp_path: Path) -> None:
    suite[:] = [measured("fails", fail=True)]
    done = CliRunner().invoke(app, ["bench", "all", "--page", str(tmp_path / "none" / "page.html")])
    assert isinstance(done.exception, InputError)
    assert "bench all: --page:" in str(done.exception)


def test_two_results_make_a_page_with_warnings(suite: list[Benchmark], tmp_path: Path) -> None:
    results = run_benchmarks()
    write_results(results, tmp_path / "new.json")
    write_results(changed(results, machine__cores=64), tmp_path / "old.json")
    done = CliRunner().invoke(
        app, ["bench", "page", str(tmp_path / "new.json"), "--against", str(tmp_path / "old.json")]
    )
    assert done.exit_code == 0, done.output
    assert "warning: The machines differ." in done.stderr
    assert "Benchmarks, new against old" in (tmp_path / "new.html").read_text()


def test_results_without_a_common_case_are_not_compared(suite: list[Benchmark], tmp_path: Path) -> None:
    write_results(run_benchmarks(), tmp_path / "new.json")
    suite[:] = [measured("others")]
    write_results(run_benchmarks(), tmp_path / "old.json")
    done = CliRunner().invoke(
        app, ["bench", "page", str(tmp_path / "new.json"), "--against", str(tmp_path / "old.json")]
    )
    assert isinstance(done.exception, InputError)
    assert "bench page: --against:" in str(done.exception)


def test_without_a_cost_to_compare_there_is_no_figure_of_changes() -> None:
    assert figures.draw_changes([]) is None
