"""Do the attacks on approvals name what does not fit, and does the one on notifications answer for its victim?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest

from skyrange.attack.contract import Aircraft, AttackContext, AttackPlugin
from skyrange.codec.f3548.frames import UssRequest, UssResponse, decode, encode
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import Schedule
from skyrange.contracts.verdicts import Drop, Inject
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S, Epoch

ECLIPSE = AttackPlugin.find("approval.eclipse")
EQUIVOCATE = AttackPlugin.find("approval.equivocate")
SLOW_GOSSIP = AttackPlugin.find("approval.slow_gossip")
SUPPRESS_NOTIFICATIONS = AttackPlugin.find("approval.suppress_notifications")

GOSSIP = ("uss:blue~green", "uss:blue~red", "uss:green~red")
FEDERATION = ("uss:dss~blue", "uss:dss~green", "uss:blue~green")
CORRIDOR = {"from_m": [0, 0], "to_m": [9, 9]}


def context(links: Sequence[str]) -> AttackContext:
    schedule = Schedule(0, 10 * NS_PER_S)
    vehicles = {name: Aircraft((0.0, 0.0, 0.0), "") for name in ("blue/b1", "green/g1", "red/r1")}
    return AttackContext("x", vehicles, links, Origin(40.0, -74.0), Epoch(0), Chance(3), 10 * NS_PER_S, schedule, False)


@pytest.mark.parametrize(
    ("kind", "params", "links", "words"),
    [
        (ECLIPSE, {"operator": "blue"}, FEDERATION, "an operator whose approval is hashgraph"),
        (ECLIPSE, {"operator": "nobody"}, GOSSIP, "an operator whose approval is hashgraph"),
        (ECLIPSE, {"operator": "blue", "through": ["blue"]}, GOSSIP, "through.0: 'blue' — expected another member"),
        (ECLIPSE, {"operator": "blue", "through": ["green", "red"]}, GOSSIP, "fewer than all other members"),
        (SLOW_GOSSIP, {"operator": "dss"}, FEDERATION, "an operator whose approval is hashgraph"),
        (SLOW_GOSSIP, {"operator": "red", "members": ["bleu"]}, GOSSIP, "Did you mean 'blue'"),
        (EQUIVOCATE, {"operator": "red", **CORRIDOR}, FEDERATION, "an operator whose approval is hashgraph"),
        (SUPPRESS_NOTIFICATIONS, {"uss": "red"}, FEDERATION, "a USS of the scenario"),
        (SUPPRESS_NOTIFICATIONS, {"uss": "blue"}, GOSSIP, 'approval = "federated"'),
    ],
)
def test_what_does_not_fit_is_named(kind: AttackPlugin, params: Any, links: Sequence[str], words: str) -> None:
    with pytest.raises(InputError) as caught:
        kind(kind.params.model_validate(params), context(links))
    assert words in str(caught.value)


def test_members_that_are_let_through_or_told_in_time_have_no_tap() -> None:
    partly = ECLIPSE(ECLIPSE.params.model_validate({"operator": "blue", "through": ["red"]}), context(GOSSIP))
    assert [one.match for one in partly.taps] == ["uss:blue~green"]
    slow = SLOW_GOSSIP(SLOW_GOSSIP.params.model_validate({"operator": "red", "members": ["blue"]}), context(GOSSIP))
    assert [one.match for one in slow.taps] == ["uss:blue~red"]


@pytest.mark.parametrize("sham", [False, True])
def test_a_notification_is_answered_in_the_name_of_who_does_not_get_it(sham: bool) -> None:
    where = replace(context(["uss:blue~green", "uss:dss~blue"]), schedule=Schedule(0, NS_PER_S), sham=sham)
    attack = SUPPRESS_NOTIFICATIONS(SUPPRESS_NOTIFICATIONS.params.model_validate({"uss": "blue"}), where)
    tap = next(one for one in attack.taps if one.match == "uss:blue~green").make("uss:blue~green")

    def pass_frame(method: str, path: str, direction: str = "rev", now: int = 5) -> Any:
        ends = ("approval.blue", "approval.green")
        source, target = ends if direction == "fwd" else ends[::-1]
        request = UssRequest.model_construct(exchange=7, method=method, path=path, token="t", body={})
        return tap.on_frame(
            now, Frame("uss:blue~green", direction, source, 0, source, target, sent_ns=now, payload=encode(request))
        )

    for path in ("/uss/v1/operational_intents", "/uss/v1/constraints"):
        verdicts = pass_frame("POST", path)
        assert [one for one in verdicts if isinstance(one, Drop)] == ([] if sham else [Drop()])
        answer = verdicts[-1]
        assert isinstance(answer, Inject)
        assert (answer.direction, answer.src, answer.dst) == ("fwd", "approval.blue", "approval.green")
        said = decode(answer.payload)
        assert isinstance(said, UssResponse)
        assert (said.exchange, said.status) == (7, 204)
        assert pass_frame("POST", path, "fwd") == (), "what blue tells others passes"
        assert pass_frame("POST", path, now=NS_PER_S) == (), "the attack is over"
    assert pass_frame("GET", "/uss/v1/operational_intents/1") == ()
    assert (
        tap.on_frame(5, Frame("l", "rev", "a", 0, "approval.green", "approval.blue", sent_ns=5, payload=b"\xff")) == ()
    )
