from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from skyrange.codec.mission import (
    Mission,
    MissionItem,
    format_plan,
    format_waypoints,
    items,
    parse_plan,
    parse_waypoints,
    read_mission,
)
from skyrange.core.errors import InputError

DATA = Path(__file__).parent.parent / "data" / "missions"
SQUARE = (DATA / "square.waypoints").read_text()
SURVEY = (DATA / "survey.plan").read_text()


def faults_of(error: pytest.ExceptionInfo[InputError]) -> dict[str, str]:
    return {fault.where: fault.value for fault in error.value.problems}


def survey() -> Any:
    return json.loads(SURVEY)


# -- QGC WPL 110 ------------------------------------------------------------------------------------


def test_waypoints() -> None:
    mission = read_mission(DATA / "square.waypoints")
    assert mission.home == (-35.363328, 149.1652241, 584.09)
    assert [item.command for item in mission.items] == [22, 16, 16, 178, 16, 177, 20]
    assert mission.items[1] == MissionItem(3, 16, 0, 0, 0, 0, -35.362878, 149.1652241, 10)
    assert math.isnan(mission.items[2].param4)
    assert (mission.fence, mission.rally, mission.settings) == ((), (), None)
    assert mission.source.endswith("square.waypoints")


def test_spaces_comments_blank_lines_and_carriage_returns_pass() -> None:
    loose = "# made by hand\r\n\r\nQGC  WPL 110\r\n" + SQUARE.split("\n", 1)[1].replace("\t", "  ").replace(
        "\n", "\r\n"
    )
    assert parse_waypoints(loose, "a").items == parse_waypoints(SQUARE, "a").items


def test_a_home_of_zeros_is_none() -> None:
    text = "QGC WPL 110\n0\t1\t0\t16\t0\t0\t0\t0\t0\t0\t0\t1\n1\t0\t3\t22\t0\t0\t0\t0\t0\t0\t10\t1\n"
    assert parse_waypoints(text, "a").home is None
    assert parse_waypoints(format_waypoints(parse_waypoints(text, "a")), "a") == parse_waypoints(text, "a")


def test_mission_planners_home_has_command_0() -> None:
    assert parse_waypoints(SQUARE.replace("0\t1\t0\t16", "0\t1\t0\t0", 1), "a").home == (
        -35.363328,
        149.1652241,
        584.09,
    )


@pytest.mark.parametrize(
    ("old", "new", "where", "value"),
    [
        ("QGC WPL 110", "QGC WPL 120", "line 1", "'QGC WPL 120'"),
        ("2\t0\t3\t16", "2\t7\t3\t16", "line 4, column 2 (current)", "'7'"),
        ("2\t0\t3\t16", "2\t0\t13\t16", "line 4, column 3 (frame)", "'13'"),
        ("2\t0\t3\t16", "2\t0\t3\t70000", "line 4, column 4 (command)", "'70000'"),
        ("2\t0\t3\t16\t0", "2\t0\t3\t16\tinf", "line 4, column 5 (param1)", "'inf'"),
        ("2\t0\t3\t16\t0", "2\t0\t3\t16\t1e39", "line 4, column 5 (param1)", "1e+39"),
        ("2\t0\t3\t16\t0", "2\t0\t3\t16\t1_0", "line 4, column 5 (param1)", "'1_0'"),
        ("2\t0\t3\t16\t0", "2\t0\t3\t16\t٣", "line 4, column 5 (param1)", "'٣'"),
        ("-35.362878\t149.1652241", "-95.362878\t149.1652241", "line 4, column 9 (x (latitude))", "-95.362878"),
        ("-35.362878\t149.1652241", "-35.362878\t190", "line 4, column 10 (y (longitude))", "190.0"),
        ("-35.362878\t149.1652241\t10", "-35.362878\t149.1652241\tnan", "line 4, column 11 (z (altitude))", "nan"),
        (
            "-35.362878\t149.1652241\t10\t1",
            "-35.362878\t149.1652241\t10\tyes",
            "line 4, column 12 (autocontinue)",
            "'yes'",
        ),
        ("149.1652241\t10\t1", "149.1652241\t10", "line 4", "'11 columns'"),
        ("\t584.09", "\t1e38", "line 2", "(-35.363328, 149.1652241, 1e+38)"),
        ("0\t1\t0\t16", "0\t1\t0\t22", "line 2", "'command 22 in frame 0'"),
        ("-35.363328\t149.1652241\t584.09", "-95\t149.1652241\t584.09", "line 2, column 9 (x (latitude))", "-95.0"),
    ],
)
def test_a_fault_in_waypoints_is_named(old: str, new: str, where: str, value: str) -> None:
    assert old in SQUARE
    with pytest.raises(InputError) as error:
        parse_waypoints(SQUARE.replace(old, new, 1), "square.waypoints")
    assert faults_of(error) == {where: value}
    assert "square.waypoints" in str(error.value)


def test_waypoints_may_be_numbered_with_gaps() -> None:
    """As pymavlink reads them: an item's number is its place in the file."""
    whole = parse_waypoints(SQUARE, "square.waypoints")
    gaps = parse_waypoints(SQUARE.replace("\n2\t0\t3\t16", "\n5\t0\t3\t16"), "square.waypoints")
    assert gaps.items == whole.items


def test_all_faults_come_at_once_but_not_without_end() -> None:
    with pytest.raises(InputError) as error:
        parse_waypoints(SQUARE.replace("\t3\t", "\t99\t").replace("\t10\t", "\tten\t"), "a")
    assert len(error.value.problems) == 7 + 4
    many = SQUARE.split("\n")[:2] + ["x"] * 1000
    with pytest.raises(InputError, match="950 more problems") as error:
        parse_waypoints("\n".join(many), "a")
    assert len(error.value.problems) == items.MAX_PROBLEMS + 1


def test_a_file_of_no_items() -> None:
    with pytest.raises(InputError, match="no items"):
        parse_waypoints("QGC WPL 110\n", "a")
    assert parse_waypoints("\n".join(SQUARE.split("\n")[:2]), "a").items == ()


def test_too_many_items(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("skyrange.codec.mission.qgc_wpl.MAX_ITEMS", 6)
    with pytest.raises(InputError, match=r"7 items.*at most 6"):
        parse_waypoints(SQUARE, "a")


# -- QGroundControl plans ----------------------------------------------------------------------------


def test_plan_with_a_survey() -> None:
    mission = read_mission(DATA / "survey.plan")
    plan = survey()
    transects = [16, 206, 16, 206] * 3
    assert [item.command for item in mission.items] == [22, *transects, 178, 16, 177, 20]
    assert mission.home == tuple(plan["mission"]["plannedHomePosition"])
    assert [(item.command, item.param1) for item in mission.fence] == [(5002, 3.0)] * 3 + [(5003, 400.0)]
    assert [(one.x, one.y) for one in mission.fence[:3]] == [
        tuple(c) for c in plan["geoFence"]["polygons"][0]["polygon"]
    ]
    assert [[one.x, one.y, one.z] for one in mission.rally] == plan["rallyPoints"]["points"]
    assert mission.settings == {
        "cruiseSpeed": 15,
        "firmwareType": 3,
        "globalPlanAltitudeMode": 1,
        "hoverSpeed": 5,
        "vehicleType": 2,
    }
    first = plan["mission"]["items"][1]["TransectStyleComplexItem"]["Items"][0]["params"]
    assert mission.items[1] == MissionItem(3, 16, 0, 0, 0, math.nan, *first[4:])


def test_items_next_to_the_complex_items_own_keys() -> None:
    plan = survey()
    complex_item = plan["mission"]["items"][1]
    complex_item["Items"] = complex_item.pop("TransectStyleComplexItem")["Items"]
    assert parse_plan(json.dumps(plan), "a").items == parse_plan(SURVEY, "a").items


def test_a_pattern_without_embedded_items_is_refused_with_the_reason() -> None:
    plan = survey()
    plan["mission"]["items"][1] = {"type": "ComplexItem", "complexItemType": "StructureScan", "version": 3}
    with pytest.raises(InputError, match=r"none in this 'StructureScan' item.*replace other patterns by waypoints"):
        parse_plan(json.dumps(plan), "a")


def test_do_jump_ids_become_sequence_numbers() -> None:
    plan = survey()
    jump = plan["mission"]["items"][4]
    plan["mission"]["items"][3]["doJumpId"] = 100  # the format page's own example
    jump["params"][0] = 100
    mission = parse_plan(json.dumps(plan), "a")
    at = mission.items.index(next(item for item in mission.items if item.command == 177))
    assert mission.items[at].param1 == at  # the item before the jump, numbered from 1
    plan["mission"]["items"][1]["TransectStyleComplexItem"]["Items"][0]["doJumpId"] = 100
    assert parse_plan(json.dumps(plan), "a") == mission  # an embedded item of that id stands back
    jump["params"][0] = 101
    with pytest.raises(InputError) as error:
        parse_plan(json.dumps(plan), "a")
    assert faults_of(error) == {"mission.items[4].params[0]": "101.0"}
    plan["mission"]["items"][2]["doJumpId"] = 100
    jump["params"][0] = 100
    with pytest.raises(InputError, match="2 have this one"):
        parse_plan(json.dumps(plan), "a")


def test_null_means_here_or_nothing_or_is_a_fault() -> None:
    plan = survey()
    items = plan["mission"]["items"]
    items[0]["params"][4:6] = [None, None]  # a take-off here
    items[5]["params"] = [None] * 7  # return to launch
    mission = parse_plan(json.dumps(plan), "a")
    assert mission.items[0].values[4:] == (0.0, 0.0, 40.0)
    assert mission.items[-1].values[4:] == (0.0, 0.0, 0.0)
    assert all(math.isnan(value) for value in mission.items[-1].values[:4])
    items[0]["params"][6] = None
    items[3]["params"][4] = None
    with pytest.raises(InputError) as error:
        parse_plan(json.dumps(plan), "a")
    assert set(faults_of(error)) == {"mission.items[0].params[6]", "mission.items[3].params[4]"}


def edited(path: str, value: object) -> str:
    plan = survey()
    at = plan
    steps: list[Any] = [int(step) if step.isdigit() else step for step in path.split(".")]
    for step in steps[:-1]:
        at = at[step]
    at[steps[-1]] = value
    return json.dumps(plan)


@pytest.mark.parametrize(
    ("path", "value", "where"),
    [
        ("fileType", "plan", "fileType"),
        ("version", 2, "version"),
        ("geoFence", [], "geoFence"),
        ("rallyPoints", "none", "rallyPoints"),
        ("mission", [], "mission"),
        ("mission.version", 1, "mission.version"),
        ("mission.items", {}, "mission.items"),
        ("mission.items.0", 5, "mission.items[0]"),
        ("mission.items.0.type", "Simple", "mission.items[0].type"),
        ("mission.items.0.frame", 13, "mission.items[0].frame"),
        ("mission.items.0.frame", True, "mission.items[0].frame"),
        ("mission.items.0.command", 16.5, "mission.items[0].command"),
        ("mission.items.0.command", "16", "mission.items[0].command"),
        ("mission.items.0.autoContinue", 1, "mission.items[0].autoContinue"),
        ("mission.items.0.doJumpId", -1, "mission.items[0].doJumpId"),
        ("mission.items.0.params", [1, 2], "mission.items[0].params"),
        ("mission.items.0.params.2", "0", "mission.items[0].params[2]"),
        ("mission.items.0.params.2", 10**400, "mission.items[0].params[2]"),
        ("mission.items.0.params.2", 1e39, "mission.items[0].params[2]"),
        ("mission.items.3.params.4", 91, "mission.items[3].params[4]"),
        (
            "mission.items.1.TransectStyleComplexItem.Items.2.frame",
            22,
            "mission.items[1].TransectStyleComplexItem.Items[2].frame",
        ),
        ("mission.items.1.TransectStyleComplexItem", 3, "mission.items[1].TransectStyleComplexItem.Items"),
        ("mission.plannedHomePosition", [1, 2], "mission.plannedHomePosition"),
        ("mission.plannedHomePosition", [1, None, 3], "mission.plannedHomePosition"),
        ("mission.plannedHomePosition", [1, 181, 3], "mission.plannedHomePosition"),
        ("mission.plannedHomePosition", [1, 2, 1e39], "mission.plannedHomePosition"),
    ],
)
def test_a_fault_in_a_plan_is_named(path: str, value: object, where: str) -> None:
    with pytest.raises(InputError) as error:
        parse_plan(edited(path, value), "a.plan")
    assert list(faults_of(error)) == [where]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "line 1 column 1"),
        ("[]", "a JSON list"),
        ('{"a": ' * 100_000, "nested"),
        ('{"a": ' * 40 + "1" + "}" * 40, "at most 32 levels"),
        (SURVEY.replace('"radius": 400', '"radius": NaN'), "NaN is not a JSON number"),
        (SURVEY.replace('"radius": 400', '"radius": 1e999'), r"geoFence.circles\[0\].circle.radius: inf"),
        (SURVEY.replace('"radius": 400', '"radius": ' + "9" * 5000), "4300 digits"),
        (SURVEY[:-20], r"line \d+ column \d+"),
    ],
)
def test_json_that_is_none_or_is_a_trap(text: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        parse_plan(text, "a.plan")


def test_too_many_plan_items(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("skyrange.codec.mission.qgc_plan.MAX_ITEMS", 10)
    with pytest.raises(InputError, match="more than 10 items"):
        parse_plan(SURVEY, "a")


def test_rewriting_keeps_everything_but_the_patterns_shape() -> None:
    mission = parse_plan(SURVEY, "a")
    again = json.loads(format_plan(mission))
    assert {item["type"] for item in again["mission"]["items"]} == {"SimpleItem"}
    assert again["mission"]["items"][0]["params"][3] is None
    assert parse_plan(format_plan(mission), "a") == mission
    plan = survey()
    for key in ("geoFence", "rallyPoints", "version", "fileType"):
        assert again[key] == plan[key]
    for key in ("cruiseSpeed", "vehicleType", "plannedHomePosition"):
        assert again["mission"][key] == plan["mission"][key]


def test_a_plan_from_waypoints_has_all_that_qgroundcontrol_requires() -> None:
    # the "required" keys of the format page; PlanMasterController also insists on fence and rally
    plan = json.loads(format_plan(parse_waypoints(SQUARE, "a")))
    assert set(plan) >= {"fileType", "version", "groundStation", "mission", "geoFence", "rallyPoints"}
    required = {"version", "firmwareType", "vehicleType", "cruiseSpeed", "hoverSpeed", "items", "plannedHomePosition"}
    assert set(plan["mission"]) >= required


def test_a_plan_needs_a_home() -> None:
    with pytest.raises(InputError, match="home"):
        format_plan(Mission(items=()))


# -- files -------------------------------------------------------------------------------------------


def test_the_content_decides_before_the_suffix(tmp_path: Path) -> None:
    for name in ("a.txt", "b.plan", "c", "d.mission"):
        file = tmp_path / name
        file.write_bytes(b"\xef\xbb\xbf" + SQUARE.encode())
        assert len(read_mission(file).items) == 7
        file.write_text("\n  " + SURVEY)
        assert len(read_mission(str(file)).items) == 17


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("a.plan", b"", "line 1 column 1.*JSON"),
        ("a.waypoints", b"", "`QGC WPL 110`"),
        ("a.txt", b"hello", "`QGC WPL 110`"),
        ("a.bin", b"hello", "`QGC WPL 110` or a JSON object"),
        ("a.waypoints", b"QGC WPL 110\n0\xff", "line 2: 'byte 0xff at offset 13'|line 2: byte 0xff at offset 13"),
    ],
)
def test_a_file_that_is_no_mission(tmp_path: Path, name: str, content: bytes, says: str) -> None:
    file = tmp_path / name
    file.write_bytes(content)
    with pytest.raises(InputError, match=says) as error:
        read_mission(file)
    assert str(file) in str(error.value)


def test_a_path_that_is_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_mission(tmp_path / "missing.plan")
    with pytest.raises(InputError, match="a folder"):
        read_mission(tmp_path)
    with pytest.raises(InputError):
        read_mission("a\0b")
    monkeypatch.setattr("skyrange.codec.mission.mission_file.MAX_FILE_BYTES", 100)
    with pytest.raises(InputError, match="at most 100 bytes"):
        read_mission(DATA / "survey.plan")
