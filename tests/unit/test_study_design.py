"""Design of a study: its file, its points, its draws, and the scenarios of its arms."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from skyrange.city.downtown import downtown_grid
from skyrange.core.errors import InputError
from skyrange.dataset.members import name_city
from skyrange.scenario.model.scenario import Grid
from skyrange.scenario.shipped import source_of
from skyrange.study.design.blocks import (
    check_blocks,
    city_of,
    draw_values,
    list_blocks,
    list_points,
    scenario_in,
    value_at,
)
from skyrange.study.design.factors import Factor
from skyrange.study.design.model import Study, change_study, cities_of, parse_study, read_study
from skyrange.study.folder import digest_of


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
        (Factor(name="a", key="k", named={"x": [1], "y": [2], "z": []}), "x", "y", "z"),
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
        ({"factors": ({"name": "a", "key": "k"},)}, "either values, named, or low and high"),
        ({"factors": ({"name": "a", "key": "k", "values": (1,), "named": {"x": 1}},)}, "names of named: x"),
        ({"factors": ({"name": "a", "key": "k", "values": ("one",), "named": {"ones": 1}},)}, "Did you mean 'ones'"),
        ({"factors": ({"name": "a", "key": "k", "named": {"x": 1}, "low": 1, "high": 2},)}, "either values, named, or"),
        ({"factors": ({"name": "a", "key": "k", "named": {}},)}, "at least one name with its value"),
        ({"factors": ({"name": "a", "key": "k", "named": {" ": 1}},)}, "printable characters"),
        ({"factors": ({"name": "a", "key": "scenario", "named": {"x": [1]}},)}, "the file of a scenario"),
        ({"factors": ({"name": "a", "key": "buildings", "named": {"x": 3}},)}, "a file of buildings"),
        ({"factors": ({"name": "a", "key": "buildings", "values": ("grid:x",)},)}, "a whole number"),
        (
            {"factors": ({"name": "a", "key": "buildings", "values": ("a/x.geojson", "b/x.geojson")},)},
            "different names",
        ),
        ({"factors": ({"name": "city", "key": "k", "values": (1,)},)}, "column of the results"),
        ({"factors": tuple({"name": n, "key": "buildings", "values": ("",)} for n in "ab")}, "at most one factor"),
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


def test_links_of_learned_detectors_that_do_not_exist_are_found_before_anything_flies() -> None:
    deaf = study(learned={"links": ("gsc:*",), "side": "gcs"})
    with pytest.raises(InputError, match=r"learned\.links.*gsc:\*") as caught:
        check_blocks(deaf, list_blocks(deaf))
    assert len(caught.value.problems) == 1
    deaf = study(learned={"side": "autopilot"})
    with pytest.raises(InputError, match=r"learned\.side.*autopilot"):
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


ATTACKS = {
    "drift": [
        {"id": "a", "kind": "gnss.drift", "start_s": 9, "params": {"vehicles": ["blue/b1"], "rate_mps": [1, 0, 0]}}
    ],
    "none": [],
}


def test_results_have_the_name_of_a_value_and_the_scenario_has_what_it_stands_for() -> None:
    attack = {"name": "condition", "key": "attacks", "named": ATTACKS}
    fault = {
        "name": "failure",
        "key": "faults",
        "named": {"none": [], "gust": [{"id": "g", "kind": "gust", "params": {"speed_mps": 9}}]},
    }
    found = study(factors=(attack,), draws=(fault,), seeds=6)
    blocks = list_blocks(found)
    assert {block.values["condition"] for block in blocks} == {"drift", "none"}
    assert {block.values["failure"] for block in blocks} == {"gust", "none"}
    for block in blocks:
        scenario = scenario_in(found, found.arms[1], block)
        assert [one.kind for one in scenario.attacks] == (
            ["gnss.drift"] if block.values["condition"] == "drift" else []
        )
        assert [one.kind for one in scenario.faults] == (["gust"] if block.values["failure"] == "gust" else [])
    assert Study(**found.model_dump(mode="json")) == found
    onset = {"name": "onset", "key": "attacks.*.start_s", "low": 20, "high": 30}
    later = study(factors=(attack,), draws=(onset,))
    drift = scenario_in(later, later.arms[1], list_blocks(later)[0]).attacks[0]
    assert drift.start_s == list_blocks(later)[0].values["onset"]


CITIES = """
name = "s"
scenario = "survey"
[[factors]]
name = "city"
key = "buildings"
values = ["", "grid:7", "towns/one.geojson"]
"""
TOWN = {
    "type": "FeatureCollection",
    "features": [
        {
            "type": "Feature",
            "properties": {"height": 12},
            "geometry": {"type": "Polygon", "coordinates": [[[9, 50], [9.001, 50], [9.001, 50.001], [9, 50]]]},
        }
    ],
}


def test_a_factor_chooses_generated_downtowns_and_files_of_cities(tmp_path: Path) -> None:
    (tmp_path / "towns").mkdir()
    file = tmp_path / "towns/one.geojson"
    with pytest.raises(InputError, match=r"one\.geojson.*a file of buildings"):
        parse_study(CITIES, "s.toml", tmp_path)
    file.write_text(json.dumps(TOWN))
    found = parse_study(CITIES, "s.toml", tmp_path)
    blocks = list_blocks(found)
    assert [city_of(found, block) for block in blocks] == ["own", "grid:7", "one.geojson"]
    own, seventh, town = (scenario_in(found, found.arms[0], block) for block in blocks)
    assert own.city is not None
    assert seventh.city is not None
    assert town.city is not None
    assert own.city.grid is not None
    assert seventh.city.grid == own.city.grid.model_copy(update={"seed": 7})
    assert town.city.buildings == str(file)
    assert abs(town.origin.lat - 50) < 0.01
    before = digest_of(found)
    file.write_text(json.dumps(TOWN).replace("12", "13"))
    assert digest_of(found) != before


def test_downtowns_of_other_shapes_are_values_by_name() -> None:
    narrow: dict[str, Any] = {"blocks": [4, 4], "street_m": 12, "seed": 3}
    city = {"name": "city", "key": "buildings", "named": {"narrow": narrow, "wide": "grid:2"}}
    found = study(scenario="survey", factors=(city,))
    narrowed, wide = (scenario_in(found, found.arms[0], block).city for block in list_blocks(found))
    assert narrowed is not None
    assert wide is not None
    assert narrowed.grid == Grid(**narrow)
    assert wide.grid == Grid(blocks=(8, 6), height_m=(20, 90), seed=2)


def test_names_of_generated_downtowns_tell_seeds_and_shapes_apart() -> None:
    cities = [
        downtown_grid((2, 2)), downtown_grid((2, 2), seed=1), downtown_grid((2, 2), street_m=12),
        downtown_grid((2, 2), height_m=(9, 20)), downtown_grid((2, 2), block_m=60),
    ]  # fmt: skip
    names = [name_city({"city": {"source": city.source}}) for city in cities]
    assert names[:3] == [
        "downtown_grid 2x2 seed 0",
        "downtown_grid 2x2 seed 1",
        "downtown_grid 2x2 seed 0 streets 12 m",
    ]
    assert len(set(names)) == len(names)
    assert name_city({"city": {"source": "/home/me/town.geojson"}}) == "town.geojson"


def test_changes_of_a_study_name_its_factors_draws_and_arms(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    base = CITIES.replace(', "towns/one.geojson"', "")
    (tmp_path / "here").mkdir()
    (tmp_path / "here/two.geojson").write_text(json.dumps(TOWN))
    monkeypatch.chdir(tmp_path / "here")
    found = parse_study(
        base, "s", tmp_path, ["seeds=3", 'factors.city.values=["grid:1", "two.geojson"]', "arms=['attacked']"]
    )
    assert (found.seeds, [arm.id for arm in found.arms]) == (3, ["attacked"])
    assert found.factors[0].named == {"grid:1": "grid:1", "two.geojson": str(tmp_path / "here/two.geojson")}
    again = change_study(found, ["factors.city.named.two=two.geojson", "factors.*.name=town"])
    assert list(again.factors[0].named) == ["grid:1", "two.geojson", "two"]
    assert again.factors[0].name == "town"
    fewer = change_study(again, ['factors.town.values=["two", "grid:5"]'])
    assert fewer.factors[0].levels == ("two", "grid:5")
    assert cities_of(fewer) == [str(tmp_path / "here/two.geojson")]
    assert change_study(again, []) is again


def test_values_of_a_change_replace_those_of_another_kind() -> None:
    found = study(factors=({"name": "condition", "key": "attacks", "named": ATTACKS},), draws=(ONSET,))
    chosen = change_study(found, ['factors.condition.values=["none"]'])
    assert chosen.factors[0].levels == ("none",)
    assert list_points(chosen) == [{"condition": "none"}]
    ranged = change_study(found, ["draws.onset.values=[25]", "factors.condition.named={ none = [] }"])
    assert (ranged.draws[0].values, ranged.draws[0].low) == ((25,), None)
    assert ranged.factors[0].levels == ("none",)
    assert change_study(ranged, ["draws.onset.low=1", "draws.onset.high=2"]).draws[0].levels == ()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ("seeds", "path=value"),
        ("seds=1", "Did you mean 'seeds'"),
        ("factors.conditon.values=[1]", "Did you mean 'condition'"),
        ("factors.condition.values=[1, ", "a TOML value"),
        ("seeds=0", "seeds"),
        ("name.x=1", "name has no keys"),
        ("scenario=nothing.toml", "a TOML file"),
    ],
)
def test_a_change_that_is_wrong_is_refused(change: str, says: str) -> None:
    found = study(factors=({"name": "condition", "key": "attacks", "named": ATTACKS},))
    with pytest.raises(InputError, match=says):
        change_study(found, [change])
