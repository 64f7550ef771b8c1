"""Areas that are closed to flight: every approval keeps flights out of them from their publication on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
import shapely
from uas_standards.astm.f3548.v21.api import OperationID as Op

from skyrange.assembly.build import build
from skyrange.codec.f3548.frames import UssRequest, UssResponse, decode, encode
from skyrange.codec.f3548.operations import find_operation
from skyrange.contracts.mailboxes import Arrival, Inbox, Outbox
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.core.ids import APPROVAL, FrameId, Port
from skyrange.core.time import NS_PER_S, Time
from skyrange.core.volumes import Volume4D
from skyrange.gcs.plan.paths import Point
from skyrange.gcs.plan.plans import path
from skyrange.gcs.plan.rerouting import reroute
from skyrange.gcs.plan.volumes import Margins
from skyrange.planning.limits import NoRouteError
from skyrange.record import MemoryObserver
from skyrange.scenario.toml_files import load_text
from skyrange.study.runs import fly
from skyrange.testing.checks.approval_policies import EPOCH, box
from skyrange.utm.contract import ApprovalContext, ApprovalPlugin, ApprovalService, Constraint
from skyrange.utm.federated.constraint_manager import ConstraintManager
from skyrange.utm.federated.uss.service import Uss
from skyrange.utm.intent_states import IntentState
from tests.approval_stations import LAT, LON, Station, ask, decisions, end, fly_requests

pytestmark = pytest.mark.rotating

KINDS = ("authority", "federated", "hashgraph")
NAMES = ("blue", "green", "red")
FIRE = box(LAT, LON, start_s=0.0)
Asks = dict[str, Sequence[tuple[float, bytes]]]


def service_of(kind: str, published_s: float) -> ApprovalService:
    plugin = ApprovalPlugin.find(kind)
    closed = Constraint("fire", FIRE.__class__(FIRE.outline, 0.0, 500.0, 0, 3_600 * NS_PER_S), round(published_s * 1e9))
    context = ApprovalContext(f"{APPROVAL}.{kind}", NAMES, Origin(LAT, LON), EPOCH, Chance(3), None, [closed])
    return plugin(plugin.params(), context)


def flown(
    kind: str, asks: Asks, published_s: float, until_s: float = 20.0, service: ApprovalService | None = None
) -> tuple[dict[str, Station], MemoryObserver]:
    service = service or service_of(kind, published_s)
    rows = {name: asks.get(name, ()) for name in NAMES}
    return fly_requests(rows, until_s, service.agents, service.links, 3)


def here(north: float = 0.0, **more: float) -> Any:
    return box(LAT + north, LON, **{"start_s": 600.0, **more})


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_is_accepted_into_an_area_that_is_closed_and_alternatives_lead_around_it(kind: str) -> None:
    asks: Asks = {
        "blue": [(2.0, ask("blue/a", here())), (12.0, ask("blue/b", here(), priority=1_000))],
        "green": [(3.0, ask("green/a", here(0.01)))],
    }
    stations, _ = flown(kind, asks, 0.0)
    assert decisions(stations["blue"]) == ["Rejected", "Rejected"], "no priority of an operator is higher"
    _, body = stations["blue"].answers[0]
    assert "constraint" in body.reason
    assert body.alternatives, "it is open again after an hour"
    assert all(one.delay_s > 2_000 for one in body.alternatives if not (one.east_m or one.north_m))
    assert decisions(stations["green"]) == ["Accepted"]


@pytest.mark.parametrize("kind", KINDS)
def test_what_was_accepted_before_is_taken_back_and_who_flies_is_told(kind: str) -> None:
    flying = box(LAT + 0.0005, LON, start_s=0.0, lower_m=200.0)
    asks: Asks = {
        "blue": [(0.1, ask("blue/a", here()))],
        "green": [(0.1, ask("green/a", flying)), (4.0, ask("green/a", flying, state=IntentState.ACTIVATED, version=1))],
        "red": [(0.1, ask("red/a", here(0.01))), (18.0, end("red/a"))],
    }
    stations, seen = flown(kind, asks, 10.0, 30.0)
    assert decisions(stations["blue"]) == ["Accepted", "Rejected"]
    at, body = stations["blue"].answers[1]
    assert (body.overruled, "closes a part of it" in body.reason) == (True, True)
    assert 10 * NS_PER_S <= at <= 14 * NS_PER_S, "without a request"
    assert decisions(stations["green"]) == ["Accepted", "Accepted", "Accepted"]
    assert stations["green"].answers[2][1].overruled
    assert decisions(stations["red"]) == ["Accepted", "Ended"]
    published = [
        note for _, _, note in seen.notes if note.kind.endswith(("approval_constraint", "constraint_published"))
    ]
    assert len(published) == (3 if kind == "hashgraph" else 1)


def test_a_federation_shares_constraints_with_the_messages_of_the_standard() -> None:
    asks: Asks = {"blue": [(0.1, ask("blue/a", here(0.003))), (12.0, ask("blue/b", here(0.006)))]}
    _, seen = flown("federated", asks, 5.0)
    operations = []
    for frame in seen.frames:
        if frame.link.startswith("uss:"):
            message = decode(frame.payload)
            if isinstance(message, UssRequest):
                found = find_operation(message.method, message.path)
                assert found is not None
                operations.append(found.id)
    assert operations.count(Op.CreateConstraintReference) == 1
    assert operations.count(Op.NotifyConstraintDetailsChanged) == 1, "blue has an intent there, hence a subscription"
    assert operations.count(Op.GetConstraintDetails) == 0, "what was notified is not asked for"
    assert operations.count(Op.QueryConstraintReferences) == 2


def test_a_constraint_whose_manager_does_not_tell_closes_the_whole_area() -> None:
    service = service_of("federated", 0.0)
    (manager,) = [agent for agent in service.agents if isinstance(agent, ConstraintManager)]
    step = manager.step

    def silent(now: Time, inbox: Inbox) -> Outbox:
        return step(now, inbox if now < NS_PER_S else Inbox())

    manager.step = silent  # type: ignore[method-assign]
    stations, _ = flown("federated", {"blue": [(2.0, ask("blue/a", here(0.003)))]}, 0.0, 12.0, service)
    assert decisions(stations["blue"]) == ["Rejected"], "it is near"


def test_an_answer_that_belongs_to_a_request_that_was_given_up_is_not_taken_for_that_of_the_next_one() -> None:
    """The DSS fails at once to tell of constraints, and tells of intents when the next request is on its way."""
    (uss,) = [agent for agent in service_of("federated", 0.0).agents if isinstance(agent, Uss) and "blue" in agent.name]
    operator, dss = uss.ports[0], uss.ports[1]

    def receive(port: Port, payload: bytes) -> list[UssRequest]:
        """Let the USS read a frame; what it asks of the DSS in answer."""
        ref = FrameId(port.link, "up", "somebody", 1)
        out = uss.step(NS_PER_S, Inbox([Arrival(port, NS_PER_S, payload, "somebody", ref)]))
        asked = [decode(sent.payload) for sent in out.departures if sent.port == dss]
        return [frame for frame in asked if isinstance(frame, UssRequest)]

    def answer(asked: UssRequest, status: int, **body: Any) -> list[UssRequest]:
        return receive(dss, encode(UssResponse(exchange=asked.exchange, status=status, body=body)))

    intents, constraints = receive(operator, ask("blue/a", here()))
    assert answer(constraints, 500) == []
    next_intents, next_constraints = receive(operator, ask("blue/b", here()))
    assert answer(intents, 200, operational_intent_references=[]) == []
    assert answer(next_constraints, 200, constraint_references=[]) == [], "it has still not been told of intents"
    (put,) = answer(next_intents, 200, operational_intent_references=[])
    assert put.method == "PUT"


SCENARIO = """
duration_s = {duration}
origin = [40.778, -73.955]
[[constraints]]
id = "fire"
corners_m = {corners}
{more}
[[operators]]
id = "blue"
approval = "{approval}"
[[operators.vehicles]]
id = "b1"
plan = {{ path = {{ points = [[0, 0], [0, 120]], alt_m = 15 }}, end = "land" }}
depart_s = {depart}
"""


def scenario(**changes: Any) -> str:
    given = {
        "duration": 150,
        "corners": "[[-30, 30], [30, 30], [30, 90], [-30, 90]]",
        "more": "",
        "approval": "authority",
        "depart": 5.0,
    }
    return SCENARIO.format(**{**given, **changes})


@pytest.mark.parametrize("approval", [pytest.param("authority", marks=pytest.mark.slow), "federated"])
def test_an_aircraft_that_is_inside_an_area_when_it_is_closed_returns(approval: str) -> None:
    record = fly(load_text(scenario(duration=118, more="published_s = 55", approval=approval)))
    outcome = record.outcomes["blue/b1"]
    assert outcome["state"] == "failed"
    assert outcome["reason"].startswith("approval withdrawn: constraint")
    assert "closes a part of it" in outcome["reason"]


WIDE = Margins(horizontal_m=10.0, late_s=8.0, drift=0.1)
AHEAD = "[[-20, 110], [20, 110], [20, 150], [-20, 150]]"


@pytest.mark.parametrize(
    ("mode", "approval"),
    [
        ("auto", "authority"),
        pytest.param("guided", "authority", marks=pytest.mark.slow),
        pytest.param("auto", "federated", marks=pytest.mark.slow),
        pytest.param("guided", "hashgraph", marks=pytest.mark.slow),
    ],
)
def test_an_aircraft_in_flight_goes_around_an_area_that_is_closed_ahead_of_it(mode: str, approval: str) -> None:
    text = scenario(duration=95, more="published_s = 25", approval=approval, corners=AHEAD)
    text = text.replace("[0, 120]", "[0, 220]").replace('end = "land"', f'end = "land", mode = "{mode}"')
    record = fly(load_text(text))
    assert record.outcomes["blue/b1"]["state"] == "complete"
    east, north = (np.array(record.table("truth")[name]) for name in ("east_m", "north_m"))
    assert not ((np.abs(east) < 20.0) & (north > 110.0) & (north < 150.0)).any(), "it stays out of the area"
    assert np.hypot(east[-1], north[-1] - 220.0) < 5.0, "it lands where it wanted to"
    kinds = [row["kind"] for row in record.table("decisions").to_pylist()]
    assert kinds.count("decision.reroute_requested") == kinds.count("decision.rerouted") == 1
    assert "decision.intent_nonconforming" not in kinds, "it stays within the volumes of its new way"


def test_around_a_closed_area_there_are_buildings_too() -> None:
    from skyrange.city.buildings import Building
    from skyrange.city.city import City

    origin = Origin(LAT, LON)
    plan = path(origin, (0.0, 0.0, 0.0), [(0, 0, 20), (0, 200, 20)], kind="guided", end="land")
    closed = closed_around(origin, -20, 20, 80, 120)
    east = City([Building("tower", 60.0, shapely.box(21, 40, 120, 160))], "test")
    rest = reroute(plan, 1, Point(0.0, 20.0, 20.0), [closed], now=0, city=east, margins=WIDE)
    assert min(point.east_m for point in rest.targets_enu_m) < -30.0, "west of the area, not between it and the tower"
    assert rest.targets_enu_m[-1] == Point(0.0, 200.0, 20.0)
    assert (rest.kind, rest.end) == ("guided", "land")
    with pytest.raises(NoRouteError, match="begins"):
        reroute(plan, 1, Point(0.0, 100.0, 20.0), [closed], now=0, city=None, margins=WIDE)
    with pytest.raises(NoRouteError, match="nothing of the plan is left"):
        reroute(plan, 2, Point(0.0, 200.0, 20.0), [closed], now=0, city=None, margins=WIDE)


def closed_around(
    origin: Origin, west: float, east: float, south: float, north: float, start_s: float = 0.0, end_s: float = 3_600.0
) -> Volume4D:
    corners = ((west, south), (east, south), (east, north), (west, north))
    ring = tuple(origin.geodetic_of(*corner) for corner in corners)
    return Volume4D(ring, 0.0, 100.0, round(start_s * NS_PER_S), round(end_s * NS_PER_S))


@pytest.mark.slow
def test_an_aircraft_in_flight_waits_for_an_area_that_is_closed_for_a_short_time() -> None:
    text = scenario(
        duration=200,
        more="published_s = 25\nstart_s = 25\nend_s = 62",
        corners="[[-150, 110], [150, 110], [150, 150], [-150, 150]]",
    )
    record = fly(load_text(text.replace("[0, 120]", "[0, 220]")))
    assert record.outcomes["blue/b1"]["state"] == "complete"
    east, north, time_ns = (np.array(record.table("truth")[name]) for name in ("east_m", "north_m", "time_ns"))
    inside = (np.abs(east) < 150.0) & (north > 110.0) & (north < 150.0)
    assert inside.any(), "it does not go around"
    assert time_ns[inside].min() > 62 * NS_PER_S, "it waits"
    kinds = [row["kind"] for row in record.table("decisions").to_pylist()]
    assert kinds.count("decision.rerouted") == 1
    assert "decision.intent_nonconforming" not in kinds


def test_a_flight_whose_way_is_closed_for_the_whole_run_stays_on_the_ground() -> None:
    record = fly(load_text(scenario(duration=30)))
    assert record.outcomes["blue/b1"]["state"] != "complete"
    assert max(record.table("truth", ["up_m"]).column("up_m").to_pylist()) < 0.5


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"corners": "[[0, 0], [10, 10], [10, 0], [0, 10]]"}, "constraints.0.corners_m"),
        ({"corners": "[[0, 0], [10, 10]]"}, "at least 3"),
        (
            {"more": '[[constraints]]\nid = "fire"\ncorners_m = [[0, 0], [9, 0], [0, 9]]'},
            "fire — expected an id that no other constraint has",
        ),
        ({"more": "lower_m = 50\nupper_m = 50"}, "more than lower_m"),
        ({"more": "start_s = 50\nend_s = 50"}, "more than start_s"),
    ],
)
def test_an_area_without_a_volume_is_an_error(changes: dict[str, Any], expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        build(load_text(scenario(**changes)))
