"""Whatever a mission file says is used, listed as ignored, or refused."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.codec.mission import format_plan, parse_plan, parse_waypoints, read_mission
from skyrange.codec.mission.fence_and_rally import circle, polygon, rally_point, return_point
from skyrange.codec.mission.ignored_keys import describe_mission_file
from skyrange.codec.mission.items import Mission
from skyrange.core.errors import InputError

SURVEY = json.loads((Path(__file__).parents[1] / "data/missions/survey.plan").read_text())
HOME = (47.3977, 8.5456, 408.0)
CORNERS = ((47.3, 8.5), (47.3, 8.6), (47.4, 8.6))
FENCED = json.loads(
    format_plan(
        Mission(
            (),
            HOME,
            polygon(CORNERS, inclusion=True)
            + circle(CORNERS[0], 30.0, inclusion=False)
            + return_point(CORNERS[1], 20.0),
            (rally_point(CORNERS[2], 15.0),),
        )
    )
)
ELSEWHERE = {"doJumpId", "vehicleType", "firmwareType"}
"""Keys that matter to jumps alone, or that another test is about."""
Path_ = tuple[str | int, ...]


def keys_of(value: Any, path: Path_ = ()) -> Iterator[Path_]:
    """The path of every key of every object, but of those inside a pattern, whose items are what counts."""
    if isinstance(value, dict):
        for key, one in value.items():
            yield (*path, key)
            yield from keys_of(one, (*path, key))
    elif isinstance(value, list):
        for place, one in enumerate(value):
            yield from keys_of(one, (*path, place))


PLACES = [(document, path) for document in (SURVEY, FENCED) for path in keys_of(document)]
OBJECTS = [(document, path) for document, path in PLACES if isinstance(path[-1], str)]


def spelt(path: Path_) -> str:
    return "".join("[]" if isinstance(step, int) else f".{step}" for step in path).lstrip(".")


def said(mission: Mission) -> list[str]:
    return [one.key for one in mission.ignored]


def covered(path: Path_, keys: list[str]) -> bool:
    """Whether a key, or an object that it is in, is listed."""
    return any(spelt(path[:length]) in keys for length in range(1, len(path) + 1))


@given(st.sampled_from(OBJECTS), st.one_of(st.none(), st.integers(-5, 300), st.text(max_size=4), st.just([])))
@settings(max_examples=300, deadline=None)
def test_no_key_of_a_plan_is_dropped_without_a_word(place: tuple[Any, Path_], value: Any) -> None:
    document, path = place
    mission = parse_plan(json.dumps(document), "before")
    altered = copy.deepcopy(document)
    holder = altered
    for step in path[:-1]:
        holder = holder[step]
    if holder[path[-1]] == value or path[-1] in ELSEWHERE:
        return
    holder[path[-1]] = value
    try:
        found = parse_plan(json.dumps(altered), "after")
    except InputError:
        return
    bare = [replace(one, settings=None, source="") for one in (mission, found)]
    assert bare[0] != bare[1] or covered(path, said(found)), f"{spelt(path)} = {value!r}"


@given(st.sampled_from([document for document, _ in PLACES[:1] + PLACES[-1:]]), st.data())
@settings(max_examples=60, deadline=None)
def test_a_key_that_skyrange_does_not_know_is_listed_wherever_it_is(document: Any, data: st.DataObject) -> None:
    paths = [path for path in keys_of(document) if "TransectStyleComplexItem" not in path]
    path = data.draw(st.sampled_from(paths))
    altered = copy.deepcopy(document)
    holder = altered
    for step in path[:-1]:
        holder = holder[step]
    holder["maxAltitude"] = 120
    found = parse_plan(json.dumps(altered), "plan")
    assert covered((*path[:-1], "maxAltitude"), said(found))


@pytest.mark.parametrize(
    ("part", "version", "accepted"),
    [("geoFence", 2, True), ("geoFence", 3, False), ("geoFence", "2", False), ("rallyPoints", 3, False)],
)
def test_versions_of_parts_that_are_not_known_are_refused(part: str, version: Any, accepted: bool) -> None:
    altered = copy.deepcopy(FENCED)
    altered[part]["version"] = version
    if accepted:
        assert parse_plan(json.dumps(altered), "plan").fence
    else:
        with pytest.raises(InputError, match=rf"{part}\.version"):
            parse_plan(json.dumps(altered), "plan")


def test_a_plan_for_another_kind_of_aircraft_says_so() -> None:
    altered = copy.deepcopy(FENCED)
    altered["mission"] |= {"vehicleType": 1, "firmwareType": 12}
    reasons = {one.key: one.reason for one in parse_plan(json.dumps(altered), "plan").ignored}
    assert reasons["mission.vehicleType"] == "the plan is for MAV_TYPE_FIXED_WING; multirotors fly here"
    assert reasons["mission.firmwareType"].startswith("the plan is for MAV_AUTOPILOT_PX4;")
    assert all(one.harmless for one in parse_plan(json.dumps(FENCED), "plan").ignored)
    altered["mission"] |= {"vehicleType": "plane", "firmwareType": 3.5}
    assert sum(not one.harmless for one in parse_plan(json.dumps(altered), "plan").ignored) == 2


def test_columns_that_the_order_of_lines_overrules_are_listed() -> None:
    line = "{}\t{}\t3\t16\t0\t0\t0\t0\t47.3977\t8.5456\t10\t1"
    text = "\n".join(["QGC WPL 110", line.format(0, 1), line.format(1, 0), line.format(5, 1)])
    assert [(one.key, one.count) for one in parse_waypoints(text, "m").ignored] == [("sequence", 1), ("current", 1)]
    plain = "\n".join(["QGC WPL 110", line.format(0, 1), line.format(1, 0)])
    assert parse_waypoints(plain, "m").ignored == ()


def test_the_sentence_on_a_file_names_what_may_be_missed(tmp_path: Path) -> None:
    file = tmp_path / "a.plan"
    file.write_text(json.dumps(FENCED | {"geoFence": FENCED["geoFence"] | {"maxAltitude": 120}}))
    mission = read_mission(file)
    row = {"file": "a.plan", "items": 0, "fence": 5, "rally": 1, "ignored": [one.to_dict() for one in mission.ignored]}
    told = describe_mission_file(row)
    assert told.startswith("a.plan: 0 mission items, 5 items of the fence, 1 items of the rally points; not used: ")
    assert "geoFence.maxAltitude: unknown to skyrange" in told
