"""Requests that would harm others, or the approval: each approval refuses or survives them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from uas_standards.astm.f3548.v21.api import OperationalIntentState as State
from uas_standards.astm.f3548.v21.api import OperationID as Op
from uas_standards.astm.f3548.v21.constants import Scope

from skyrange.codec.f3548.frames import UssRequest
from skyrange.codec.f3548.frames import decode as decode_frame
from skyrange.codec.f3548.frames import encode as encode_frame
from skyrange.codec.f3548.operations import path_of
from skyrange.codec.f3548.values import IntentDetails, IntentReference, moment_body, volume_body
from skyrange.contracts.mailboxes import Arrival, Inbox
from skyrange.core.chance import Chance
from skyrange.core.errors import DecodeError
from skyrange.core.geodesy import Origin
from skyrange.core.ids import APPROVAL, FrameId
from skyrange.core.time import NS_PER_S
from skyrange.scenario.toml_files import load_text
from skyrange.study.runs import fly
from skyrange.testing.checks.approval_policies import EPOCH, box
from skyrange.utm.contract import ApprovalContext, ApprovalPlugin, intent_id, make_uuid
from skyrange.utm.federated.plugin import _secret
from skyrange.utm.federated.tokens import TokenStore
from skyrange.utm.federated.uss.service import Uss
from skyrange.utm.federated.uss.shared_intents import OwnIntent
from skyrange.utm.hashgraph.events import NO_PARENT, Event, secret_of, sign
from skyrange.utm.hashgraph.messages import EventMessage, Gossip, GossipBody
from skyrange.utm.hashgraph.messages import encode as encode_gossip
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
duration_s = 35
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


SLOW = [pytest.param(published_s, marks=pytest.mark.slow) for published_s in (17.0, 18.0, 19.0, 19.5)]


@pytest.mark.parametrize("published_s", [10.0, 18.5, 20.0, *SLOW])
def test_an_aircraft_does_not_take_off_into_an_area_that_is_closed(published_s: float, tmp_path: Path) -> None:
    scenario = load_text(SCENARIO.replace("PUBLISHED", str(published_s)))
    run = fly(scenario, tmp_path / "run", report=False)
    outcome = run.manifest["outcomes"]["blue/b1"]
    assert outcome["state"] == "failed"
    assert "approval" in outcome["reason"]


def test_a_notification_of_a_constraint_does_not_replace_an_intent() -> None:
    plugin = ApprovalPlugin.find("federated")
    context = ApprovalContext(f"{APPROVAL}.federated", NAMES, Origin(LAT, LON), EPOCH, Chance(3))
    agents = plugin(plugin.params(), context).agents
    (uss,) = [agent for agent in agents if isinstance(agent, Uss) and agent.name.endswith("blue")]
    own = intent("blue/b1", box(LAT, LON))
    elsewhere = box(LAT + 1.0, LON)
    body = {
        "id": own.id,
        "manager": "blue",
        "version": 1,
        "ovn": "x" * 16,
        "uss_availability": "Unknown",
        "time_start": moment_body(elsewhere.start_ns, EPOCH),
        "time_end": moment_body(elsewhere.end_ns, EPOCH),
        "uss_base_url": "https://uss.example",
        "state": "Accepted",
        "subscription_id": make_uuid("subscription"),
    }
    uss._intents.restore(OwnIntent(own, IntentReference.of(body, EPOCH)))
    volumes = [volume_body(elsewhere, EPOCH)]
    constraint = {"reference": {**body, "manager": "green"}, "details": {"volumes": volumes, "type": "fire"}}
    method, path = path_of(Op.NotifyConstraintDetailsChanged)
    token = TokenStore("green", _secret(context, "authorization"), EPOCH).get(
        NS_PER_S, "blue", Scope.ConstraintManagement.value
    )
    (port,) = [port for port in uss.ports if "green" in port.link]
    notification = {"constraint_id": own.id, "constraint": constraint, "subscriptions": []}
    frame = UssRequest(exchange=1, method=method, path=path, token=token, body=notification)  # type: ignore[arg-type]
    arrival = Arrival(port, NS_PER_S, encode_frame(frame), "green", FrameId(port.link, "up", "green", 1))
    (answer,) = uss.step(NS_PER_S, Inbox([arrival])).departures
    assert decode_frame(answer.payload).status == 403  # type: ignore[union-attr]
    assert uss.own_intents == [own]
    other = IntentReference.of({**body, "id": make_uuid("other"), "manager": "green", "state": State.Accepted}, EPOCH)
    uss._intents.store_intent(other, IntentDetails((elsewhere,), (), 0))
    constraint["reference"] = {**body, "id": other.id, "manager": "green", "version": 2}
    notification = {**notification, "constraint_id": other.id}
    frame = frame.model_copy(update={"exchange": 2, "body": notification})
    arrival = arrival._replace(payload=encode_frame(frame))
    (answer,) = uss.step(NS_PER_S, Inbox([arrival])).departures
    assert decode_frame(answer.payload).status == 403, "nor one of another USS, by its own manager"  # type: ignore[union-attr]


def test_forks_of_a_member_do_not_stop_the_others() -> None:
    """More heads than a message may name."""
    plugin = ApprovalPlugin.find("hashgraph")
    context = ApprovalContext(f"{APPROVAL}.hashgraph", NAMES, Origin(LAT, LON), EPOCH, Chance(3))
    service = plugin(plugin.params(), context)
    (node,) = [agent for agent in service.agents if agent.name.endswith("blue")]
    secret = secret_of(context.chance.seed, "green")
    first = {name: Event(name, NO_PARENT, NO_PARENT, 0) for name in NAMES}
    forks = [sign(Event("green", first["green"].hash, first["blue"].hash, i, ()), secret) for i in range(1_100)]
    gossip = Gossip(method="POST", body=GossipBody(events=tuple(EventMessage.of(event) for event in forks)))
    (port,) = [port for port in node.ports if "green" in port.link]
    node.step(
        NS_PER_S, Inbox([Arrival(port, NS_PER_S, encode_gossip(gossip), "green", FrameId(port.link, "up", "", 1))])
    )
    (asks,) = [port for port in node.ports if port.link.startswith(APPROVAL)]
    request = Arrival(asks, 2 * NS_PER_S, ask("blue/b1", box(LAT, LON)), "blue", FrameId(asks.link, "up", "", 2))
    assert node.step(2 * NS_PER_S, Inbox([request])).departures, "it gossips about the request"
