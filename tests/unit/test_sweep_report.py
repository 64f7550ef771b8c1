"""Report of a study: levels of factors, intervals over blocks, figures, and text that nobody trusts."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyrange.statistics.means import estimate_mean, standardised_effect
from skyrange.study.design.blocks import Block
from skyrange.study.design.factors import Factor
from skyrange.study.design.model import Study
from skyrange.study.execution.store import BlockResult
from skyrange.study.execution.worker import note_failure
from skyrange.study.page import Effect, describe_effects, draw_differences, write_study_report
from skyrange.study.registration import QUANTITIES
from skyrange.study.results import cluster_blocks, cluster_samples
from skyrange.study.study_run import StudyPlan, create_folder
from skyrange.study.summary import find_levels, trace_response


@given(st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=45), st.randoms(use_true_random=False))
def test_an_interval_holds_the_mean_repeats_and_does_not_depend_on_the_order(samples: list[float], random: Any) -> None:
    found = estimate_mean(samples)
    assert found is not None
    assert found == estimate_mean(random.sample(samples, len(samples)))
    assert (found.low is None) == bool(found.without)
    if found.low is not None and found.high is not None:
        assert found.low <= found.mean <= found.high


@given(st.lists(st.tuples(st.floats(-1e6, 1e6), st.integers(0, 5)), min_size=1, max_size=30))
def test_a_sample_that_is_repeated_within_its_cluster_tells_nothing_more(samples: list[tuple[float, int]]) -> None:
    of_cluster = {cluster: value for value, cluster in samples}
    once = estimate_mean(list(of_cluster.values()))
    often = estimate_mean([of_cluster[cluster] for _, cluster in samples], [cluster for _, cluster in samples])
    assert once is not None
    assert often is not None
    assert (often.n, often.method) == (once.n, once.method)
    assert often.mean == pytest.approx(once.mean, abs=1e-6)


def test_samples_are_seeds_even_where_their_nominal_flights_are_one(tmp_path: Path) -> None:
    folder = create_folder(Study(name="s", scenario="gnss.jump", seeds=4), tmp_path / "s")
    runs = [
        {"block": block.name, "arm": arm, "flight": "n" if arm == "nominal" else f"a{block.seed // 3}"}
        for block in folder.blocks
        for arm in ("nominal", "attacked")
    ]
    own = [name.partition("-")[2] for name in cluster_samples(folder, runs).values()]
    assert own == ["s1", "s1", "s3", "s3"], "seeds 1 and 2 have the same flights altogether, and so have 3 and 4"
    for row in runs:
        row |= {"status": "complete"}
    assert len(set(cluster_blocks(folder, runs).values())) == 1, "no flight may be in two splits"
    older = [{"block": block.name, "arm": "nominal"} for block in folder.blocks]
    assert len(set(cluster_samples(folder, older).values())) == 4


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
    clusters = {name: name for name in samples}
    curve = trace_response("arm", 0, levels, samples, clusters)
    assert [(at, mean.mean, mean.n) for at, mean in curve.points] == [(0.0, 2.0, 3), (1.0, 3.0, 3)]
    some = trace_response("arm", 0, levels, samples, clusters, frozenset({"b0", "b1"}))
    assert [(at, mean.mean) for at, mean in some.points] == [(0.0, 0.0), (1.0, 1.0)]
    shared = trace_response("arm", 0, levels, samples, dict.fromkeys(samples, "b0"))
    assert [(mean.n, mean.without) for _, mean in shared.points] == [(1, "one sample")] * 2


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
        runs = [
            {
                **head,
                "arm": arm,
                "status": "complete",
                "collisions": 0.0,
                "vehicles": 2,
                "missions_complete": 1,
                "flight": f"{block.seed} {arm}",
            }
            for arm in ("nominal", "attacked")
        ]
        rows = {"runs": runs, "effects": effects, "aircraft": [], "alerts": [], "acts": []}
        folder.store.write(BlockResult(block.name, 2, 0, (), 1.0, 1.0, 0), rows)
    plan = StudyPlan(study, folder.blocks)
    note_failure(plan, folder.store, plan.blocks[-1], "its process was ended by <SIGKILL>")
    page = write_study_report(folder.path).read_text()
    assert "<b>a</b>" not in page
    assert "&lt;SIGKILL&gt;" in page
    assert "collisions (" not in page  # they are 0 everywhere
    figures = sorted(path.name for path in (folder.path / "figures").glob("*.svg"))
    curves = ["departure_m-by-size-and-word.svg", "departure_m-by-size.svg", "departure_m-by-word.svg"]
    missions = ["missions_complete-by-size.svg", "missions_complete-by-word.svg"]
    assert figures == [*curves, "differences.svg", *missions]
    for path in (folder.path / "figures").glob("*.svg"):
        ElementTree.parse(path)
    assert "over its deviation" in page
    assert "there are 2" in page  # blocks of one seed are one sample
    assert "21.5 (15.1 to 27.9)" in page  # the mean of 2 * 10 + seed over two seeds, with t of one degree of freedom
    assert "14 of 28 missions complete" in page, "one of two aircraft in seven blocks with two runs"
    assert "Against nominal, by more than the 95 % interval: attacked departure (m) +" in page
    points = re.findall(r'<tr id="point-(\d+)">.*?<code>(.*?)</code>', page, re.S)
    assert points == [(str(k), f"skyrange watch {folder.path} --run p000{k}-s1") for k in range(4)]
    marks = re.findall(r'<a href="#point-(\d+)"', page)
    assert set(marks) <= {number for number, _ in points}
    assert len(marks) == 2 + 2 + 4 + 4 + 4, "the means of departures, and of missions of both arms"


@given(
    st.lists(
        st.lists(st.tuples(st.floats(-50.0, 50.0), st.integers(1, 9)), max_size=12, unique_by=lambda pair: pair[1]),
        max_size=5,
    )
)
def test_paired_differences_are_drawn_and_said(samples: list[list[tuple[float, int]]]) -> None:
    effects = [
        Effect(QUANTITIES[0], f"arm{k}", values, clusters, estimate_mean(values, clusters))
        for k, rows in enumerate(samples)
        for values, clusters in [([value for value, _ in rows], [str(number) for _, number in rows])]
    ]
    figure, sentence = draw_differences(effects, "nominal"), describe_effects(effects, "nominal")
    assert (figure is None) == (not any(samples))
    for effect in effects:
        clear = effect.mean is not None and effect.mean.excludes_zero
        assert (f"{effect.arm} departure (m)" in sentence) == clear
    if figure is not None:
        assert figure.svg.count("<circle") == sum(map(len, samples))
        assert figure.svg.count('stroke-width="3"') == sum(
            effect.mean is not None and effect.mean.low is not None for effect in effects
        )
        places = [float(x) for x in re.findall(r'<circle cx="([-\d.]+)"', figure.svg)]
        assert all(250.0 <= place <= 1010.0 for place in places)
        signs = [np.sign(round(place - 630.0, 1)) for place in places]
        values = [value for rows in samples for value, _ in rows]
        assert all(sign in (0.0, np.sign(value)) for sign, value in zip(signs, values, strict=True))
