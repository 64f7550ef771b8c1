"""Tables of docs/data/parity.json, of flights that are made up."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from skyrange.parity.flights import FlightMeasures, Parity
from tests.parity import tables

DATA = Path(__file__).parents[2] / "docs" / "data" / "parity.json"


def flight(at_s: float, measures: Mapping[str, float], east_m: float = 0.0, **sent: int) -> FlightMeasures:
    path = (np.array([0.0, 1.0]), np.array([[0.0, 0.0, 0.0], [east_m, 0.0, 0.0]]))
    return FlightMeasures("blue/x", "any", "complete", ((0.0, "AUTO"),), ((at_s, 2),), measures, sent, {}, path)


def both(lift_off_s: float, leg_s: float, at_s: float = 30.0, east_m: float = 0.5) -> Parity:
    return Parity(
        {"blue/x": flight(at_s, {"lift_off_s": lift_off_s, "leg_1_s": leg_s}, east_m, HEARTBEAT=10, WIND=9)},
        {"blue/x": flight(30.0, {"lift_off_s": 12.0, "leg_1_s": 5.0}, HEARTBEAT=11)},
    )


def test_measures_are_those_that_differ_most() -> None:
    rows = tables.measures(both(12.2, 4.9), 10.0)["rows"]
    assert rows[0] == ["lift-off after departure", "1", "x", "2.20 s", "2.00 s", "+0.20 s", "+10.0%"]
    assert rows[-1] == ["a leg's duration", "1 legs", "x, leg 1", "4.90 s", "5.00 s", "-0.10 s", "-2.0%"]


def test_missions_have_their_common_items_and_the_largest_distance() -> None:
    assert tables.missions(both(12.2, 4.9))["rows"] == [["x", "AUTO", "2", "30.00 s, 30.00 s", "0.5 m"]]


def test_cheaper_rates_are_compared_over_all_winds() -> None:
    flown = {"single": {0.0: both(12.2, 5.0), 8.0: both(12.1, 4.0, 30.4, 2.0)}}
    table = tables.rates(flown, 10.0)
    assert table["heads"] == ["measure", "single: largest in", "difference"]
    assert table["rows"] == [
        ["last common item", "x, wind", "0.4 s"],
        ["lift-off after departure", "x", "0.20 s, 10.0%"],
        ["a leg's duration", "x, wind, leg 1", "1.00 s, 20.0%"],
        ["position at equal time", "x, wind", "2.0 m"],
    ]


def test_messages_that_differ_come_before_those_that_do_not() -> None:
    rows = tables.messages(both(12.2, 4.9), "blue/x")["rows"]
    assert [row[:3] for row in rows] == [["`WIND`", "9", "0"], ["`HEARTBEAT`", "equally often", ""]]


def test_hover_has_every_measure() -> None:
    rows = tables.hover(dict.fromkeys(tables.HOVER, 1.1), dict.fromkeys(tables.HOVER, 1.0))["rows"]
    assert [row[-1] for row in rows] == ["+10.0%"] * len(tables.HOVER)


def test_the_shipped_tables_have_as_many_cells_as_heads() -> None:
    for name, table in json.loads(DATA.read_text(encoding="utf-8")).items():
        assert {len(row) for row in table["rows"]} == {len(table["heads"])}, name
