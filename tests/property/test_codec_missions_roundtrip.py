from __future__ import annotations

import copy
import json
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.codec.mission import Mission, MissionItem, format_plan, format_waypoints, parse_plan, parse_waypoints
from skyrange.core.errors import InputError
from tests.tiers import examples

pytestmark = pytest.mark.rotating

DATA = Path(__file__).parent.parent / "data" / "missions"
SURVEY = (DATA / "survey.plan").read_text()
SQUARE = (DATA / "square.waypoints").read_text()

numbers = st.floats(allow_nan=False, allow_infinity=False, width=32)
parameters = st.one_of(numbers, st.just(math.nan))
latitudes = st.floats(-90, 90)
longitudes = st.floats(-180, 180)
located = st.builds(
    MissionItem,
    st.sampled_from([0, 3, 5, 6, 10, 11]),
    st.sampled_from([16, 17, 19, 21, 22, 82, 84, 85]),
    parameters,
    parameters,
    parameters,
    parameters,
    latitudes,
    longitudes,
    numbers,
    st.booleans(),
)
commands = st.builds(
    MissionItem,
    st.sampled_from([2, 3]),
    st.sampled_from([20, 112, 115, 178, 183, 206, 60_000]),
    parameters,
    parameters,
    parameters,
    parameters,
    st.floats(-(2**31) + 1, 2**31 - 1),
    st.floats(-(2**31) + 1, 2**31 - 1),
    numbers,
    st.booleans(),
)
homes = st.tuples(latitudes, longitudes, st.floats(-2e6, 2e6)).filter(lambda home: home[:2] != (0.0, 0.0))


@st.composite
def missions(draw: st.DrawFn) -> Mission:
    items = draw(st.lists(st.one_of(located, commands), max_size=12))
    if items:
        jump = MissionItem(2, 177, float(draw(st.integers(1, len(items)))), 3.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        items.insert(draw(st.integers(0, len(items))), jump)
    # one NaN object, as equality of dataclasses looks at identity first
    items = [replace(item, **_nans(item)) for item in items]
    return Mission(items=tuple(items), home=draw(homes), source="a")


def _nans(item: MissionItem) -> dict[str, Any]:
    names = ("param1", "param2", "param3", "param4")
    return {name: math.nan for name in names if math.isnan(getattr(item, name))}


@given(missions())
@settings(max_examples=examples(200), deadline=None)
def test_waypoints_come_back(mission: Mission) -> None:
    assert parse_waypoints(format_waypoints(mission), "a") == mission


@given(missions(), st.dictionaries(st.text(max_size=5), st.integers() | st.text(max_size=5), max_size=3))
@settings(max_examples=examples(200), deadline=None)
def test_plans_come_back(mission: Mission, settings_: dict[str, object]) -> None:
    known = {key: value for key, value in settings_.items() if key not in ("items", "plannedHomePosition", "version")}
    full = replace(mission, settings=known)
    assert parse_plan(format_plan(full), "a") == full


def outcome(text: str) -> None:
    """A mission or an InputError that says something; anything else fails the test."""
    for parse in (parse_plan, parse_waypoints):
        said: InputError | None = None
        try:
            mission = parse(text, "a")
        except InputError as error:
            said = error
        if said is not None:
            assert said.problems
            str(said).encode()  # a terminal can show it
            continue
        for item in mission.items:
            assert all(math.isfinite(value) for value in item.values[4:])
        parse_waypoints(format_waypoints(mission), "a")
        if mission.home:
            parse_plan(format_plan(mission), "a")


def places(value: Any) -> Iterator[tuple[Any, Any]]:
    """(container, key) of everything in a JSON document."""
    if isinstance(value, dict | list):
        for key in list(value) if isinstance(value, dict) else range(len(value)):
            yield value, key
            yield from places(value[key])


def test_every_key_of_a_plan_deleted_or_replaced() -> None:
    plan = json.loads(SURVEY)
    count = sum(1 for _ in places(plan))
    assert count > 250
    poisons: tuple[Any, ...] = (
        "delete",
        None,
        True,
        -1,
        1e39,
        10**30,
        "x",
        "\ud800",
        [],
        {},
        [[]],
        {"type": "SimpleItem"},
    )
    for index in range(count):
        for poison in poisons:
            broken = copy.deepcopy(plan)
            container, key = next(place for at, place in enumerate(places(broken)) if at == index)
            if poison == "delete":
                del container[key]
            else:
                container[key] = poison
            outcome(json.dumps(broken))


@pytest.mark.slow
def test_every_line_deleted_doubled_or_cut() -> None:
    for text in (SURVEY, SQUARE):
        lines = text.splitlines(keepends=True)
        for at, line in enumerate(lines):
            for middle in ("", line + line, line[: len(line) // 2], line.replace("\t", ""), line.swapcase()):
                outcome("".join([*lines[:at], middle, *lines[at + 1 :]]))


@given(st.sampled_from([SURVEY, SQUARE]), st.data())
@settings(max_examples=examples(200), deadline=None)
def test_random_damage(text: str, data: st.DataObject) -> None:
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(text)))
        end = data.draw(st.integers(at, min(at + 20, len(text))))
        text = text[:at] + data.draw(st.text(max_size=8)) + text[end:]
    outcome(text)


@given(st.text())
@settings(max_examples=examples(200), deadline=None)
def test_random_text(text: str) -> None:
    outcome(text)
    outcome("QGC WPL 110\n" + text)
    outcome('{"fileType": "Plan", "version": 1, "mission": {"version": 2, "items": [' + text + "]}}")
