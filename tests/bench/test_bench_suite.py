"""The shortest real cases of the suite, in processes of their own. No figure is asserted."""

from __future__ import annotations

import pytest

from skyrange.bench.suite.cases import Benchmark, find_benchmarks
from skyrange.bench.suite.execution import run_case

CHOSEN = find_benchmarks(["fleet-light", "attacks", "radio", "approval", "utm", "planning", "transports"])


@pytest.mark.parametrize("benchmark", [pytest.param(one, id=one.name) for one in CHOSEN])
def test_a_case_has_every_measure(benchmark: Benchmark) -> None:
    found = run_case(benchmark, benchmark.quick[0])
    assert not found.failed
    assert found.rows
    for row in found.rows:
        assert [measure.name for measure in row.measures if measure.value is None] == []
    assert found.memory.resident_mb
    assert found.load.cpu_s > 0.0
