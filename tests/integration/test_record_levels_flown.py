"""Flown runs at each level: observations, forks, reports and pairs, and what is read of a run that was killed."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pytest

from skyrange.core.errors import InputError
from skyrange.metrics.exact_difference import diff
from skyrange.metrics.summary import summary
from skyrange.record import RunRecord, load
from skyrange.record.schema import LEVELS, RECORDED
from skyrange.record.verification import verify_run
from skyrange.report import write_report
from skyrange.runtime.run import Run
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.shipped import load as load_scenario
from skyrange.study.pairing import pair
from tests.flights import shared_run

pytestmark = pytest.mark.rotating


def _scenario(level: str) -> Scenario:
    return load_scenario("rid-spoofing", ["duration_s=25", f"record.level={level}"])


def _text(table: pa.Table) -> list[str]:
    """The rows as text, in which not-a-number equals itself."""
    return [repr(row) for row in table.to_pylist()]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, RunRecord]:
    found: dict[str, RunRecord] = {}
    for level in LEVELS:
        if level == "full":
            found[level] = shared_run(_scenario(level))
            continue
        run = Run.start(_scenario(level), tmp_path_factory.mktemp("levels") / level)
        run.execute()
        found[level] = load(run.recorder.path)
    return found


@pytest.mark.parametrize("level", LEVELS)
def test_a_flight_is_the_same_at_each_level(level: str, runs: dict[str, RunRecord]) -> None:
    run, full = runs[level], runs["full"]
    assert run.manifest["digests"] == full.manifest["digests"]
    assert run.outcomes == full.outcomes
    assert verify_run(run).ok
    assert diff(run, full).same
    for name in RECORDED[level]:
        assert _text(run.table(name)) == _text(full.table(name)), name
    assert full.rows("observations") > 50
    assert summary(run)["frames"] == full.rows("frames")


def test_reports_say_what_is_missing(runs: dict[str, RunRecord], tmp_path: Path) -> None:
    page = write_report(runs["study"], tmp_path / "study.html").read_text()
    assert "Recorded at level study" in page
    assert 'id="belief"' not in page
    assert 'id="air"' in page  # from observations
    assert "Recorded at level" not in write_report(runs["full"], tmp_path / "full.html").read_text()
    with pytest.raises(InputError, match=r"record\.level: summary"):
        write_report(runs["summary"], tmp_path / "summary.html")
    assert not (tmp_path / "summary.html").exists()


@pytest.mark.parametrize("level", LEVELS)
def test_forks_and_killed_runs(level: str, runs: dict[str, RunRecord], tmp_path: Path) -> None:
    run = Run.start(_scenario(level), tmp_path / "stem")
    run.advance(15.0)
    run.recorder.flush()
    killed = load(tmp_path / "stem")
    summary(killed)
    if level != "summary":
        write_report(killed, tmp_path / "killed.html")
        expected = _text(runs["full"].table("observations"))
        seen = _text(killed.table("observations"))
        assert len(seen) > 20
        assert seen == expected[: len(seen)]
    twin = run.fork(tmp_path / "twin")
    for one in (twin, run):
        one.execute()
        record = load(one.recorder.path)
        assert record.manifest["digests"] == runs["full"].manifest["digests"]
        for name in RECORDED[level]:
            assert _text(record.table(name)) == _text(runs["full"].table(name)), name


def test_a_pair_needs_frames(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"pair: record\.level: study — expected full"):
        pair(_scenario("study"), tmp_path / "pair")
    assert not (tmp_path / "pair").exists()
