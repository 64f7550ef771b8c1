"""The shortest real cases of the suite, whole in processes of their own, and smaller here. No figure is asserted."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import pytest

from skyrange.bench import approval, attacks, fleet, planning, radio
from skyrange.bench.suite.cases import Benchmark, find_benchmarks
from skyrange.bench.suite.execution import run_case
from tests.bench.in_process import measure_here

CHOSEN = find_benchmarks(["fleet-light", "attacks", "radio", "approval", "utm", "planning", "transports"])


SMALL: Mapping[str, Callable[[], Sequence[Mapping[str, Any]]]] = {
    "fleet-light": lambda: [fleet.measure(1, 1.0)],
    "attacks": lambda: attacks.measure(1, 1.0),
    "radio": lambda: [radio.measure(5, 2.0)],
    "approval": lambda: [approval.measure(active=10, requests=10)],
    "planning": lambda: [planning.measure(planning.load_city(None), 2, 200.0, 30.0, 60.0)],
}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name == "attacks" else name for name in SMALL]
)
def test_a_small_case_has_every_measure(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    measure_here(monkeypatch, fleet, attacks)
    (benchmark,) = find_benchmarks([name])
    rows = SMALL[name]()
    assert rows
    for row in rows:
        measures = [quantity.measure(row, 8.0) for quantity in benchmark.quantities]
        assert [measure.name for measure in measures if measure.value is None] == []


@pytest.mark.slow
@pytest.mark.parametrize("benchmark", [pytest.param(one, id=one.name) for one in CHOSEN])
def test_a_case_has_every_measure(benchmark: Benchmark) -> None:
    found = run_case(benchmark, benchmark.quick[0])
    assert not found.failed
    assert found.rows
    for row in found.rows:
        assert [measure.name for measure in row.measures if measure.value is None] == []
    assert found.memory.resident_mb
    assert found.load.cpu_s > 0.0
