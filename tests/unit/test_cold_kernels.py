"""Are kernels compiled before runs start side by side, and only if this version has not done so?"""

from __future__ import annotations

from pathlib import Path

import pytest

from skyrange.study.execution import plan_run
from skyrange.study.variants import compare_variants


@pytest.mark.parametrize("cold", [True, False])
def test_kernels_are_compiled_once_before_all_runs(cold: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    filled: list[int | None] = []

    def fill(jobs: int | None) -> int:
        assert not list(tmp_path.rglob("manifest.json")), "nothing flies before"
        filled.append(jobs)
        return 0

    monkeypatch.setattr(plan_run, "is_cold", lambda: cold)
    monkeypatch.setattr(plan_run, "fill_cache", fill)
    variants = {"other": ["origin=[42,-71]"]}
    compare_variants("squares", variants, tmp_path / "out", jobs=2, changes=["duration_s=1", "record.csv=false"])
    assert filled == ([2] if cold else [])
