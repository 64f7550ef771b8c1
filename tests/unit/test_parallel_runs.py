"""Are kernels compiled before runs start side by side, and only if this version has not done so?"""

from __future__ import annotations

from pathlib import Path

import pytest

from skyrange.scenario.shipped import load
from skyrange.study import parallel_runs
from skyrange.study.parallel_runs import run_all


@pytest.mark.parametrize("cold", [True, False])
def test_kernels_are_compiled_once_before_all_runs(cold: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    filled: list[int | None] = []

    def fill(jobs: int | None) -> int:
        assert not list(tmp_path.iterdir()), "nothing flies before"
        filled.append(jobs)
        return 0

    monkeypatch.setattr(parallel_runs, "is_cold", lambda: cold)
    monkeypatch.setattr(parallel_runs, "fill_cache", fill)
    scenario = load("squares", ["duration_s=1"])
    results = run_all([(scenario, tmp_path / name) for name in "ab"], 2, report=False)
    assert [one.exit_code for one in results] == [0, 0]
    assert filled == ([2] if cold else [])
