"""Each rule for approval services is broken by a plugin that breaks just that rule, and is found by its id."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import pytest
from pydantic import Field

from skyrange.contracts.links import LinkSpec
from skyrange.contracts.mailboxes import Inbox, Outbox, Turn
from skyrange.contracts.params import Number, Params
from skyrange.contracts.plugins.registry import NoParams
from skyrange.core.errors import DecodeError
from skyrange.core.ids import Port
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.testing import NonConformance, check_approval
from skyrange.testing.checks.approval_services import SERVICE
from skyrange.utm.approval_service import FlightApproval, policy_plugin
from skyrange.utm.approve_all import APPROVE_ALL, ApproveAll
from skyrange.utm.authority import AUTHORITY
from skyrange.utm.contract import (
    ApprovalContext,
    ApprovalDecision,
    ApprovalPlugin,
    ApprovalService,
    OperationalIntent,
    intent_id,
)
from skyrange.utm.federated.plugin import FEDERATED
from skyrange.utm.hashgraph.plugin import HASHGRAPH
from skyrange.utm.messages import Response, decode_request, encode

pytestmark = pytest.mark.rotating


@dataclass
class Front:
    """Asks a second agent over a link of their own, and passes its word on: the smallest service of two agents."""

    name: str
    ports: Sequence[Port]
    asked: Port
    waiting: list[Port] = field(default_factory=list)
    service_ns: Time = 20 * NS_PER_MS

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        out = Outbox()
        for arrival in inbox:
            if arrival.port == self.asked:
                if self.waiting:
                    out.send(self.waiting.pop(0), arrival.payload, (arrival.ref,))
            else:
                self.waiting.append(arrival.port)
                out.send(self.asked, arrival.port.link.encode() + b" " + arrival.payload, (arrival.ref,))
        return out

    def next_wakeup(self) -> Time | None:
        return None


@dataclass
class Back:
    """Decides for the front."""

    name: str
    ports: Sequence[Port]
    context: ApprovalContext
    service_ns: Time = 20 * NS_PER_MS

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        out = Outbox()
        for arrival in inbox:
            link, _, payload = arrival.payload.partition(b" ")
            try:
                request = decode_request(payload)
            except Exception:
                out.send(arrival.port, encode(Response.error(400, "", "no request")), (arrival.ref,))
                continue
            own = link.decode().partition(":")[2] == request.body.operator
            decision = ApprovalDecision(True, ovn="x") if own else ApprovalDecision(False, "not yours")
            out.send(arrival.port, encode(Response.of(request.body.id, decision, self.context.epoch)), (arrival.ref,))
        return out

    def next_wakeup(self) -> Time | None:
        return None


def two(params: Any, context: ApprovalContext) -> ApprovalService:
    link = LinkSpec("uss:front-back", context.endpoint("front"), context.endpoint("back"))
    asked = Port(link.a, link.name)
    ports = (*(context.port(operator) for operator in context.operators), asked)
    front = Front(f"{context.name}.front", ports, asked)
    return ApprovalService([front, Back(f"{context.name}.back", (Port(link.b, link.name),), context)], [link])


TWO = ApprovalPlugin(NoParams, two, "Two agents decide together.")


def test_what_is_shipped_and_a_service_of_two_agents_conform() -> None:
    check_approval(APPROVE_ALL)
    check_approval(AUTHORITY)
    check_approval(AUTHORITY, {"order": "least_served"})
    check_approval(HASHGRAPH)
    check_approval(FEDERATED)
    check_approval(FEDERATED, {"services": {"both": ["blue", "green"]}})
    check_approval(TWO)


class Silent(Params):
    """A parameter that nothing is said of."""

    apart_m: Number = 3.0


class Told(Params):
    """A parameter that is described."""

    apart_m: Number = Field(default=3.0, description="How far apart, in metres.")


def test_parameters_reach_the_policy() -> None:
    seen = []

    def make(params: Told) -> ApproveAll:
        seen.append(params)
        return ApproveAll()

    check_approval(policy_plugin(Told, make, "Sees."), {"apart_m": 4})
    assert set(map(repr, seen)) == {repr(Told(apart_m=4.0))}


SHARED: list[FlightApproval] = []


def shared(params: Any, context: ApprovalContext) -> ApprovalService:
    SHARED.append(FlightApproval(context.operators, context.epoch, ApproveAll(), name=context.name))
    return ApprovalService(SHARED[:1])


def renamed(params: Any, context: ApprovalContext) -> ApprovalService:
    return two(params, replace(context, name="authority"))


def half(params: Any, context: ApprovalContext) -> ApprovalService:
    return ApprovalService([FlightApproval(context.operators[:1], context.epoch, ApproveAll(), name=context.name)])


def at_large(params: Any, context: ApprovalContext) -> ApprovalService:
    made = two(params, context)
    return replace(made, links=[replace(made.links[0], b="blue.gcs")])


class Trusting(FlightApproval):
    """Takes whoever asks for whoever is named."""

    def _answer(self, turn: Turn, arrival: Any) -> None:
        request = decode_request(arrival.payload)
        decision = ApprovalDecision(True, ovn="x")
        turn.send(arrival.port, encode(Response.of(request.body.id, decision, self._epoch)))


class Mute(FlightApproval):
    def _answer(self, turn: Turn, arrival: Any) -> None:
        """Says nothing."""


class Babble(FlightApproval):
    def _answer(self, turn: Turn, arrival: Any) -> None:
        turn.send(arrival.port, b"yes")


COUNT: list[int] = []


class Numbered(ApproveAll):
    """Counts in one place for all."""

    def decide(self, now: Time, request: OperationalIntent) -> ApprovalDecision:
        COUNT.append(1)
        return ApprovalDecision(True, ovn=f"{len(COUNT)}")


class Forgetful(FlightApproval):
    """Loses its answers when copied, and numbers them."""

    served = 0

    def __deepcopy__(self, memo: object) -> Forgetful:
        return Forgetful([p.link.partition(":")[2] for p in self.ports], self._epoch, ApproveAll(), name=self.name)

    def _answer(self, turn: Turn, arrival: Any) -> None:
        self.served += 1
        body = decode_request(arrival.payload).body
        own = body.operator == arrival.port.link.partition(":")[2]
        decision = ApprovalDecision(True, ovn=f"{self.served}") if own else ApprovalDecision(False, "not yours")
        turn.send(arrival.port, encode(Response.of(body.id, decision, self._epoch)))


def of(agent: Any, policy: Any = ApproveAll) -> Any:
    def make(params: Any, context: ApprovalContext) -> ApprovalService:
        return ApprovalService([agent(context.operators, context.epoch, policy(), name=context.name)])

    return make


def plugin(make: Any, params: type[Params] = NoParams, about: str = "Breaks a rule.") -> ApprovalPlugin:
    return ApprovalPlugin(params, make, about)


def no_service(params: Any, context: ApprovalContext) -> Any:
    return [FlightApproval(context.operators, context.epoch, ApproveAll())]


BREAKING: list[tuple[str, ApprovalPlugin]] = [
    ("described", plugin(two, Silent)),
    ("described", plugin(two, about="approves")),
    ("makes", plugin(shared)),
    ("makes", plugin(no_service)),
    ("named", plugin(renamed)),
    ("ports", plugin(half)),
    ("ports", plugin(at_large)),
    ("answers", plugin(of(Mute))),
    ("answers", plugin(of(Babble))),
    ("owners", plugin(of(Trusting))),
    ("repeatable", plugin(of(FlightApproval, Numbered))),
    ("copies", plugin(of(Forgetful))),
]


@pytest.mark.parametrize(("rule", "broken"), BREAKING, ids=[f"{k}-{rule}" for k, (rule, _) in enumerate(BREAKING)])
def test_a_broken_rule_is_found(rule: str, broken: ApprovalPlugin) -> None:
    with pytest.raises(NonConformance) as found:
        check_approval(broken)
    assert found.value.rule in (f"service.{rule}", "service.makes" if broken.make is no_service else ""), str(
        found.value
    )


def test_every_rule_is_shown_to_fail() -> None:
    assert {f"service.{rule}" for rule, _ in BREAKING} == {rule.id for rule in SERVICE.rules}


def test_the_rules_of_agents_hold_for_each_agent_of_a_service() -> None:
    class Fragile(FlightApproval):
        def _answer(self, turn: Turn, arrival: Any) -> None:
            try:
                decode_request(arrival.payload)
            except DecodeError:
                raise KeyError("what is that?") from None
            super()._answer(turn, arrival)

    with pytest.raises(NonConformance, match=r"agent of approval approval\.checked breaks agent\.") as found:
        check_approval(plugin(of(Fragile)), requests=[(0, _intent("blue/b1")), (NS_PER_S, _intent("green/g1"))])
    assert found.value.rule == "agent.hostile"


def _intent(vehicle: str) -> OperationalIntent:
    from skyrange.testing.checks.approval_policies import box

    return OperationalIntent(intent_id(vehicle), vehicle.split("/", maxsplit=1)[0], vehicle, (box(40.0, -74.0),))
