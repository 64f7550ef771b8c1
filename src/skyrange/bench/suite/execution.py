"""Execution of the benchmarks, one case after the other: rows, load of the machine, and memory over time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

from pydantic import JsonValue

from skyrange.bench.suite.cases import Benchmark, Case, find_benchmarks
from skyrange.bench.suite.machine import Observation, describe_machine
from skyrange.bench.suite.results import FORMAT, VERSION, BenchmarkResult, CaseResult, Results, Row
from skyrange.core.compiled import list_compiled
from skyrange.core.errors import SkyrangeError

OnCase = Callable[[str, int, int], None]
"""Called before each case and at the end: what runs, how many cases are done, and of how many."""
NOT_QUICK = "no part of --quick"


def run_benchmarks(names: Sequence[str] = (), *, quick: bool = False, on_case: OnCase | None = None) -> Results:
    """Run the benchmarks of these names, all without names, and return what they measured.

    With `quick` the sizes are smaller. A benchmark that cannot run, because a package or a program is not installed,
    is skipped with the reason; a case that raises a `SkyrangeError` has failed, and the next one runs. Raises
    `InputError` for an unknown name.
    """
    chosen = find_benchmarks(names)
    reasons = {benchmark.name: _missing(benchmark, quick=quick) for benchmark in chosen}
    planned = {
        benchmark.name: () if reasons[benchmark.name] else benchmark.quick if quick else benchmark.cases
        for benchmark in chosen
    }
    total, done = sum(map(len, planned.values())), 0
    started = datetime.now(UTC)

    def run(benchmark: Benchmark) -> Iterator[CaseResult]:
        nonlocal done
        for case in planned[benchmark.name]:
            if on_case is not None:
                on_case(f"{benchmark.name}: {case.name}", done, total)
            yield run_case(benchmark, case)
            done += 1

    results = [
        BenchmarkResult(
            name=benchmark.name, about=benchmark.about, skipped=reasons[benchmark.name], cases=tuple(run(benchmark))
        )
        for benchmark in chosen
    ]
    if on_case is not None:
        on_case("benchmarks", total, total)
    return Results(
        format=FORMAT,
        version=VERSION,
        skyrange=version("skyrange"),
        started=started,
        quick=quick,
        machine=describe_machine(),
        benchmarks=tuple(results),
    )


def run_case(benchmark: Benchmark, case: Case) -> CaseResult:
    """Run one case and observe its processes. One that compiled numeric functions runs again, without that."""
    for _ in range(2):
        compiled = list_compiled()
        rows: Sequence[Mapping[str, Any]] = ()
        failed = ""
        with Observation() as observed:
            try:
                rows = case.measure()
            except SkyrangeError as error:
                failed = str(error)
        if list_compiled() == compiled:
            break
    yardstick_us = 0.5 * (observed.load.yardstick_before_us + observed.load.yardstick_after_us)
    return CaseResult(
        name=case.name,
        failed=failed,
        rows=tuple(
            Row(
                name=str(row[benchmark.row_key]) if benchmark.row_key else "",
                measures=tuple(quantity.measure(row, yardstick_us) for quantity in benchmark.quantities),
                data={key: _plain(value) for key, value in row.items()},
            )
            for row in rows
        ),
        load=observed.load,
        memory=observed.memory,
    )


def _missing(benchmark: Benchmark, *, quick: bool) -> str:
    """Why a benchmark cannot run here; "" if it can."""
    if quick and not benchmark.quick:
        return NOT_QUICK
    try:
        benchmark.require()
    except SkyrangeError as error:
        return str(error)
    return ""


def _plain(value: Any) -> JsonValue:
    """A value that JSON can hold; a number that is not finite is null."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value  # type: ignore[no-any-return]
