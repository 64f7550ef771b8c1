from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from skyrange.core.errors import InputError
from skyrange.scenario.shipped import load
from skyrange.scenario.toml_files import load_data, load_file, load_text, to_toml

SMALL = """
origin = { lat = 1.0, lon = 2 }
[[operators]]
id = "blue"
[[operators.vehicles]]
id = "b1"
plan = { square = { side_m = 5, alt_m = 5 } }
"""

SQUARE = {
    "type": "FeatureCollection",
    "features": [
        {
            "type": "Feature",
            "properties": {"building": "yes", "height": "30"},
            "geometry": {
                "type": "Polygon",
                "coordinates": [
                    [[10.0, 50.0], [10.001, 50.0], [10.001, 50.002], [10.0, 50.002], [10.0, 50.0]],
                ],
            },
        }
    ],
}


def faults(text: str, **how: Any) -> list[str]:
    with pytest.raises(InputError) as error:
        load_text(text, **how)
    assert error.value.exit_code == 2
    return [str(fault) for fault in error.value.problems]


def test_toml_becomes_a_scenario() -> None:
    scenario = load_text(SMALL)
    assert (scenario.origin.lat, scenario.origin.lon) == (1.0, 2.0)
    flown = scenario.operators[0].vehicles[0].plan.square
    assert flown is not None
    assert flown.side_m == 5.0


def test_a_file_without_a_name_is_called_after_its_file(tmp_path: Path) -> None:
    file = tmp_path / "ring road!.toml"
    file.write_text(SMALL)
    assert load_file(file).name == "ring-road"
    file.write_text('name = "other"\n' + SMALL)
    assert load_file(file).name == "other"


def test_bad_syntax_names_line_and_column() -> None:
    [fault] = faults('name = "x"\nseed = = 3\n')
    assert fault.startswith("line 2, column 8: Invalid value — expected valid TOML")
    [fault] = faults('name = "x')
    assert fault.startswith("line 1, column 10: Unterminated string — expected valid TOML")


def test_all_faults_come_at_once() -> None:
    text = """
    sead = 3
    duration_s = -1
    origin = { lat = nan, lon = 181 }
    [wind]
    speed_kts = 10
    [[operators]]
    id = "blue"
    approval = "aprove-all"
    [[operators.vehicles]]
    id = "b1"
    alt_ft = 30
    plan = { square = { side_m = "5 m", alt = 5 } }
    [[operators.vehicles]]
    id = "b1"
    plan = { file = "gone.plan" }
    [[operators]]
    id = "red"
    vehicles = []
    """
    said = "\n".join(faults(text))
    for expected in [
        "sead = 3 — expected a known key. Did you mean 'seed'?",
        "duration_s: -1 — expected at least 0.001",
        "origin.lat: nan — expected a finite number",
        "origin.lon: 181 — expected at most 180",
        "wind.speed_kts: speed_kts = 10 — expected a known key. Write speed_mps = 5.144444444, in m/s.",
        "operators.blue.approval: aprove-all — expected an approval service that is installed.",
        "Did you mean 'approve-all'?",
        "alt_ft = 30 — expected a known key",
        "side_m: '5 m' — expected a number (Length of a side in metres). Write side_m = 5 without quotes, in metres.",
        "alt = 5 — expected a known key. Write alt_m, in metres.",
        "an id that no other vehicle of this operator has",
        "gone.plan — expected a file that exists",
        "operators.red.vehicles: none — expected at least one vehicle",
    ]:
        assert expected in said
    assert "alt_m: missing" not in said  # said once already, as the key that was meant


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("alt_ft", 100, "Write alt_m = 30.48, in metres."),
        ("ALT_M", 100, "Write alt_m = 100, in metres."),
        ("alt_km", 0.1, "Write alt_m = 100, in metres."),
        ("alt_s", 100, "Write alt_m, in metres."),
        ("altitude", 100, "Known: alt_m, side_m."),
    ],
)
def test_wrong_units_are_told_the_right_key(key: str, value: float, expected: str) -> None:
    text = SMALL.replace("alt_m = 5", f"{key} = {value}")
    [fault] = [one for one in faults(text) if "known key" in one]
    assert fault.endswith(expected)


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ("5 ft", "Write side_m = 1.524, in metres."),
        ("5", "Write side_m = 5 without quotes, in metres."),
        ("5 m", "Write side_m = 5 without quotes, in metres."),
        ("-1.5e2 km", "Write side_m = -150000, in metres."),
        ("five", ""),
    ],
)
def test_numbers_in_quotes_are_told_to_lose_them(value: str, expected: str) -> None:
    [fault] = faults(SMALL.replace("side_m = 5", f'side_m = "{value}"'))
    assert fault.endswith(expected or "(Length of a side in metres)")


@pytest.mark.parametrize("section", ["viewer", "record_all"])
def test_sections_of_no_meaning_are_unknown_keys(section: str) -> None:
    assert f"{section}: {section} = " in faults(SMALL.replace("origin", f"{section} = [1]\norigin", 1))[0]


def test_files_are_beside_the_scenario(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "m.waypoints").write_text("QGC WPL 110\n")
    (tmp_path / "deep" / "town.geojson").write_text(json.dumps(SQUARE))
    file = tmp_path / "deep" / "s.toml"
    plan = "plan = { square = { side_m = 5, alt_m = 5 } }"
    file.write_text(SMALL.replace(plan, 'plan = { file = "m.waypoints" }') + '[city]\nbuildings = "town.geojson"\n')
    monkeypatch.chdir(tmp_path)
    scenario = load_file("deep/s.toml")
    assert scenario.operators[0].vehicles[0].plan.file == str(tmp_path / "deep" / "m.waypoints")
    assert scenario.city is not None
    assert scenario.city.buildings == str(tmp_path / "deep" / "town.geojson")
    file.write_text(SMALL.replace(plan, 'plan = { file = "m.waypoint.txt" }') + '[city]\nbuildings = "."\n')
    with pytest.raises(InputError) as error:
        load_file(file)
    said = str(error.value)
    assert "operators.blue.vehicles.b1.plan.file: " in said
    assert "expected a file that exists. Did you mean 'm.waypoints'?" in said
    assert "It is a folder." in said


def test_a_scenario_that_is_no_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="It is a folder"):
        load_file(tmp_path)
    (tmp_path / "here.toml").write_text(SMALL)
    with pytest.raises(InputError, match=r"expected a file that exists\. Did you mean 'here\.toml'"):
        load_file(tmp_path / "hare.toml")
    (tmp_path / "here.toml").write_bytes(b'name = "\xff"')
    with pytest.raises(InputError, match=r"byte 8: 0xff — expected UTF-8"):
        load_file(tmp_path / "here.toml")


def test_deep_nesting_is_refused() -> None:
    with pytest.raises(InputError):
        load_text("a = " + "[" * 100_000)


def test_huge_numbers_are_refused() -> None:
    assert "duration_s" in faults(SMALL.replace("origin", f"duration_s = {10**400}\norigin", 1))[0]


def test_buildings_replace_the_city_and_move_the_origin(tmp_path: Path) -> None:
    file = tmp_path / "town.geojson"
    file.write_text(json.dumps(SQUARE))
    text = SMALL + "[city]\ngrid = {}\n"
    text = text.replace("lon = 2", "lon = 2, alt_msl_m = 50, geoid_m = 9")
    scenario = load_text(text, buildings=file)
    # the middle of the footprint's bounding box, to 1e-6 degrees: a centimetre or ten
    assert scenario.origin.lat == pytest.approx(50.001, abs=1e-6)
    assert scenario.origin.lon == pytest.approx(10.0005, abs=1e-6)
    assert scenario.origin.alt_msl_m == 0.0
    assert scenario.city is not None
    assert scenario.city.buildings == str(file)
    assert scenario.city.grid is None
    later = load_text(text, buildings=file, overrides=["origin.geoid_m=-33.5"])
    assert later.origin.geoid_m == -33.5
    with pytest.raises(InputError):
        load_text(text, buildings=tmp_path / "none.geojson")


def test_the_seed_stands_over_all() -> None:
    assert load_text(SMALL, overrides=["seed=3"]).seed == 3
    assert load_text(SMALL, overrides=["seed=3"], seed=4).seed == 4


def test_toml_out_is_the_same_scenario_in() -> None:
    scenario = load_text(SMALL + "[[links]]\nmatch = 'gcs:*'\nlatency_ms = 40\n[city]\ngrid = {blocks = [2, 3]}\n")
    assert load_text(to_toml(scenario)) == scenario
    assert load_data(scenario.data()) == scenario


def test_files_are_renamed_on_the_way_out(tmp_path: Path) -> None:
    for name in ("a.plan", "b.geojson"):
        (tmp_path / name).write_text("")
    data = load_text(SMALL).data()
    data["operators"][0]["vehicles"][0]["plan"] = {"file": "a.plan"}
    data["city"] = {"buildings": "b.geojson"}
    scenario = load_data(data, folder=tmp_path)
    text = to_toml(scenario, {str(tmp_path / "a.plan"): "missions/b1.plan"})
    assert 'file = "missions/b1.plan"' in text
    assert f'buildings = "{tmp_path / "b.geojson"}"' in text


def test_a_mistyped_kind_is_told_its_nearest_spelling() -> None:
    """Names of examples have dots, and are not taken for files."""
    with pytest.raises(InputError, match=r"Did you mean 'mavlink\.command'"):
        load("mavlink.comand")
