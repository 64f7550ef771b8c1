"""Requests that would harm others, or the approval: each approval refuses or survives them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import skyrange
from skyrange.core.chance import Chance
from skyrange.core.errors import DecodeError
from skyrange.core.geodesy import Origin
from skyrange.core.ids import APPROVAL
from skyrange.scenario.toml_reader import load_text
from skyrange.testing.checks.approval_policies import EPOCH, box
from skyrange.utm.contract import ApprovalContext, ApprovalPlugin, intent_id
from skyrange.utm.messages import Request, decode_request, encode
from tests.approval_stations import LAT, LON, Station, ask, decisions, fly_requests, intent

NAMES = ("blue", "green", "red")
KINDS: list[tuple[str, dict[str, Any]]] = [
    ("authority", {}),
    ("authority", {"order": "least_served", "window_s": 4.0}),
    ("federated", {}),
    ("federated", {"services": {"all": list(NAMES)}}),
    ("hashgraph", {}),
]


def flown(kind: str, params: dict[str, Any], asks: dict[str, list[tuple[float, bytes]]]) -> dict[str, Station]:
    plugin = ApprovalPlugin.find(kind)
    context = ApprovalContext(f"{APPROVAL}.{kind}", NAMES, Origin(LAT, LON), EPOCH, Chance(3))
    service = plugin(plugin.params.model_validate(params), context)
    return fly_requests({name: asks.get(name, []) for name in NAMES}, 30.0, service.agents, service.links, 3, True)[0]


def foreign_end() -> bytes:
    """Green asks to end an intent that has the id of blue's."""
    return encode(Request.end(replace(intent("green/g1"), id=intent_id("blue/b1"))))


@pytest.mark.parametrize(("kind", "params"), KINDS)
@pytest.mark.parametrize("at_s", [0.05, 1.0, 8.0])
def test_nobody_ends_the_intent_of_another_operator(kind: str, params: dict[str, Any], at_s: float) -> None:
    """Before it is asked for, while it is decided, and afterwards."""

    wanted = box(LAT, LON)
    green = [(at_s, foreign_end()), (15.0, ask("green/g2", wanted))]
    stations = flown(kind, params, {"blue": [(0.9, ask("blue/b1", wanted))], "green": green})
    assert decisions(stations["blue"]) == ["Accepted"]
    assert decisions(stations["green"])[-1] == "Rejected"


def test_more_requests_at_once_than_an_event_takes() -> None:
    asks = [(0.1, ask(f"blue/b{number}", box(LAT + 0.002 * number, LON))) for number in range(70)]
    stations = flown("hashgraph", {}, {"blue": asks})
    assert decisions(stations["blue"]) == ["Accepted"] * 70


@pytest.mark.parametrize("year", ["1600", "0001", "9999"])
def test_moments_that_nobody_can_fly_at_are_refused(year: str) -> None:
    payload = ask("blue/b1", box(LAT, LON)).replace(b"2026-01-01", f"{year}-01-01".encode(), 1)
    with pytest.raises(DecodeError, match="1970 to 2200"):
        decode_request(payload)


SCENARIO = """
duration_s = 60
origin = { lat = 40.7780, lon = -73.9550 }
[[operators]]
id = "blue"
approval = "authority"
  [[operators.vehicles]]
  id = "b1"
  plan = { path = { points = [[0, 0], [100, 0]], alt_m = 30 }, speed_mps = 5, end = "land" }
  depart_s = 20
[[constraints]]
id = "fire"
corners_m = [[-20, -20], [150, -20], [150, 20], [-20, 20]]
published_s = PUBLISHED
"""


@pytest.mark.parametrize("published_s", [10.0, 17.0, 18.0, 18.5, 19.0, 19.5, 20.0])
def test_an_aircraft_does_not_take_off_into_an_area_that_is_closed(published_s: float, tmp_path: Path) -> None:
    scenario = load_text(SCENARIO.replace("PUBLISHED", str(published_s)))
    run = skyrange.run(scenario, tmp_path / "run")
    outcome = run.manifest["outcomes"]["blue/b1"]
    assert outcome["state"] == "failed"
    assert "approval" in outcome["reason"]
