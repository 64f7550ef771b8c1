"""Do USSs that share intents by a DSS keep them apart, and what do they do when one is silent, late or lies?"""

from __future__ import annotations

import copy
import json
import sys
from collections.abc import Callable, Sequence
from typing import Any

import pytest
from uas_standards.astm.f3548.v21.api import UssAvailabilityState

from skyrange.codec.f3548.frames import UssRequest, UssResponse, decode, encode
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.core.ids import APPROVAL
from skyrange.core.time import NS_PER_S, Time
from skyrange.core.volumes import Volume4D
from skyrange.record import MemoryObserver
from skyrange.testing.checks.approval_policies import EPOCH, box
from skyrange.utm.contract import ApprovalContext, ApprovalService, intent_id
from skyrange.utm.federated.dss.service import Dss
from skyrange.utm.federated.dss.store import Availability
from skyrange.utm.federated.plugin import FEDERATED
from skyrange.utm.federated.uss.service import Uss
from skyrange.utm.federated.uss.shared_intents import OwnIntent
from skyrange.utm.intent_states import IntentState
from tests.approval_stations import LAT, LON, Station, ask, decisions, end, fly_requests

SEED = 7
NAMES = ("blue", "green", "red")
Asks = dict[str, Sequence[tuple[float, bytes]]]


def service_of(operators: Sequence[str] = NAMES, **params: Any) -> ApprovalService:
    context = ApprovalContext(f"{APPROVAL}.federated", operators, Origin(LAT, LON), EPOCH, Chance(SEED))
    return FEDERATED(FEDERATED.params.model_validate(params), context)


def flown(
    asks: Asks, until_s: float = 10.0, service: ApprovalService | None = None
) -> tuple[dict[str, Station], MemoryObserver, ApprovalService]:
    service = service or service_of()
    stations, seen = fly_requests(
        {name: asks.get(name, ()) for name in NAMES}, until_s, service.agents, service.links, SEED
    )
    return stations, seen, service


def agents(service: ApprovalService) -> tuple[Dss, dict[str, Uss]]:
    dss, *others = service.agents
    assert isinstance(dss, Dss)
    return dss, {one.uss: one for one in others if isinstance(one, Uss)}


def notes(seen: MemoryObserver, kind: str) -> list[Any]:
    return [note for _, _, note in seen.notes if note.kind == kind]


def here(north: float = 0.0, **more: float) -> Volume4D:
    return box(LAT + north, LON, **{"start_s": 600.0, **more})


# ---------------------------------------------------------------- what it is for


def test_of_two_who_ask_at_once_the_dss_lets_one_in_and_the_other_looks_again_and_offers_an_alternative() -> None:
    stations, seen, _service = flown({name: [(0.1, ask(f"{name}/a"))] for name in ("blue", "green")})
    assert sorted(decisions(stations["blue"]) + decisions(stations["green"])) == ["Accepted", "Rejected"]
    (loser,) = [one for one in stations.values() if decisions(one) == ["Rejected"]]
    _, body = loser.answers[0]
    assert body.alternatives[0].delay_s > 0 or body.alternatives[0].climb_m > 0
    assert body.reason.startswith("volume 1 overlaps a volume of ")
    assert len(notes(seen, "decision.uss_conflict")) == 1
    assert [note.data["missing"] for note in notes(seen, "decision.dss_conflict")] == [1]


def test_the_alternative_is_accepted_when_it_is_asked_for() -> None:
    first, _, _ = flown({"blue": [(0.1, ask("blue/a"))], "green": [(1.0, ask("green/a"))]})
    delay_s = first["green"].answers[0][1].alternatives[0].delay_s
    climb_m = first["green"].answers[0][1].alternatives[0].climb_m
    moved = here(start_s=600.0 + delay_s, lower_m=20.0 + climb_m)
    asks: Asks = {
        "blue": [(0.1, ask("blue/a"))],
        "green": [(1.0, ask("green/a")), (2.0, ask("green/a", moved, version=1))],
    }
    stations, _, _ = flown(asks)
    assert decisions(stations["green"]) == ["Rejected", "Accepted"]


def test_what_has_ended_is_in_nobodys_way_and_what_was_notified_is_not_asked_for() -> None:
    asks: Asks = {
        "blue": [(0.5, ask("blue/a")), (2.0, end("blue/a"))],
        "green": [(0.1, ask("green/b", here(0.002))), (1.0, ask("green/a")), (3.0, ask("green/a", version=1))],
    }
    stations, seen, service = flown(asks)
    assert decisions(stations["blue"]) == ["Accepted", "Ended"]
    assert decisions(stations["green"]) == ["Accepted", "Rejected", "Accepted"]
    dss, _ = agents(service)
    assert dss.store.intent(intent_id("blue/a")) is None
    asked = {one.src for one in seen.frames if b"/uss/v1/operational_intents/" in one.payload}
    assert asked == {"approval.blue"}, "green has a subscription there, and so was told of blue's intent"


def test_a_uss_without_a_subscription_learns_from_the_dss_that_an_intent_has_ended() -> None:
    asks: Asks = {
        "blue": [(0.1, ask("blue/a")), (2.0, end("blue/a"))],
        "red": [(1.0, ask("red/a")), (3.0, ask("red/a", version=1))],
    }
    stations, _, _ = flown(asks)
    assert decisions(stations["red"]) == ["Rejected", "Accepted"]


def test_a_uss_that_joins_later_asks_for_details_once() -> None:
    asks: Asks = {
        "blue": [(0.1, ask("blue/a", here(0.005)))],
        "red": [(1.0, ask("red/a")), (2.0, ask("red/b", here(0.002)))],
    }
    stations, seen, _ = flown(asks)
    assert decisions(stations["red"]) == ["Accepted", "Accepted"]
    assert sum(b"/uss/v1/operational_intents/" in one.payload for one in seen.frames) == 1


def test_states_are_shared_and_off_nominal_ones_need_no_key() -> None:
    states = [IntentState.ACTIVATED, IntentState.NONCONFORMING, IntentState.CONTINGENT]
    wide = here(size_deg=0.003, start_s=0.0)
    rows = [(0.1, ask("blue/a", here(start_s=0.0)))]
    rows += [(1.0 + k, ask("blue/a", wide, state=one, version=k + 1)) for k, one in enumerate(states)]
    asks: Asks = {
        "blue": [*rows, (5.0, end("blue/a"))],
        "green": [
            (0.5, ask("green/a", here(0.002, start_s=10.0))),
            (2.2, ask("green/a", here(0.002, start_s=10.0), state=IntentState.ACTIVATED, version=1)),
        ],
    }
    stations, _, _service = flown(asks)
    assert decisions(stations["blue"]) == ["Accepted", "Rejected", "Accepted", "Accepted", "Ended"]
    assert decisions(stations["green"]) == ["Accepted", "Rejected"], "an aircraft outside its volumes is in the way"


def test_a_higher_priority_takes_airspace_and_the_other_operator_is_told() -> None:
    asks: Asks = {"blue": [(0.1, ask("blue/a"))], "green": [(1.0, ask("green/a", priority=50))]}
    stations, seen, service = flown(asks)
    assert decisions(stations["green"]) == ["Accepted"]
    assert decisions(stations["blue"]) == ["Accepted", "Rejected"]
    assert stations["blue"].answers[1][1].overruled
    dss, _ = agents(service)
    assert dss.store.intent(intent_id("blue/a")) is None
    assert dss.store.intent(intent_id("green/a")) is not None
    (note,) = notes(seen, "decision.approval_overruled")
    assert note.about == "blue/a"


def test_operators_of_one_uss_are_decided_on_by_it_and_share_with_the_rest() -> None:
    service = service_of(services={"north": ["blue", "green"]})
    asks: Asks = {
        "blue": [(0.1, ask("blue/a"))],
        "green": [(0.1, ask("green/a"))],
        "red": [(2.0, ask("red/a"))],
    }
    stations, _, service = flown(asks, service=service)
    assert decisions(stations["blue"]) == ["Accepted"]
    assert decisions(stations["green"]) == decisions(stations["red"]) == ["Rejected"]
    assert sorted(one.name for one in service.agents) == [
        "approval.federated.dss",
        "approval.federated.north",
        "approval.federated.red",
    ]


# ---------------------------------------------------------------- silence, delays and lies


def silence(agent: Any, after_s: float = 0.0) -> None:
    """Make an agent neither hear nor say anything from a time on."""
    step = agent.step

    def quiet(now: Time, inbox: Inbox) -> Outbox:
        return step(now, inbox) if now < after_s * NS_PER_S else Outbox()

    agent.step = quiet


def test_without_the_dss_nothing_is_accepted_and_nothing_is_offered() -> None:
    service = service_of()
    silence(agents(service)[0])
    stations, seen, _ = flown({"blue": [(0.1, ask("blue/a"))]}, 12.0, service)
    assert decisions(stations["blue"]) == ["Rejected"]
    _, body = stations["blue"].answers[0]
    assert body.reason == "dss does not answer queryOperationalIntentReferences"
    assert not body.alternatives
    assert {note.about for note in notes(seen, "decision.uss_failed")} == {"dss", "blue/a"}


@pytest.mark.parametrize(("state", "expected"), [("Unknown", "Rejected"), ("Down", "Accepted")])
def test_a_uss_that_does_not_tell_claims_the_whole_area_unless_it_is_down_before_take_off(
    state: str, expected: str
) -> None:
    service = service_of()
    dss, usss = agents(service)
    silence(usss["blue"], 2.0)
    dss.store.put_availability(Availability("blue", UssAvailabilityState(state), "1"))
    asks: Asks = {"blue": [(0.1, ask("blue/a", here(0.003)))], "red": [(3.0, ask("red/a"))]}
    stations, _, _ = flown(asks, 15.0, service)
    assert decisions(stations["red"]) == [expected]


def test_an_end_is_tried_until_the_dss_is_back() -> None:
    service = service_of()
    dss, _ = agents(service)
    step = dss.step

    def away(now: Time, inbox: Inbox) -> Outbox:
        return Outbox() if 1 * NS_PER_S < now < 9 * NS_PER_S else step(now, inbox)

    dss.step = away  # type: ignore[method-assign]
    stations, _, _ = flown({"blue": [(0.1, ask("blue/a")), (1.5, end("blue/a"))]}, 25.0, service)
    assert decisions(stations["blue"]) == ["Accepted", "Ended"]
    assert dss.store.intent(intent_id("blue/a")) is None


def lose_answers(dss: Dss, words: bytes, until_s: float) -> None:
    """Lose what the DSS sends with `words` in it, until a time."""
    step = dss.step

    def lossy(now: Time, inbox: Inbox) -> Outbox:
        out = step(now, inbox)
        if now < until_s * NS_PER_S:
            out.departures[:] = [one for one in out.departures if words not in one.payload]
        return out

    dss.step = lossy  # type: ignore[method-assign]


def test_an_intent_that_only_the_dss_knows_is_removed() -> None:
    """All answers to a creation are lost: the USS rejects, asks what the DSS has, and removes it."""
    service = service_of()
    dss, usss = agents(service)
    lose_answers(dss, b'"status":201', 9.0)
    asks: Asks = {"blue": [(0.1, ask("blue/a"))], "red": [(9.0, ask("red/a"))]}
    stations, _, _ = flown(asks, 20.0, service)
    assert decisions(stations["blue"]) == ["Rejected"]
    assert decisions(stations["red"]) == ["Accepted"]
    assert dss.store.intent(intent_id("blue/a")) is None
    assert usss["blue"]._intents.own == {}


def test_an_acceptance_whose_answer_was_lost_is_found_again() -> None:
    """The operator asks for the intent once more before the USS could remove it: it keeps it."""
    service = service_of()
    dss, usss = agents(service)
    lose_answers(dss, b'"operational_intent_reference"', 12.9)
    asks: Asks = {"blue": [(0.1, ask("blue/a")), (13.0, ask("blue/a", version=1))]}
    stations, _, _ = flown(asks, 30.0, service)
    assert decisions(stations["blue"]) == ["Rejected", "Accepted"]
    stored = dss.store.intent(intent_id("blue/a"))
    assert stored is not None
    assert stored.reference.version == 2
    assert usss["blue"]._intents.own[intent_id("blue/a")] == stored.reference


class MemoryJournal:
    """What a USS would find in its database: the changes up to the last commit."""

    def __init__(self) -> None:
        self.kept: dict[str, OwnIntent] = {}
        self._open: dict[str, OwnIntent | None] = {}

    def put(self, own: OwnIntent) -> None:
        self._open[own.intent.id] = own

    def delete(self, id_: str) -> None:
        self._open[id_] = None

    def commit(self) -> None:
        for id_, own in self._open.items():
            if own is None:
                self.kept.pop(id_, None)
            else:
                self.kept[id_] = own
        self._open.clear()


def kill(uss: Uss, at_step: int, *, after_commit: bool) -> Callable[[], int]:
    """Replace a USS, while it steps, by one that knows what the journal has; returns a counter of its steps."""
    fresh, journal = copy.deepcopy(uss), MemoryJournal()
    uss._intents._journal = fresh._intents._journal = journal
    count = 0
    step = uss.step

    def interrupted(now: Time, inbox: Inbox) -> Outbox:
        nonlocal count, step
        count += 1
        out = step(now, inbox)
        if count == at_step:
            if after_commit:
                journal.commit()
            for own in journal.kept.values():
                fresh._restore_intent(own)
            step, uss.next_wakeup = fresh.step, fresh.next_wakeup  # type: ignore[method-assign]
            uss._intents = fresh._intents
            return Outbox()
        journal.commit()
        return out

    uss.step = interrupted  # type: ignore[method-assign]
    return lambda: count


@pytest.mark.parametrize("after_commit", [False, True])
def test_a_uss_that_is_killed_at_any_step_leaves_nothing_in_the_dss_that_it_does_not_manage(
    after_commit: bool,
) -> None:
    asks: Asks = {
        "blue": [
            (0.1, ask("blue/a")),
            (0.9, ask("blue/b", here(0.003))),
            (1.7, ask("blue/a", state=IntentState.ACTIVATED, version=1)),
            (2.5, end("blue/b")),
            (6.0, ask("blue/c")),  # overlaps a: the restarted USS has to look
        ],
        "red": [(9.0, ask("red/a", here(0.006)))],
    }
    at_step, steps = 1, 2
    while at_step < steps:
        service = service_of()
        dss, usss = agents(service)
        counter = kill(usss["blue"], at_step, after_commit=after_commit)
        stations, _, _ = flown(asks, 20.0, service)
        steps = counter()
        own = {id_: one for id_, one in usss["blue"]._intents.own.items() if usss["blue"]._intents.get(id_)}
        stored = {one.reference.id: one.reference for one in dss.store.intents if one.reference.manager == "blue"}
        assert set(stored) <= set(own), f"killed at step {at_step}"
        assert decisions(stations["red"]) == ["Accepted"]
        at_step += 1
    assert at_step > 9


def tell(service: ApprovalService, name: str, alter: Callable[[Any], Any]) -> None:
    """Alter what a USS sends to others: `alter` is given the JSON of each frame."""
    uss = agents(service)[1][name]
    step = uss.step

    def lie(now: Time, inbox: Inbox) -> Outbox:
        out = step(now, inbox)
        for number, one in enumerate(out.departures):
            if one.port.link.startswith("uss:"):
                data = alter(json.loads(one.payload))
                out.departures[number] = one._replace(payload=json.dumps(data).encode())
        return out

    uss.step = lie  # type: ignore[method-assign]


def test_a_uss_that_gives_other_details_than_it_has_cannot_make_others_yield_an_intent_of_their_own() -> None:
    """A notification about an intent of another USS changes nothing, and is refused."""
    service = service_of()

    def usurp(data: Any) -> Any:
        body = data.get("body") or {}
        if "operational_intent_id" in body:
            body["operational_intent_id"] = intent_id("green/a")
            body.pop("operational_intent", None)
        return data

    tell(service, "blue", usurp)
    asks: Asks = {
        "green": [(0.1, ask("green/a"))],
        "red": [(0.5, ask("red/b", here(0.002)))],
        "blue": [(1.0, ask("blue/a", here(0.004)))],
    }
    _stations, seen, service = flown(asks, service=service)
    red = agents(service)[1]["red"]
    assert red._intents.get(intent_id("green/a")) is not None
    refused = [note for note in notes(seen, "decision.uss_failed") if "status 403" in str(note.data["reason"])]
    assert refused


def test_a_token_of_another_uss_or_without_the_scope_gives_no_access() -> None:
    service = service_of()

    def forge(data: Any) -> Any:
        if "token" in data:
            header, claims, signature = data["token"].split(".")
            data["token"] = f"{header}.{claims[:-3]}AAA.{signature}"
        return data

    tell(service, "blue", forge)
    stations, _seen, service = flown({"blue": [(0.1, ask("blue/a"))]}, service=service)
    assert decisions(stations["blue"]) == ["Rejected"]
    assert "the token is not valid" in stations["blue"].answers[0][1].reason
    assert agents(service)[0].bad_requests == 1


def test_a_stale_ovn_is_not_accepted_and_the_uss_finds_the_current_one() -> None:
    service = service_of()

    def stale(data: Any) -> Any:
        if data.get("method") == "PUT" and data["path"].count("/") == 5 and not stale.done:  # type: ignore[attr-defined]
            stale.done = True  # type: ignore[attr-defined]
            data["path"] = data["path"].rsplit("/", 1)[0] + "/0123456789abcdef"
        return data

    stale.done = False  # type: ignore[attr-defined]
    tell(service, "blue", stale)
    asks: Asks = {
        "blue": [
            (0.1, ask("blue/a", here(start_s=0.0))),
            (1.0, ask("blue/a", here(start_s=0.0), state=IntentState.ACTIVATED, version=1)),
        ]
    }
    stations, seen, _ = flown(asks, service=service)
    assert stale.done  # type: ignore[attr-defined]
    assert decisions(stations["blue"]) == ["Accepted", "Accepted"]
    assert [note.data["missing"] for note in notes(seen, "decision.uss_conflict")] == [0]


def test_an_intent_that_the_dss_has_lost_is_made_anew_when_it_is_activated() -> None:
    service = service_of()
    dss, _ = agents(service)
    step = dss.step

    def forget(now: Time, inbox: Inbox) -> Outbox:
        if 1 * NS_PER_S < now < 2 * NS_PER_S:
            dss.store.delete_intent(intent_id("blue/a"))
        return step(now, inbox)

    dss.step = forget  # type: ignore[method-assign]
    now = here(start_s=0.0)
    asks: Asks = {
        "blue": [
            (0.1, ask("blue/a", now)),
            (3.0, ask("blue/a", now, state=IntentState.ACTIVATED, version=1)),
        ],
        "red": [(1.5, ask("red/b", here(0.002)))],
    }
    stations, _, _ = flown(asks, service=service)
    assert decisions(stations["blue"]) == ["Accepted", "Accepted"]
    stored = dss.store.intent(intent_id("blue/a"))
    assert stored is not None
    assert (stored.reference.state.value, stored.reference.version) == ("Activated", 2)


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"{",
        b"[]",
        b'{"exchange":-1,"status":200}',
        b'{"exchange":1,"method":"PATCH","path":"/"}',
        b'{"exchange":1,"method":"GET","path":"/nowhere"}',
        b'{"exchange":1,"status":200,"body":{}}',
        b"[" * 100_000,
        b'{"exchange":1,"method":"POST","path":"/dss/v1/operational_intent_references/query","token":"' + b"x" * 9000,
    ],
)
def test_hostile_bytes_are_counted_and_change_nothing(payload: bytes) -> None:
    service = service_of()
    dss, usss = agents(service)
    step = usss["blue"].step

    def attack(now: Time, inbox: Inbox) -> Outbox:
        out = step(now, inbox)
        if out.departures:
            for port in usss["blue"].ports[1:]:
                out.send(port, payload)
        return out

    usss["blue"].step = attack  # type: ignore[method-assign]
    stations, _, _ = flown({"blue": [(0.1, ask("blue/a"))], "red": [(2.0, ask("red/a", here(0.002)))]}, 5.0, service)
    assert dss.bad_requests > 0
    assert decisions(stations["blue"]) == decisions(stations["red"]) == ["Accepted"]


def test_frames_come_back_as_they_were() -> None:
    for frame in (
        UssRequest(exchange=3, method="GET", path="/uss/v1/reports", token="t"),
        UssResponse(exchange=3, status=204),
        UssResponse(exchange=4, status=200, body={"a": [1.5, "x"]}),
    ):
        assert decode(encode(frame)) == frame


@pytest.mark.parametrize(
    ("services", "words"),
    [
        ({"north": ["bleu"]}, r"services\.north: 'bleu' — expected an operator with this approval"),
        ({"north": ["blue"], "south": ["blue"]}, r"services\.south: 'blue' — expected an operator that no other USS"),
        ({"dss": ["blue"]}, r"services\.dss: 'dss' — expected a name of letters"),
        ({"north": []}, r"services\.north: \[\] — expected at least one operator"),
        ({"green": ["blue"]}, r"services: none — expected a USS for operator 'green'"),
    ],
)
def test_services_that_make_no_sense_are_named(services: Any, words: str) -> None:
    with pytest.raises(InputError, match=words):
        service_of(services=services)


def test_without_its_packages_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "s2sphere", None)
    with pytest.raises(InputError, match=r"s2sphere: not installed.*skyrange\[utm\]"):
        service_of()
