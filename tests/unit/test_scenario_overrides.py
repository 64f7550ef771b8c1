from __future__ import annotations

from pathlib import Path

import pytest

from skyrange.core.errors import InputError
from skyrange.scenario.model.scenario import Vehicle
from skyrange.scenario.overrides import apply_overrides, parse_value
from skyrange.scenario.toml_files import load_data, parse_toml

DATA = parse_toml(
    """
origin = { lat = 1, lon = 2 }
[[operators]]
id = "blue"
[[operators.vehicles]]
plan = { square = { side_m = 5, alt_m = 5 } }
[[operators.vehicles]]
id = "two"
start = [10, 0]
plan = { square = { side_m = 5, alt_m = 5 } }
[[operators]]
color = "green"
[[operators.vehicles]]
start = [20, 0]
plan = { path = { points = [[1, 2, 3], [4, 5, 6]] } }
"""
)


def vehicles(*assignments: str) -> list[Vehicle]:
    return [vehicle for _, vehicle in load_data(apply_overrides(DATA, assignments)).fleet]


def refused(*assignments: str) -> str:
    with pytest.raises(InputError) as error:
        apply_overrides(DATA, assignments)
    assert error.value.who == "--set"
    assert len(error.value.problems) == len(assignments)
    return str(error.value)


def test_stars_reach_every_element_even_where_the_key_is_not_yet() -> None:
    assert [v.depart_s for v in vehicles("operators.*.vehicles.*.depart_s=3")] == [3, 3, 3]


def test_elements_go_by_id_by_index_and_by_the_id_they_will_get() -> None:
    assert [v.depart_s for v in vehicles("operators.blue.vehicles.two.depart_s=3")] == [0, 3, 0]
    assert [v.depart_s for v in vehicles("operators.0.vehicles.1.depart_s=3")] == [0, 3, 0]
    assert [v.depart_s for v in vehicles("operators.blue.vehicles.b1.depart_s=3")] == [3, 0, 0]
    assert [v.depart_s for v in vehicles("operators.green.vehicles.g1.depart_s=3")] == [0, 0, 3]
    flown = vehicles("operators.green.vehicles.0.plan.path.points.1.2=60")[2].plan.path
    assert flown is not None
    assert flown.points[1] == (4, 5, 60)


def test_tables_are_made_on_the_way_and_later_assignments_win() -> None:
    scenario = load_data(apply_overrides(DATA, ["wind.speed_mps=3", "wind.from_deg=90", "wind.speed_mps=4"]))
    assert (scenario.wind.speed_mps, scenario.wind.from_deg) == (4, 90)
    scenario = load_data(apply_overrides(DATA, ["city.grid.blocks=[2, 2]"]))
    assert scenario.city is not None
    assert scenario.city.grid is not None
    assert scenario.city.grid.blocks == (2, 2)
    assert vehicles("operators.*.vehicles.*.params.WPNAV_SPEED=500")[0].params == {"WPNAV_SPEED": 500.0}


def test_the_table_given_stays_as_it_was() -> None:
    before = repr(DATA)
    apply_overrides(DATA, ["operators.*.vehicles.*.plan.square.side_m=1", "seed=9"])
    assert repr(DATA) == before


def test_values_set_at_several_places_are_not_shared() -> None:
    data = apply_overrides(DATA, ["operators.*.vehicles.*.start={east_m=1}"])
    first, second = data["operators"][0]["vehicles"]
    assert first["start"] == second["start"]
    assert first["start"] is not second["start"]


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("7", 7),
        ("7.5", 7.5),
        ("true", True),
        ('"a b"', "a b"),
        ("'7'", "7"),
        ("[1, 2]", [1, 2]),
        ("{ a = 1 }", {"a": 1}),
        ("builtin", "builtin"),
        ("approve-all", "approve-all"),
        ("../town.geojson", "../town.geojson"),
        ("1.2.3", "1.2.3"),
        ("gcs:blue/*", "gcs:blue/*"),
    ],
)
def test_values_are_toml_or_bare_words(text: str, value: object) -> None:
    assert parse_value(text) == value
    assert type(parse_value(text)) is type(value)


@pytest.mark.parametrize("text", ["", "[1", '"a', "a b", "{a", "1\nseed = 2", "a#b", "1 # a comment?\r"])
def test_malformed_values_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"."):
        parse_value(text)


def test_what_matches_nothing_names_the_nearest() -> None:
    said = refused(
        "sed=3",
        "operators.*.vehicles.*.autopilt=builtin",
        "operators.bleu.approval=x",
        "operators.blue.vehicles.9.depart_s=3",
        "links.*.loss=0.1",
        "seed.x=3",
        "nothing",
        "=3",
        "a..b=3",
        "seed=[1",
    )
    for expected in [
        "sed: sed — expected a known key. Did you mean 'seed'?",
        "Did you mean 'autopilot'?",
        "operators.bleu: bleu — expected an id, an index from 0, or *. Did you mean 'blue'?",
        "vehicles.9: 9 — expected an id, an index from 0, or *. Known: b1, two.",
        "links.*.loss: matches nothing",
        "seed has no keys",
        "path=value",
        "a TOML value (",
    ]:
        assert expected in said


def test_what_is_no_number_names_no_element() -> None:
    """A superscript and an Arabic digit, which `str.isdigit` accepts, and more digits than `int` reads."""
    for key in ("\u00b2", "\u0660", "-1", "1" * 5_000):
        assert "an id, an index from 0" in refused(f"operators.{key}.id=x")


def test_files_named_on_the_command_line_are_beside_the_shell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert apply_overrides(DATA, ["city.buildings=town.geojson"])["city"]["buildings"] == str(tmp_path / "town.geojson")


def test_bad_values_are_found_when_the_scenario_is_built() -> None:
    with pytest.raises(InputError, match="seed: 'x' — expected a whole number"):
        load_data(apply_overrides(DATA, ["seed=x"]))
