"""Routes in scenarios: planned around the buildings before anything starts, and what is wrong with them."""

from __future__ import annotations

from itertools import pairwise

import pytest

from skyrange.assembly.build import build
from skyrange.core.errors import InputError
from skyrange.gcs.plan.routes import enu_points
from skyrange.scenario.model.plan import Plan, route
from skyrange.scenario.toml_files import load_text

BASE = """
name = "routes"
duration_s = 6
origin = [40.778, -73.955]
[city]
grid = { blocks = [12, 12], height_m = [20, 90] }
[[operators]]
id = "blue"
  [[operators.vehicles]]
  id = "b1"
  plan = PLAN
"""


def with_plan(plan: str, more: str = "") -> str:
    return BASE.replace("PLAN", plan) + more


def test_a_route_becomes_a_path_around_the_buildings() -> None:
    built = build(load_text(with_plan("{ route = { to = [188, 92], via = [[94, 0]], alt_m = 30 } }")))
    plan = built.scenario.operators[0].vehicles[0].plan
    assert plan.route is None
    assert plan.end == "land"
    assert plan.path is not None
    points = plan.path.points_enu_m
    assert points[0] == (0.0, 0.0, 30.0)
    assert (94.0, 0.0, 30.0) in points
    assert points[-1] == (188.0, 92.0, 30.0)
    assert len(points) > 4, "not straight through the blocks"
    assert built.city is not None
    assert built.city.is_clear(points, 4.9)
    (flight,) = [agent for agent in built.wiring.agents if agent.name == "blue.gcs"]
    flown = enu_points(flight._sequencers[0].flight.plan)  # type: ignore[attr-defined]
    assert all(built.city.is_clear(leg, 4.9) for leg in pairwise(flown))


def test_without_a_city_a_route_is_straight() -> None:
    text = with_plan("{ route = { to = [188, 92], alt_m = 30 }, end = 'rtl' }")
    text = text.replace("[city]\ngrid = { blocks = [12, 12], height_m = [20, 90] }\n", "")
    plan = build(load_text(text)).scenario.operators[0].vehicles[0].plan
    assert plan.path is not None
    assert plan.path.points_enu_m == ((0.0, 0.0, 30.0), (188.0, 92.0, 30.0))
    assert plan.end == "rtl"


@pytest.mark.parametrize(
    ("plan", "more", "words"),
    [
        (
            "{ route = { to = [47, 47], alt_m = 12 } }",
            "",
            r"plan\.route: no way .*leg 1 ends at \(47, 47\) m, nearer than 5 m",
        ),
        (
            "{ route = { to = [94, 0], alt_m = 30 } }",
            "  placing = 'clear'\n",
            r"placing: .*exact.* a route begins where",
        ),
        ("{ route = { to = [0, 0], alt_m = 30 } }", "", "another place than the start"),
        ("{ route = { to = [9, 0], alt_m = 130 } }", "", "at most the ceiling_m of 120 m"),
        ("{ route = { to = [9, 0], alt_m = 30, clearance_m = 0 } }", "", "clearance_m: 0 — expected"),
        ("{ route = { to = [9, 0], alt_m = 30 }, square = { side_m = 1, alt_m = 1 } }", "", "exactly one of square"),
    ],
)
def test_what_is_wrong_with_a_route_is_named(plan: str, more: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        build(load_text(with_plan(plan, more)))


def test_a_route_in_python() -> None:
    plan = route([10, 20], 30, via=[(1, 2)], ceiling_m=60, speed_mps=4)
    assert isinstance(plan, Plan)
    assert plan.route is not None
    assert (plan.route.to, plan.route.via, plan.route.ceiling_m, plan.speed_mps) == ((10, 20), ((1, 2),), 60, 4)
