"""Design of a study: its file, its points, its draws, and the scenarios of its arms."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from skyrange.core.errors import InputError
from skyrange.scenario.shipped import source_of
from skyrange.study.sweep.blocks import check_blocks, list_blocks, scenario_in
from skyrange.study.sweep.model import Factor, Study, read_study
from skyrange.study.sweep.sampling import draw_values, list_points, value_at


def study(**more: Any) -> Study:
    return Study(**{"name": "s", "scenario": "gnss.jump", **more})


SIDE = Factor(name="side", key="operators.*.vehicles.*.plan.square.side_m", values=(20, 40))
ONSET = Factor(name="onset", key="attacks.jump.start_s", low=20, high=40)


def test_a_grid_has_every_combination_and_a_block_for_each_seed() -> None:
    wind = Factor(name="wind", key="wind.speed_mps", low=0, high=8, steps=3)
    found = study(factors=(SIDE, wind), seeds=2, first_seed=5)
    assert list_points(found) == [{"side": s, "wind": w} for s in (20, 40) for w in (0.0, 4.0, 8.0)]
    blocks = list_blocks(found)
    assert [(block.point, block.seed) for block in blocks] == [(p, s) for s in (5, 6) for p in range(6)]
    assert len({block.name for block in blocks}) == 12


@pytest.mark.parametrize("sampling", ["latin-hypercube", "sobol", "random"])
def test_sampled_points_fill_the_range_and_repeat(sampling: str) -> None:
    pytest.importorskip("scipy")
    found = study(factors=(ONSET,), sampling=sampling, points=64)
    values = [point["onset"] for point in list_points(found)]
    assert values == [point["onset"] for point in list_points(found)]
    assert all(20 <= value <= 40 for value in values)
    if sampling != "random":  # one in each of 64 equal parts
        assert sorted(int((value - 20) / 20 * 64) for value in values) == list(range(64))
    assert values != [point["onset"] for point in list_points(found.model_copy(update={"first_seed": 9}))]


def test_draws_are_those_of_the_seed_and_the_point_alone() -> None:
    alone, among = study(draws=(ONSET,), seeds=1), study(draws=(SIDE, ONSET), seeds=4, factors=())
    assert draw_values(alone, 0, 1)["onset"] == draw_values(among, 0, 1)["onset"]
    drawn = [draw_values(among, 0, seed)["onset"] for seed in range(1, 5)]
    assert len(set(drawn)) == 4


@pytest.mark.parametrize(
    ("factor", "low", "middle", "high"),
    [
        (Factor(name="a", key="k", low=1, high=3), 1.0, 2.0, 3.0),
        (Factor(name="a", key="k", low=1, high=100, log=True), 1.0, 10.0, 100.0),
        (Factor(name="a", key="k", low=0, high=10, mean=5, deviation=1), 0.0, 5.0, 10.0),
        (Factor(name="a", key="k", low=1, high=4, whole=True), 1, 2, 4),
        (Factor(name="a", key="k", values=("x", "y", "z")), "x", "y", "z"),
    ],
)
def test_the_values_of_a_factor(factor: Factor, low: Any, middle: Any, high: Any) -> None:
    assert value_at(factor, 0.0) == pytest.approx(low) if not isinstance(low, str) else value_at(factor, 0.0) == low
    assert (
        value_at(factor, 0.5) == middle
        if isinstance(middle, str)
        else value_at(factor, 0.5) == pytest.approx(middle, abs=1)
    )
    last = value_at(factor, 1.0 - 1e-16)
    assert last == high if isinstance(high, str) else 0.6 * high <= last <= high


def test_arms_share_all_but_what_they_are() -> None:
    found = study(
        arms=("nominal", "attacked", {"id": "defended", "defences": ({"kind": "gnss.innovation"},)}),
        factors=(SIDE,),
        draws=(ONSET,),
    )
    block = list_blocks(found)[1]
    nominal, attacked, defended = (scenario_in(found, arm, block) for arm in found.arms)
    assert [one.muted for one in (*nominal.attacks, *attacked.attacks)] == [True, False]
    assert {one.seed for one in (nominal, attacked, defended)} == {block.seed}
    assert {one.attacks[0].start_s for one in (nominal, attacked, defended)} == {block.values["onset"]}
    assert [table.kind for table in defended.defences] == ["gnss.innovation"]
    assert attacked.model_copy(update={"defences": defended.defences}) == defended
    assert attacked.record.level == "study"


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ({"arms": ("nominal", "atacked")}, "Did you mean 'attacked'"),
        ({"arms": ("nominal", "nominal")}, "a name that no other has"),
        ({"baseline": "x"}, "the id of an arm"),
        ({"sampling": "sobol", "points": 12}, "a power of two"),
        ({"sampling": "random"}, "the number of points of random"),
        ({"points": 3}, "a grid has as many as its values"),
        ({"factors": (ONSET,)}, "the number of steps"),
        ({"factors": ({"name": "arm", "key": "k", "values": (1,)},)}, "column of the results"),
        ({"keep": "all"}, "everything, features, results"),
        ({"keep": ("truths",)}, "truth"),
        ({"factors": ({"name": "a", "key": "k", "low": 2, "high": 1, "steps": 2},)}, "more than low"),
        ({"factors": ({"name": "a", "key": "k"},)}, "either values, or low and high"),
    ],
)
def test_a_study_that_is_wrong_is_refused(more: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        study(**more)


def test_a_factor_that_names_no_key_and_a_value_beyond_its_limit_are_found_before_anything_flies() -> None:
    unknown = study(factors=({"name": "a", "key": "attacks.jump.params.ofset_m", "values": ([1, 0, 0],)},))
    with pytest.raises(InputError, match="ofset_m"):
        check_blocks(unknown, list_blocks(unknown))
    far = study(draws=({"name": "a", "key": "duration_s", "low": -100, "high": 100},), seeds=8)
    with pytest.raises(InputError, match="duration_s"):
        check_blocks(far, list_blocks(far))


def test_a_detector_on_links_that_do_not_exist_is_found_before_anything_flies() -> None:
    deaf = study(detectors=({"id": "d", "kind": "heartbeat.gap", "links": ("rid_down:*",), "side": "companion"},))
    with pytest.raises(InputError, match="rid_down"):
        check_blocks(deaf, list_blocks(deaf))


def test_a_shipped_study_that_is_mistyped_is_suggested() -> None:
    with pytest.raises(InputError, match="Did you mean 'detectors'"):
        read_study("detectrs")


def test_a_scenario_is_beside_its_study(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text('name = "s"\nscenario = "./here.toml"\n')
    with pytest.raises(InputError, match="a TOML file"):
        read_study(tmp_path / "s.toml")
    (tmp_path / "here.toml").write_bytes(source_of("gnss.jump").read_bytes())
    assert read_study(tmp_path / "s.toml").scenario == str(tmp_path / "here.toml")
    (tmp_path / "s.toml").write_text('name = "s"\nscenario = "gnss.jmp"\n')
    with pytest.raises(InputError, match="gnss"):
        read_study(tmp_path / "s.toml")


def test_a_factor_can_choose_the_scenario(tmp_path: Path) -> None:
    text = """
name = "s"
scenario = "gnss.jump"
changes = ["duration_s=20"]
factors = [{ name = "condition", key = "scenario", values = ["gnss.jump", "gnss.drift"] }]
"""
    (tmp_path / "s.toml").write_text(text)
    found = read_study(tmp_path / "s.toml")
    blocks = list_blocks(found)
    check_blocks(found, blocks)
    names = [scenario_in(found, found.arms[1], block).attacks[0].kind for block in blocks]
    assert names == ["gnss.jump", "gnss.drift"]
    (tmp_path / "s.toml").write_text(text.replace("gnss.drift", "gnss.drfit"))
    with pytest.raises(InputError, match=r"gnss\.drift"):
        read_study(tmp_path / "s.toml")
