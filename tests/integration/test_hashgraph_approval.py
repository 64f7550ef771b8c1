"""Do the nodes of a hashgraph decide alike, on time, and in spite of one that equivocates or is silent?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pytest

from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.core.ids import APPROVAL
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.record import MemoryObserver
from skyrange.testing.checks.approval_policies import EPOCH, box
from skyrange.utm.contract import ApprovalContext, ApprovalService, OperationalIntent, intent_id
from skyrange.utm.hashgraph import node
from skyrange.utm.hashgraph.events import Event, secret_of, sign
from skyrange.utm.hashgraph.messages import EventMessage, Gossip, GossipBody, decode, encode
from skyrange.utm.hashgraph.node import HashgraphNode
from skyrange.utm.hashgraph.plugin import HASHGRAPH
from skyrange.utm.messages import Request
from skyrange.utm.messages import encode as encode_request
from tests.approval_stations import LAT, LON, Station, ask, decisions, fly_requests

SEED = 7


def service_of(operators: Sequence[str], **params: Any) -> ApprovalService:
    context = ApprovalContext(f"{APPROVAL}.hashgraph", operators, Origin(LAT, LON), EPOCH, Chance(SEED))
    return HASHGRAPH(HASHGRAPH.params.model_validate(params), context)


def flown(
    asks: Mapping[str, Sequence[tuple[float, bytes]]],
    until_s: float,
    agents: Sequence[Any] | None = None,
    service: ApprovalService | None = None,
) -> tuple[dict[str, Station], MemoryObserver, ApprovalService]:
    service = service or service_of(list(asks))
    stations, seen = fly_requests(asks, until_s, [*(agents or service.agents)], service.links, SEED)
    return stations, seen, service


NAMES = ("blue", "green", "orange", "red")


def held(service: ApprovalService) -> list[dict[str, Any]]:
    return [dict(node._authority._register._intents) for node in service.agents]  # type: ignore[attr-defined]


def test_of_two_who_ask_at_once_one_is_accepted_by_all_and_the_other_gets_an_alternative() -> None:
    stations, seen, service = flown(
        {name: [(0.1, ask(f"{name}/a"))] if name in ("blue", "red") else [] for name in NAMES}, 10.0
    )
    outcomes = sorted(decisions(stations["blue"]) + decisions(stations["red"]))
    assert outcomes == ["Accepted", "Rejected"]
    loser = next(station for station in stations.values() if decisions(station) == ["Rejected"])
    assert loser.answers[0][1].alternatives
    states = held(service)
    assert all(state == states[0] for state in states)
    assert len(states[0]) == 1
    after_s = [note.data["after_s"] for _, _, note in seen.notes if note.kind == "decision.consensus"]
    assert len(after_s) == 2
    assert max(after_s) < 2.0  # type: ignore[type-var, operator]


def test_a_silent_airspace_costs_nothing() -> None:
    _, seen, _ = flown(
        {name: [(0.1, ask(f"{name}/a", box(LAT + 0.01 * k, LON)))] for k, name in enumerate(NAMES)}, 60.0
    )
    last_s = max(frame.sent_ns for frame in seen.frames) / NS_PER_S
    assert last_s < 10.0


def test_gossip_carries_what_is_new_and_not_the_history() -> None:
    asks = {
        name: [(4.0 * k, ask(f"{name}/{k}", box(LAT + 0.01 * place, LON + 0.002 * k))) for k in range(12)]
        for place, name in enumerate(NAMES)
    }
    _, seen, service = flown(asks, 60.0)
    messages = [decode(frame.payload) for frame in seen.frames if frame.link.startswith("uss:")]
    sent = sum(len(message.body.events) for message in messages)
    events = len(service.agents[0]._graph)  # type: ignore[attr-defined]
    assert events > 200
    assert sent <= 2 * events * (len(NAMES) - 1), "each event reaches each other member once, and little is sent twice"
    assert max(len(message.body.events) for message in messages) < events // 4


@pytest.mark.parametrize(("resent_ns", "expected"), [(node.RESENT_NS, ["Accepted"]), (10**18, [])])
def test_what_was_lost_is_sent_again(resent_ns: Time, expected: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Of two members each has to hear of all that the other knows; without sending again, nothing is ever decided."""
    monkeypatch.setattr(node, "RESENT_NS", resent_ns)
    service = service_of(("blue", "red"))
    (deaf,) = [one for one in service.agents if isinstance(one, HashgraphNode) and one.operator == "red"]
    step = deaf.step

    def lose(now: Time, inbox: Inbox) -> Outbox:
        is_lost = NS_PER_S // 10 < now < NS_PER_S // 2
        heard = [one for one in inbox if not (is_lost and b'"POST"' in one.payload)]
        return step(now, Inbox(heard))

    deaf.step = lose  # type: ignore[method-assign]
    stations, _, _ = flown({"blue": [(0.1, ask("blue/a"))], "red": []}, 8.0, service=service)
    assert decisions(stations["blue"]) == expected


def test_a_request_that_comes_again_while_it_is_undecided_is_answered_once() -> None:
    again = ask("blue/a")
    stations, _, _ = flown({name: [(0.1, again), (0.3, again)] if name == "blue" else [] for name in NAMES}, 10.0)
    assert decisions(stations["blue"]) == ["Accepted"]


class Equivocator(HashgraphNode):
    """A node that tells half of the others of one event, and half of another one with the same self-parent."""

    def double(self, now: Time, payloads: Sequence[bytes]) -> None:
        mine, other = self._graph.latest(self.operator), self._graph.latest("green")
        assert mine is not None
        assert other is not None
        self.twins = [
            sign(Event(self.operator, mine.hash, other.hash, now, (payload,)), secret_of(SEED, self.operator))
            for payload in payloads
        ]

    def _lie(self, out: Outbox) -> None:
        for number, port in enumerate(self._peers.values()):
            event = EventMessage.of(self.twins[number % 2])
            out.send(port, encode(Gossip(method="POST", body=GossipBody(events=(event,)))))

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        if not hasattr(self, "twins"):
            claims = [box(LAT, LON, start_s=600.0), box(LAT + 0.0002, LON, start_s=600.0)]
            self.double(now, [ask(f"{self.operator}/{k}", claim) for k, claim in enumerate(claims)])
            out = Outbox()
            self._lie(out)
            return out
        return super().step(now, inbox)

    def next_wakeup(self) -> Time | None:
        return 100 * NS_PER_MS if not hasattr(self, "twins") else super().next_wakeup()


def test_one_that_equivocates_is_found_and_cannot_book_a_corridor_twice() -> None:
    service = service_of(NAMES)
    agents: list[Any] = list(service.agents)
    agents[3].__class__ = Equivocator  # the node of red
    asks: dict[str, Sequence[tuple[float, bytes]]] = {name: [] for name in NAMES}
    asks["blue"] = [(1.0, ask("blue/a", box(LAT + 0.05, LON, start_s=600.0)))]
    stations, seen, _ = flown(asks, 30.0, agents, service)
    assert decisions(stations["blue"]) == ["Accepted"]
    states = held(service)[:3]
    assert all(state == states[0] for state in states)
    red = [intent for intent in states[0].values() if intent.operator == "red"]
    assert len(red) <= 1
    found = {(by, note.about) for _, by, note in seen.notes if note.kind == "decision.fork_found"}
    assert found >= {(f"approval.hashgraph.{name}", "red") for name in NAMES[:3]}


def test_without_two_thirds_nothing_is_decided_and_with_them_it_is() -> None:
    class Silent(HashgraphNode):
        def step(self, now: Time, inbox: Inbox) -> Outbox:
            return Outbox()

        def next_wakeup(self) -> Time | None:
            return None

    for silent, expected in ((1, ["Accepted"]), (2, [])):
        service = service_of(NAMES)
        agents: list[Any] = list(service.agents)
        for one in agents[4 - silent :]:
            one.__class__ = Silent
        asks: dict[str, Sequence[tuple[float, bytes]]] = {name: [] for name in NAMES}
        asks["blue"] = [(0.1, ask("blue/a"))]
        stations, _, _ = flown(asks, 15.0, agents, service)
        assert decisions(stations["blue"]) == expected


INTENT = OperationalIntent(intent_id("blue/a"), "red", "red/r", ())


@pytest.mark.parametrize("forged", [ask("green/g"), encode_request(Request.end(INTENT))], ids=["asks", "ends"])
def test_what_a_member_says_about_the_intents_of_another_changes_nothing(forged: bytes) -> None:
    service = service_of(NAMES)

    class Forger(HashgraphNode):
        """Says so in each of its events, also after the intent was accepted."""

        def _create_event(self, now: Time, peer: str) -> None:
            mine, other = self._graph.latest(self.operator), self._graph.latest(peer)
            assert mine is not None
            assert other is not None
            event = sign(Event(self.operator, mine.hash, other.hash, now, (forged,)), self._secret)
            self._graph.add(event)

    agents: list[Any] = list(service.agents)
    agents[3].__class__ = Forger
    asks: dict[str, Sequence[tuple[float, bytes]]] = {name: [] for name in NAMES}
    asks["blue"] = [(0.1, ask("blue/a", box(LAT + 0.05, LON, start_s=600.0)))]
    stations, _, _ = flown(asks, 10.0, agents, service)
    assert decisions(stations["blue"]) == ["Accepted"]
    applied = [forged in one.event.transactions for one in agents[0]._graph.ordered]
    assert any(applied[-len(applied) // 2 :]), "it is ordered, and late as well"
    for state in held(service)[:3]:
        assert [intent.vehicle for intent in state.values()] == ["blue/a"]


@pytest.mark.parametrize(
    ("stakes", "words"),
    [
        ({"bleu": 3}, "stakes.bleu: 3 — expected an operator with this approval"),
        (dict.fromkeys(NAMES, 0), "stakes: 0 in all"),
    ],
)
def test_stakes_that_make_no_sense_are_named(stakes: dict[str, int], words: str) -> None:
    with pytest.raises(InputError, match=words):
        service_of(NAMES, stakes=stakes)


def test_an_operator_alone_needs_no_consensus() -> None:
    stations, _, service = flown({"blue": [(0.1, ask("blue/a"))]}, 2.0, service=service_of(["blue"]))
    assert decisions(stations["blue"]) == ["Accepted"]
    assert service.links == ()
