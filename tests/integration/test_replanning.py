"""Do stations lead flights around places where links are lost, and shorten those whose battery will not last?"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_S
from skyrange.record import RunRecord
from skyrange.scenario.toml_files import load_text
from skyrange.study.runs import fly

pytestmark = pytest.mark.rotating

SCENARIO = """
name = "replanned"
duration_s = {duration}
origin = [40.778, -73.955]
[[operators]]
id = "blue"
approval = "{approval}"
margins = {{ horizontal_m = 6, late_s = 8, drift = 0.1 }}
replan = {{ {replan} }}
{vehicles}
{more}
"""
ONE = """
  [[operators.vehicles]]
  id = "{id}"
  start = [{east}, 0]
  plan = {{ path = {{ points = [{points}], alt_m = 20 }}, speed_mps = 5, end = "{end}" }}
  depart_s = {depart}
"""


def vehicle(name: str, points: str, depart_s: float = 20.0, **more: Any) -> str:
    return ONE.format(**{"id": name, "points": points, "depart": depart_s, "east": 0, "end": "land", **more})


def flown(vehicles: str, replan: str, more: str = "", *, duration_s: int, approval: str = "authority") -> RunRecord:
    text = SCENARIO.format(vehicles=vehicles, replan=replan, more=more, duration=duration_s, approval=approval)
    return fly(load_text(text), report=False)


def kinds(record: RunRecord, vehicle: str) -> list[str]:
    return [row["kind"] for row in record.table("decisions").to_pylist() if row["about"] == vehicle]


def track(record: RunRecord, vehicle: str) -> Any:
    rows = [row for row in record.table("truth").to_pylist() if row["vehicle"] == vehicle]
    return np.array([(row["time_ns"] / NS_PER_S, row["east_m"], row["north_m"], row["up_m"]) for row in rows])


LOSS = """
[[attacks]]
id = "jam"
kind = "link.drop"
start_s = 58
stop_s = 75
params = { links = ["gcs:blue/b1"] }
"""
FIRST = vehicle("b1", "[0, 0], [0, 200]")
SECOND = vehicle("b2", "[0, 0], [0, 200]", 40.0, east=20)


def test_a_flight_goes_around_a_place_where_the_link_of_another_one_was_lost() -> None:
    record = flown(FIRST + SECOND, "jammed_radius_m = 40", LOSS, duration_s=132)
    (place,) = [row for row in record.table("decisions").to_pylist() if row["kind"] == "decision.area_jammed"]
    assert place["about"] == "blue/b1"
    assert "decision.rerouted" in kinds(record, "blue/b2")
    assert "decision.rerouted" not in kinds(record, "blue/b1"), "it is inside"
    assert record.outcomes["blue/b2"]["state"] == "complete"
    jammed = next(row for row in track(record, "blue/b1") if row[0] >= place["time_ns"] / NS_PER_S)
    rest = track(record, "blue/b2")
    rest = rest[rest[:, 0] > place["time_ns"] / NS_PER_S + 3.0]
    # the position was reported before the link was lost, up to 5 s and 25 m earlier
    assert np.hypot(rest[:, 1] - jammed[1], rest[:, 2] - (jammed[2] - 25.0)).min() > 40.0
    assert "decision.intent_nonconforming" not in kinds(record, "blue/b2")


def test_without_the_rule_it_flies_through_it() -> None:
    record = flown(FIRST + SECOND, "battery_reserve = 0.01", LOSS, duration_s=80)
    assert "decision.area_jammed" not in kinds(record, "blue/b1")
    assert "decision.rerouted" not in kinds(record, "blue/b2")


DETOUR = "[0, 0], [0, 120], [120, 120], [120, 0], [0, 40]"


@pytest.mark.parametrize("approval", ["authority", "federated"])
def test_a_flight_whose_battery_will_not_last_skips_the_points_between(approval: str) -> None:
    """It takes a fifth of a percent per second, and two minutes for the whole plan."""
    record = flown(vehicle("b1", DETOUR), "battery_reserve = 0.75", duration_s=84, approval=approval)
    seen = kinds(record, "blue/b1")
    assert seen.count("decision.battery_short") == 1
    assert "decision.rerouted" in seen
    assert record.outcomes["blue/b1"]["state"] == "complete"
    flight = track(record, "blue/b1")
    assert flight[:, 1].max() < 60.0, "it does not fly east"
    assert np.hypot(flight[-1, 1], flight[-1, 2] - 40.0) < 5.0, "it lands where it wanted to"


def test_a_flight_returns_where_that_is_nearer() -> None:
    record = flown(vehicle("b1", "[0, 0], [0, 400]"), "battery_reserve = 0.85", duration_s=100)
    seen = kinds(record, "blue/b1")
    assert "decision.battery_short" in seen
    assert "decision.intent_contingent" in seen, "the approval is told"
    outcome = record.outcomes["blue/b1"]
    assert (outcome["state"], "battery would end below its reserve" in outcome["reason"]) == ("failed", True)
    assert np.hypot(*track(record, "blue/b1")[-1, 1:3]) < 5.0


def test_a_battery_that_lasts_changes_nothing() -> None:
    record = flown(vehicle("b1", DETOUR), "battery_reserve = 0.5, jammed_radius_m = 50", duration_s=169)
    assert record.outcomes["blue/b1"]["state"] == "complete"
    assert "decision.battery_short" not in kinds(record, "blue/b1")


def test_it_needs_an_approval_that_tracks_intents() -> None:
    text = SCENARIO.format(vehicles="", replan="battery_reserve = 0.2", more="", duration=9, approval="approve-all")
    with pytest.raises(InputError, match="replan: a table — expected none, because approve-all tracks no intents"):
        load_text(text)
