"""Fences and rally points of plan files: they come back, move without a change of shape, and are read or refused."""

from __future__ import annotations

import json
from math import hypot
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mission import MissionItem, format_plan, parse_plan
from skyrange.codec.mission.fence_and_rally import circle, polygon, rally_point, return_point
from skyrange.codec.mission.items import Mission
from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.gcs.plan.paths import Point
from skyrange.gcs.plan.plans import FlightPlan, anchored
from skyrange.gcs.protocols.mission_transfer import Download, ItemList, encode_lists
from skyrange.twins.failed_missions import REJECTIONS

HOME = (47.3977, 8.5456, 408.0)
TAKEOFF = MissionItem(3, 22, 0.0, 0.0, 0.0, 0.0, HOME[0], HOME[1], 20.0)
places = st.tuples(st.floats(47.39, 47.41), st.floats(8.53, 8.56))
heights = st.floats(-100.0, 300.0)
polygons = st.builds(polygon, st.lists(places, min_size=3, max_size=9), inclusion=st.booleans())
circles = st.builds(circle, places, st.floats(0.5, 900.0), inclusion=st.booleans())
returns = st.just(()) | st.builds(return_point, places, heights)
fences = st.builds(
    lambda rings, rounds, back: sum(rings, ()) + sum(rounds, ()) + back,
    st.lists(polygons, max_size=4), st.lists(circles, max_size=4), returns,
)  # fmt: skip
rallies = st.lists(st.builds(rally_point, places, heights), max_size=5).map(tuple)


def mission_of(fence: tuple[MissionItem, ...], rally: tuple[MissionItem, ...]) -> Mission:
    return Mission((TAKEOFF,), HOME, fence, rally, "a", {})


@given(fences, rallies)
def test_they_come_back(fence: tuple[MissionItem, ...], rally: tuple[MissionItem, ...]) -> None:
    read = parse_plan(format_plan(mission_of(fence, rally)), "a")
    assert (read.fence, read.rally) == (fence, rally)


@given(fences, rallies, st.floats(-80.0, 80.0), st.floats(-179.0, 179.0))
def test_they_keep_their_shape_where_a_plan_is_moved(
    fence: tuple[MissionItem, ...], rally: tuple[MissionItem, ...], lat: float, lon: float
) -> None:
    """Metres from home, of each item, before and after; altitudes and radii stay."""
    there, here = Origin(HOME[0], HOME[1]), Origin(lat, lon)
    moved = anchored(mission_of(fence, rally), here, Point(100.0, -50.0, 0.0))
    for old, new in zip((*fence, *rally), (*moved.fence, *moved.rally), strict=True):
        east_m, north_m = there.enu_of(old.x, old.y)
        found = here.enu_of(new.x, new.y)
        assert hypot(found[0] - east_m - 100.0, found[1] - north_m + 50.0) < 1e-3
        assert (new.command, new.frame, new.param1, new.z) == (old.command, old.frame, old.param1, old.z)


@given(st.recursive(st.none() | st.booleans() | st.floats(-200, 200) | st.text(max_size=3),
                    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(
                        st.sampled_from(["polygons", "circles", "polygon", "circle", "center", "radius", "inclusion",
                                         "breachReturn", "points", "version"]), inner, max_size=4)))  # fmt: skip
def test_any_content_is_read_or_named(content: Any) -> None:
    document = json.loads(format_plan(mission_of((), ())))
    document["geoFence"] = document["rallyPoints"] = content
    refused: InputError | None = None
    try:
        found = parse_plan(json.dumps(document), "a")
        assert parse_plan(format_plan(found), "a") == found
    except InputError as error:
        refused = error
    for problem in refused.problems if refused is not None else ():
        assert problem.where.startswith(("geoFence", "rallyPoints"))


@given(fences.filter(bool), st.data())
def test_a_read_back_finds_any_difference_of_a_fence(fence: tuple[MissionItem, ...], data: st.DataObject) -> None:
    plan = FlightPlan("guided", "p", Origin(HOME[0], HOME[1]), Point(0.0, 0.0, 0.0), fence=fence)
    (sent,) = encode_lists(plan)
    assert sent.kind == mav.MAV_MISSION_TYPE_FENCE
    assert _read_back(sent, sent) == "done"
    place = data.draw(st.integers(0, len(fence) - 1))
    name, by = data.draw(st.sampled_from((("x", 1.0), ("y", -1.0), ("param1", 1.0), ("command", 1.0))))
    old = sent.items[place]
    altered = (
        *sent.items[:place],
        old._replace(**{name: type(getattr(old, name))(getattr(old, name) + by)}),
        *sent.items[place + 1 :],
    )
    found = _read_back(sent, ItemList(sent.kind, altered))
    assert found.startswith(f"fence read-back differs at item {place}: ")
    assert found.startswith(REJECTIONS), "a run that ends with this reason falls short"


def _read_back(sent: ItemList, stored: ItemList) -> str:
    one = Download(sent.items, 1, 1, sent.kind)
    one.begin(0)
    one.on_count(0, len(stored.items))
    for seq, item in enumerate(stored.items):
        one.on_item(0, item.message(seq, 255, 190, stored.kind))
    return one.result


@pytest.mark.parametrize(
    ("fence", "where"),
    [
        ({"polygons": [{"inclusion": True, "polygon": [[47.0, 8.0], [47.1, 8.0]]}]}, "geoFence.polygons[0].polygon"),
        ({"polygons": [{"polygon": [[47.0, 8.0]] * 3}]}, "geoFence.polygons[0].inclusion"),
        ({"circles": [{"inclusion": True, "circle": {"center": [91, 8], "radius": 5}}]}, "circles[0].circle.center"),
        ({"circles": [{"inclusion": True, "circle": {"center": [47, 8], "radius": 0}}]}, "circles[0].circle.radius"),
        ({"breachReturn": [47.0, 8.0]}, "geoFence.breachReturn"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named(fence: dict[str, Any], where: str) -> None:
    document = json.loads(format_plan(mission_of((), ())))
    document["geoFence"] = fence
    with pytest.raises(InputError) as caught:
        parse_plan(json.dumps(document), "a")
    assert where in str(caught.value)
