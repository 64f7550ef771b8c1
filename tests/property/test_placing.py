"""What `placing = "clear"` makes of starts: every aircraft that stands nearer to another than asked is named."""

from __future__ import annotations

import math
from itertools import combinations
from typing import Any

import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.assembly.build import build
from skyrange.assembly.city import build_city
from skyrange.assembly.placement.clear_placing import apply_placing
from skyrange.assembly.placement.moved_places import describe_moves, describe_placing
from skyrange.city.buildings import Building
from skyrange.city.city import City
from skyrange.core.ids import vehicle_id
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.toml_files import load_data

HOVER = {"path": {"points": [[0, 0], [0, 12]], "alt_m": 15}, "end": "land"}
ORIGIN = {"lat": 40.778, "lon": -73.955}
BLOCKS = st.lists(st.tuples(st.floats(-150, 150), st.floats(-150, 150), st.floats(8, 60)), min_size=1, max_size=5).map(
    lambda rows: [shapely.box(east - half, north - half, east + half, north + half) for east, north, half in rows]
)
FLEETS = st.lists(
    st.fixed_dictionaries(
        {
            "count": st.integers(1, 5),
            "start": st.tuples(st.integers(-80, 80), st.integers(-80, 80)),
            "spacing_m": st.tuples(st.integers(25, 90), st.integers(25, 90)),
            "placing": st.sampled_from(["exact", "clear", "clear"]),
        }
    ),
    min_size=1,
    max_size=2,
)


def town(*shapes: Any) -> City:
    return City([Building(str(number), 40.0, shape) for number, shape in enumerate(shapes)], "drawn")


def fleets_of(*fleets: dict[str, Any], **more: Any) -> dict[str, Any]:
    operators = [
        {"id": f"o{number}", "fleets": [{"plan": HOVER, **fleet}], "avoidance": {"kind": "geometric"}}
        for number, fleet in enumerate(fleets)
    ]
    return {"name": "placed", "duration_s": 5, "origin": ORIGIN, "radio": {}, "operators": operators, **more}


def starts(scenario: Scenario) -> dict[str, tuple[float, float]]:
    return {
        vehicle_id(operator.id, vehicle.id): (vehicle.start.east_m, vehicle.start.north_m)
        for operator, vehicle in scenario.fleet
    }


@settings(max_examples=12)
@given(BLOCKS, FLEETS)
def test_no_pair_is_nearer_than_declared_unless_it_is_listed(shapes: list[Any], fleets: list[dict[str, Any]]) -> None:
    before = load_data(fleets_of(*fleets))
    after = apply_placing(before, town(*shapes))
    listed = {row["vehicle"]: row for row in describe_moves(before, after)}
    declared, placed = starts(before), starts(after)
    for pair in combinations(placed, 2):
        if math.dist(*(placed[one] for one in pair)) < math.dist(*(declared[one] for one in pair)):
            assert listed.keys() & set(pair), pair
    for name, row in listed.items():
        others = {one: math.dist(placed[name], place) for one, place in placed.items() if one != name}
        assert (row["from_enu_m"], row["to_enu_m"]) == (list(declared[name]), list(placed[name]))
        assert row["moved_m"] == round(math.dist(declared[name], placed[name]), 3) > 0
        if others:
            least = min(others.values())
            assert row["nearest_m"] == round(others[row["nearest"]], 3) == round(least, 3)
            assert row["declared_m"] == round(math.dist(declared[name], declared[row["nearest"]]), 3)
            assert row.get("protected_m") == (20.0 if least < 20.0 else None)  # the default of avoidance
    assert set(listed) == {name for name in placed if placed[name] != declared[name]}
    assert len(describe_placing(listed.values())) == len(listed)


def test_the_manifest_lists_what_was_moved() -> None:
    """Where a tower is, two aircraft with 60 m between them come together on the other side of the street."""
    city = {"grid": {"blocks": [3, 3], "height_m": [40, 60]}}
    [inside, *_] = build_city(load_data(fleets_of({"count": 1}, city=city))).buildings  # type: ignore[union-attr]
    place = inside.shape.representative_point()
    receiver = {"id": "r", "operator": "o0", "place": [place.x, place.y, 2], "placing": "clear"}
    moved = build(
        load_data(
            fleets_of(
                {"count": 4, "start": [30, 30], "spacing_m": [60, 60], "placing": "clear"},
                city=city,
                radio={"receivers": [receiver]},
            )
        )
    )
    rows = moved.header["placing"]
    assert {row.get("vehicle") for row in rows} >= {"o0/o1"}
    assert [row["receiver"] for row in rows if "receiver" in row] == ["r"]
    text = describe_placing(rows)
    assert any(line.startswith("o0/o1 moved by ") for line in text)
    assert any("declared: " in line for line in text)
    still = build(load_data(fleets_of({"count": 2, "spacing_m": [60, 60], "placing": "clear"}, radio={})))
    assert "placing" not in still.header
