"""Report of a study: levels of factors, intervals over blocks, figures, and text that nobody trusts."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyrange.study.sweep.block_files import BlockResult, write_block
from skyrange.study.sweep.design.blocks import Block
from skyrange.study.sweep.design.factors import Factor
from skyrange.study.sweep.design.model import Study
from skyrange.study.sweep.execution.worker import note_failure
from skyrange.study.sweep.folder import create_folder
from skyrange.study.sweep.report.bootstrap import bootstrap_mean, standardised_effect
from skyrange.study.sweep.report.page import write_study_report
from skyrange.study.sweep.report.response import find_levels, trace_response


@given(st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=30))
def test_an_interval_holds_the_mean_and_repeats(samples: list[float]) -> None:
    found = bootstrap_mean(samples, "a")
    assert found is not None
    assert found == bootstrap_mean(samples, "a")
    assert found.low is not None
    assert found.high is not None
    assert min(samples) - 1e-6 <= found.low <= found.high <= max(samples) + 1e-6


def test_intervals_cover_the_true_mean_about_as_often_as_they_say() -> None:
    chance = np.random.default_rng(1)
    found = [bootstrap_mean(chance.normal(3.0, 1.0, 40).tolist(), str(number)) for number in range(200)]
    covered = sum(one.low <= 3.0 <= one.high for one in found if one and one.low is not None and one.high is not None)
    assert 0.88 <= covered / 200 <= 0.99


def test_the_standardised_effect_of_pairs() -> None:
    assert standardised_effect([1.0, 3.0]) == pytest.approx(2.0 / 2.0**0.5)
    assert standardised_effect([2.0, 2.0]) is None
    assert standardised_effect([2.0]) is None


@given(st.lists(st.floats(0, 100), min_size=1, max_size=60))
def test_levels_hold_each_block_once_and_are_in_order(values: list[float]) -> None:
    blocks = [Block(f"b{number}", number, 1, {"f": value}) for number, value in enumerate(values)]
    levels = find_levels(blocks, "f")
    assert sorted(name for level in levels for name in level.blocks) == sorted(block.name for block in blocks)
    assert [level.at for level in levels] == sorted(level.at for level in levels)
    assert len(levels) <= 8


def test_a_response_is_that_of_the_blocks_of_each_level() -> None:
    blocks = [Block(f"b{number}", number, 1, {"f": number % 2}) for number in range(6)]
    samples = {f"b{number}": float(number) for number in range(6)}
    levels = find_levels(blocks, "f")
    curve = trace_response("arm", 0, levels, samples, "a")
    assert [(at, mean.mean, mean.n) for at, mean in curve.points] == [(0.0, 2.0, 3), (1.0, 3.0, 3)]
    some = trace_response("arm", 0, levels, samples, "a", frozenset({"b0", "b1"}))
    assert [(at, mean.mean) for at, mean in some.points] == [(0.0, 0.0), (1.0, 1.0)]


def test_the_report_has_effects_curves_interactions_and_failures_and_escapes_text(tmp_path: Path) -> None:
    study = Study(
        name="s",
        scenario="gnss.jump",
        seeds=2,
        factors=(
            Factor(name="size", key="attacks.jump.start_s", values=(10, 20)),
            Factor(name="word", key="operators.blue.id", values=("<b>a</b>", "b")),
        ),
    )
    folder = create_folder(study, tmp_path / "s")
    for block in folder.blocks[:-1]:
        head: dict[str, Any] = {"block": block.name, "point": block.point, "seed": block.seed, **block.values}
        departure = 2.0 * block.values["size"] + block.seed
        effects = [
            {**head, "arm": "attacked", "vehicle": v, "departure_m": d} for v, d in (("a", 1.0), ("b", departure))
        ]
        runs = [{**head, "arm": arm, "status": "complete", "collisions": 0.0} for arm in ("nominal", "attacked")]
        rows = {"runs": runs, "effects": effects, "aircraft": [], "alerts": [], "acts": []}
        write_block(folder.path, BlockResult(block.name, 2, 0, (), 1.0, 1.0, 0), rows)
    note_failure(study, folder.blocks[-1], folder.path, "its process was ended by <SIGKILL>")
    page = write_study_report(folder.path).read_text()
    assert "<b>a</b>" not in page
    assert "&lt;SIGKILL&gt;" in page
    assert "collisions (" not in page  # they are 0 everywhere
    figures = sorted(path.name for path in (folder.path / "figures").glob("*.svg"))
    assert figures == ["departure_m-by-size-and-word.svg", "departure_m-by-size.svg", "departure_m-by-word.svg"]
    for path in (folder.path / "figures").glob("*.svg"):
        ElementTree.parse(path)
    assert "over its deviation" in page
    assert "21.5 (21 to 22)" in page  # the mean of 2 * 10 + seed over two seeds
