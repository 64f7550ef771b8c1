"""Does `skyrange compare` fly every variant with every seed, and tell what differs?"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from skyrange.core.errors import InputError
from skyrange.metrics.time_series import read_notes
from skyrange.study import run_measures
from skyrange.study.run_measures import measure_run
from skyrange.study.variants import compare_variants, make_tables, write_comparison_report
from tests.flights import shared_run

SOON = [
    "duration_s=9", "operators.blue.vehicles.b1.depart_s=8", "operators.blue.request_ahead_s=6",
    "attacks.squat.params.until_s=60",
]  # fmt: skip
"""Blue asks after 2 s for a flight after 8 s, and the street is claimed for a minute."""
APPROVALS = {"all": ["operators.*.approval=approve-all"], "hash": ["operators.*.approval=hashgraph"]}


@pytest.mark.rotating
def test_three_approvals_of_one_scenario_are_compared(tmp_path: Path) -> None:
    result = compare_variants("approval.squat", APPROVALS, tmp_path / "cmp", seeds=2, jobs=1, changes=SOON)
    assert list(result.changes) == ["unchanged", "all", "hash"]
    assert len(result.measured) == 6
    delays = {variant: result.delays_s(variant)["blue"].mean for variant in result.changes}
    assert delays["all"] == 0.0
    assert delays["unchanged"] > 30.0
    assert delays["hash"] > 30.0
    latency = {variant: result.interval(variant, "answer, median") for variant in result.changes}
    assert latency["hash"] is not None
    assert latency["unchanged"] is not None
    assert latency["hash"].mean > latency["unchanged"].mean
    first, second = make_tables(result)
    assert first.head == ["measure", "unchanged", "all", "hash"]
    assert ["rejections", "1 (all 2 agree)", "0 (all 2 agree)", "1 (all 2 agree)"] in first.rows
    assert [row[0] for row in second.rows] == ["blue", "amber"] or [row[0] for row in second.rows] == ["amber", "blue"]
    report = write_comparison_report(result)
    page = report.read_text()
    for variant in result.changes:
        for seed in result.seeds:
            assert f'href="{result.folder(variant, seed)}/report.html"' in page
            assert (result.path / result.folder(variant, seed) / "report.html").is_file()
    assert "<svg" in page
    verdict = page[page.index('class="verdict"') : page.index("</header>")]
    assert verdict.index("issions complete") < verdict.index("delay, mean: unchanged ")
    assert "all 0 s" in verdict
    assert json.loads((result.path / "comparison.json").read_text())["variants"][1]["name"] == "all"


def test_what_is_wrong_with_a_variant_is_named_before_a_folder_is_made(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nobody"):
        compare_variants("approval.squat", {"x": ["operators.*.approval=nobody"]}, tmp_path / "cmp")
    assert not (tmp_path / "cmp").exists()


def test_a_collision_of_two_aircraft_counts_once_and_one_with_a_building_as_well(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    record = shared_run("head-on")
    assert measure_run(record).values["collisions"] == 1.0
    notes = read_notes(record, "events")
    hit = next(row for row in notes if row.kind == "event.collision")
    wall = replace(hit, time_ns=hit.time_ns + 1, data={"with": "building"})
    monkeypatch.setattr(run_measures, "read_notes", lambda _, table: [*notes, wall] if table == "events" else [])
    assert measure_run(record).values["collisions"] == 2.0
