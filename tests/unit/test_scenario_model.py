from __future__ import annotations

import copy
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Any, TypeVar

import numpy as np
import pytest
from pydantic import BaseModel

from skyrange.contracts.links import Channel
from skyrange.core.errors import InputError
from skyrange.scenario.model.scenario import (
    City,
    Link,
    Operator,
    Path,
    Plan,
    Scenario,
    Vehicle,
    json_schema,
    mission_file,
    path,
    square,
)

ORIGIN = (-35.3633280, 149.1652241)


M = TypeVar("M", bound=BaseModel)


def make(model: type[M], **data: Any) -> M:
    """A model from data that it converts."""
    return model(**data)


def fleet(*ids: str) -> list[Vehicle]:
    return [make(Vehicle, id=name, start=(10.0 * i, 0.0), plan=square(5, 5)) for i, name in enumerate(ids)]


def one(**keys: Any) -> Scenario:
    keys.setdefault("operators", [make(Operator, id="blue", vehicles=fleet("b1", "b2"))])
    return Scenario(**{"origin": ORIGIN, **keys})


def test_little_is_enough_and_the_rest_is_filled_in() -> None:
    vehicles = [make(Vehicle, start=(5 * i, 5), plan=square(5, alt_m=5)) for i in range(5)]
    scenario = make(
        Scenario,
        origin=ORIGIN,
        operators=[make(Operator, id="blue", vehicles=vehicles[:2]), make(Operator, id="green", vehicles=vehicles[2:])],
    )
    assert [vehicle.id for _, vehicle in scenario.fleet] == ["b1", "b2", "g1", "g2", "g3"]
    assert [vehicle.system_id for _, vehicle in scenario.fleet] == [1, 2, 1, 2, 3]
    assert [operator.color for operator in scenario.operators] == ["blue", "green"]
    assert scenario.start_utc == datetime(2026, 1, 1, 12, tzinfo=UTC)
    assert scenario.operators[0].vehicles[0].plan.end == "land"
    assert vehicles[0].id == ""  # the caller's own objects stay as they were


def test_named_and_numbered_things_keep_their_names() -> None:
    vehicles = [
        Vehicle(id="b2", plan=square(1, 1)),
        Vehicle(plan=square(1, 1)),
        Vehicle(plan=square(1, 1), system_id=1),
    ]
    scenario = one(operators=[make(Operator, color="blue", vehicles=vehicles), make(Operator, vehicles=fleet("x"))])
    blue, other = scenario.operators
    assert (blue.id, other.id, other.color) == ("blue", "op2", "green")
    assert [vehicle.id for vehicle in blue.vehicles] == ["b2", "b3", "b4"]
    assert [vehicle.system_id for vehicle in blue.vehicles] == [2, 3, 1]


def test_a_dict_a_model_and_numpy_are_one_scenario() -> None:
    by_model = one(
        operators=[make(Operator, id="a", vehicles=[make(Vehicle, start=(1, 2, 90), plan=path([(1, 2), (3, 4)], 7))])]
    )
    plan = {"path": {"points": [[1, 2], [3, 4]], "alt_m": 7}}
    start = {"east_m": 1, "north_m": 2, "heading_deg": 90}
    by_dict = one(operators=[{"id": "a", "vehicles": [{"start": start, "plan": plan}]}])
    points = np.array([[1, 2], [3, 4]], dtype=np.float32)
    vehicle = make(Vehicle, start=np.array([1, 2, 90]), plan=path(points, np.float64(7)), depart_s=np.int64(0))
    assert by_model == by_dict == one(operators=[make(Operator, id="a", vehicles=[vehicle])])


def test_times_are_utc() -> None:
    from datetime import timedelta, timezone

    east = timezone(timedelta(hours=2))
    assert one(start_utc=datetime(2026, 1, 1, 14, tzinfo=east)).start_utc == datetime(2026, 1, 1, 12, tzinfo=UTC)
    assert one(start_utc=datetime(2026, 1, 1, 12)).epoch.iso(0) == "2026-01-01T12:00:00.000Z"
    for year in (1969, 2100, 1):
        with pytest.raises(InputError, match="from 1970 to 2099"):
            one(start_utc=datetime(year, 1, 1, tzinfo=east))


def test_paths_have_heights() -> None:
    assert make(Path, points=[(1, 2), (3, 4, 9)], alt_m=5).points_enu_m == ((1, 2, 5), (3, 4, 9))
    with pytest.raises(InputError, match=r"points\.1: \[3\.0, 4\.0\] — expected \[east_m, north_m, up_m\]"):
        make(Path, points=[(1, 2, 3), (3, 4)])
    with pytest.raises(InputError, match=r"points\.0: \[1\.0, 2\.0, -3\.0\] — expected an up_m more than 0"):
        make(Path, points=[(1, 2, -3)])


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({}, "exactly one of square, path, route and file"),
        ({"square": {"side_m": 1, "alt_m": 1}, "file": "x.plan"}, "square and file — expected exactly one"),
        ({"square": {"side_m": 1, "alt_m": 1}, "anchor": "start"}, "only a mission file has coordinates of its own"),
        ({"file": "x.plan", "end": "rtl"}, "no end, because the mission file sets it"),
        ({"file": "x.plan", "mode": "guided"}, "the autopilot flies a mission file"),
        ({"file": "x.plan", "speed_mps": 3}, "WPNAV_SPEED"),
        ({"file": "x.kml"}, r"ends in \.plan or \.waypoints or \.txt"),
        ({"square": {"side_m": 1, "alt_m": 0}}, "more than 0"),
        ({"square": {"side_m": 1, "alt_m": float("nan")}}, "a finite number"),
        ({"square": {"side_m": True, "alt_m": 1}}, "a number"),
    ],
)
def test_plans_that_make_no_sense_are_refused(keys: dict[str, Any], expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        Plan(**keys)


def test_a_file_plan_is_flown_where_it_was_drawn_unless_anchored() -> None:
    assert mission_file("m.waypoints").anchor == "file"
    assert mission_file("m.plan", anchor="start").anchor == "start"
    with pytest.raises(InputError, match="anchored at its own coordinates"):
        one(operators=[make(Operator, id="a", vehicles=[Vehicle(plan=mission_file("m.plan"), placing="clear")])])


def test_cities_have_one_source() -> None:
    assert make(City, grid={}).grid is not None
    with pytest.raises(InputError, match="both — expected exactly one"):
        make(City, grid={}, buildings="x")
    with pytest.raises(InputError, match="exactly one"):
        City()
    with pytest.raises(InputError, match="the lower height first"):
        make(City, grid={"height_m": (30, 20)})


@pytest.mark.parametrize(
    ("operators", "expected"),
    [
        ([], "operators: none — expected at least one operator"),
        ([{"id": "a", "vehicles": []}], r"operators\.a\.vehicles: none — expected at least one vehicle"),
        ([{"id": "a", "vehicles": fleet("x")}] * 2, "an id that no other operator has"),
        ([{"id": "a", "vehicles": fleet("x", "x")}], "an id that no other vehicle of this operator has"),
        ([{"id": "a/b", "vehicles": fleet("x")}], "letters, digits"),
        ([{"id": "a", "color": "blu", "vehicles": fleet("x")}], "Did you mean 'blue'"),
        ([{"id": "a", "approval": "aprove-all", "vehicles": fleet("x")}], "Did you mean 'approve-all'"),
    ],
)
def test_fleets_that_make_no_sense_are_refused(operators: list[Any], expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        one(operators=operators)


def test_vehicles_that_make_no_sense_are_refused() -> None:
    plan = square(1, 1)
    cases: list[tuple[dict[str, Any], str]] = [
        ({"autopilot": "bultin"}, "Did you mean 'builtin'"),
        ({"airframe": "irys"}, "Did you mean 'iris'"),
        ({"system_id": 251}, "at most 250"),
        ({"system_id": 0}, "at least 1"),
        ({"params": {"wpnav": 3}}, "wpnav"),
        ({"depart_s": -1}, "at least 0"),
        ({"placing": "clean"}, "Did you mean 'clear'"),
    ]
    for keys, expected in cases:
        with pytest.raises(InputError, match=expected):
            Vehicle(plan=plan, **keys)
    with pytest.raises(InputError, match="a system id that no other vehicle"):
        one(
            operators=[
                make(Operator, id="a", vehicles=[Vehicle(plan=plan, system_id=7), Vehicle(plan=plan, system_id=7)])
            ]
        )


def test_two_hundred_and_fifty_aircraft_are_numbered() -> None:
    scenario = one(operators=[make(Operator, id="a", vehicles=[Vehicle(plan=square(1, 1)) for _ in range(250)])])
    assert [vehicle.system_id for _, vehicle in scenario.fleet] == list(range(1, 251))


def test_link_rules_stack_in_order() -> None:
    scenario = one(
        links=[
            Link(match="gcs:*", latency_ms=40, loss=0.1),
            Link(match="gcs:blue/b1", latency_ms=0.001, mode="reliable", queue_bytes=99, reorder_ms=0.25),
        ]
    )
    base = Channel(latency_ns=5, jitter_ns=7)
    assert scenario.channel("log:blue/b1", base) == base
    assert scenario.channel("gcs:blue/b2", base) == Channel(latency_ns=40_000_000, jitter_ns=7, loss=0.1)
    assert scenario.channel("gcs:blue/b1", base) == Channel(
        mode="reliable", latency_ns=1_000, jitter_ns=7, loss=0.1, queue_bytes=99, reorder_ns=250_000
    )


def test_a_rule_that_no_link_matches_is_refused() -> None:
    with pytest.raises(InputError, match=r"links\.0\.match: gsc:blue/b1.*Did you mean 'gcs:blue/b1'"):
        one(links=[Link(match="gsc:blue/b1", loss=0.5)])


def test_a_scenario_is_frozen_data() -> None:
    scenario = one()
    with pytest.raises(Exception, match="frozen"):
        scenario.seed = 3
    assert copy.deepcopy(scenario) == scenario


def test_python_hears_all_faults_at_once_with_nearest_spellings() -> None:
    with pytest.raises(InputError) as error:
        make(Vehicle, strt=(1, 2), plan=square(1, 1), depart_s="5 s")
    assert error.value.who == "Vehicle"
    assert "Did you mean 'start'?" in str(error.value)
    assert "Write depart_s = 5 without quotes, in seconds." in str(error.value)


def test_every_property_of_the_json_schema_is_described() -> None:
    schema = json_schema()
    undescribed = [
        f"{name}.{key}"
        for name, part in [("Scenario", schema), *schema["$defs"].items()]
        for key, value in part["properties"].items()
        if not value.get("description")
    ]
    assert undescribed == []
    for name, part in schema["$defs"].items():
        assert part["additionalProperties"] is False, name
    lengths = [
        (key, value["description"])
        for part in schema["$defs"].values()
        for key, value in part["properties"].items()
        if key.endswith("_m") and not key.startswith(("height", "points"))
    ]
    assert lengths
    assert all("metre" in description.lower() for _, description in lengths)


def test_half_a_character_is_refused() -> None:
    for keys in (
        {"name": "a\ud800"},
        {"city": {"grid": {"a\ud800": 1}}},
        {"operators": [{"id": "a", "color": "a\ud800", "vehicles": fleet("x")}]},
    ):
        with pytest.raises(InputError) as error:
            one(**keys)
        str(error.value).encode()  # what is said can be printed


ANY = {"type", "title", "description", "default", "examples", "enum", "const", "allOf", "anyOf", "$defs", "$schema"}
NUMBERS = {"minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum", "multipleOf"}
KEYWORDS = {
    "number": NUMBERS,
    "integer": NUMBERS,
    "string": {"minLength", "maxLength", "pattern", "format"},
    "array": {"items", "prefixItems", "minItems", "maxItems", "uniqueItems"},
    "object": {"properties", "required", "additionalProperties", "propertyNames", "patternProperties"}
    | {"minProperties", "maxProperties"},
    "boolean": set(),
    "null": set(),
}
"""Of JSON Schema, draft 2020-12, by type: others say nothing."""


def test_the_json_schema_states_every_bound_in_its_own_words() -> None:
    def parts(part: object) -> Iterator[dict[str, Any]]:
        if isinstance(part, dict):
            if isinstance(part.get("type"), str):
                yield part
            for key, value in part.items():
                if key not in ("default", "examples", "const", "enum"):
                    yield from parts(value)
        elif isinstance(part, list):
            for value in part:
                yield from parts(value)

    schema = json_schema()
    unknown = [(part["type"], set(part) - ANY - KEYWORDS[part["type"]], part.get("title")) for part in parts(schema)]
    assert not [one for one in unknown if one[1]]
    assert schema["properties"]["seed"]["minimum"] == 0
    speed = schema["$defs"]["Plan"]["properties"]["speed_mps"]["anyOf"][0]
    assert (speed["exclusiveMinimum"], speed["maximum"]) == (0, 50)
