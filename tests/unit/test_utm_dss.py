"""The DSS of a federation by itself: its operations, what it refuses, and who may ask."""

from __future__ import annotations

import base64
import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from uas_standards.astm.f3548.v21.api import OperationID as Op
from uas_standards.astm.f3548.v21.constants import Scope

from skyrange.codec.f3548.frames import UssRequest, UssResponse, decode, encode
from skyrange.codec.f3548.operations import check_response, path_of
from skyrange.codec.f3548.values import NO_SUBSCRIPTION, Area, volume_body
from skyrange.contracts.mailboxes import Arrival, Inbox
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import NS_PER_S, Time
from skyrange.core.volumes import Volume4D
from skyrange.testing.checks.approval_policies import EPOCH, box
from skyrange.utm.airspace.claimed_airspace import Airspace
from skyrange.utm.contract import make_uuid
from skyrange.utm.federated.dss.coverings import extent_of
from skyrange.utm.federated.dss.service import Dss
from skyrange.utm.federated.tokens import LIFETIME_S, TokenChecker, TokenError, TokenStore, public_of

SECRET = bytes(range(32))
LAT, LON = 40.778, -73.955
COORDINATION = Scope.StrategicCoordination.value
MONITORING = Scope.ConformanceMonitoringForSituationalAwareness.value
ARBITRATION = Scope.AvailabilityArbitration.value
INTENT, OTHER, SUBSCRIPTION = (make_uuid(name) for name in ("intent", "other", "subscription"))


class Ask:
    """Asks a DSS in the name of USSs."""

    def __init__(self) -> None:
        self.port = Port("approval.dss", "uss:dss~any")
        self.dss = Dss(
            "dss", [self.port], TokenChecker(frozenset({"dss"}), (public_of(SECRET),), EPOCH), b"secret", EPOCH
        )
        self.count = 0

    def __call__(
        self,
        uss: str,
        operation: Op,
        body: Any = None,
        *,
        scope: str = COORDINATION,
        now_s: float = 0,
        **parameters: str,
    ) -> tuple[int, dict[str, Any]]:
        self.count += 1
        now: Time = 0
        method, path = path_of(operation, **parameters)
        token = TokenStore(uss, SECRET, EPOCH).get(now, "dss", *scope.split())
        frame = encode(UssRequest(exchange=self.count, method=method, path=path, token=token, body=body))  # type: ignore[arg-type]
        ref = FrameId(self.port.link, "rev", uss, self.count)
        out = self.dss.step(now, Inbox([Arrival(self.port, now, frame, f"approval.{uss}", ref)]))
        (departure,) = out.departures
        answer = decode(departure.payload)
        assert isinstance(answer, UssResponse)
        assert answer.exchange == self.count
        if answer.status < 400:
            check_response(operation, answer.status, answer.body)  # the types of the standard's package
        return answer.status, answer.body or {}


def claim(*volumes: Volume4D, state: str = "Accepted", key: tuple[str, ...] = (), **more: Any) -> dict[str, Any]:
    extents = [volume_body(one, EPOCH) for one in volumes or (here(),)]
    return {"extents": extents, "state": state, "key": list(key), "uss_base_url": "https://blue", **more}


def here(**more: float) -> Volume4D:
    return box(LAT, LON, **{"start_s": 600.0, **more})


NEW: dict[str, Any] = {"new_subscription": {"uss_base_url": "https://blue"}}


def create(ask: Ask, uss: str = "blue", id_: str = INTENT, **more: Any) -> dict[str, Any]:
    status, body = ask(uss, Op.CreateOperationalIntentReference, claim(**more), entityid=id_)
    assert status == 201, body
    return dict(body["operational_intent_reference"])


def test_an_intent_is_created_read_updated_and_deleted_by_its_manager_alone() -> None:
    ask = Ask()
    first = create(ask, **NEW)
    assert (first["version"], first["manager"], first["state"]) == (1, "blue", "Accepted")
    assert ask("blue", Op.GetOperationalIntentReference, entityid=INTENT)[1]["operational_intent_reference"] == first
    hidden = ask("red", Op.GetOperationalIntentReference, entityid=INTENT)[1]["operational_intent_reference"]
    assert hidden == {**first, "ovn": "Available from USS"}
    where = {"entityid": INTENT, "ovn": first["ovn"]}
    assert ask("red", Op.UpdateOperationalIntentReference, claim(), **where)[0] == 403
    assert ask("red", Op.DeleteOperationalIntentReference, **where)[0] == 403
    assert ask("blue", Op.CreateOperationalIntentReference, claim(), entityid=INTENT)[0] == 409
    assert ask("blue", Op.UpdateOperationalIntentReference, claim(), entityid=INTENT, ovn="stale")[0] == 409
    status, body = ask("blue", Op.UpdateOperationalIntentReference, claim(state="Activated", **NEW), **where)
    second = body["operational_intent_reference"]
    assert (status, second["version"], second["state"]) == (200, 2, "Activated")
    assert second["ovn"] != first["ovn"]
    assert second["subscription_id"] != first["subscription_id"]
    assert ask("blue", Op.GetSubscription, subscriptionid=first["subscription_id"])[0] == 404, "nobody has it any more"
    assert ask("blue", Op.DeleteOperationalIntentReference, entityid=INTENT, ovn=first["ovn"])[0] == 409
    assert ask("blue", Op.DeleteOperationalIntentReference, entityid=INTENT, ovn=second["ovn"])[0] == 200
    assert ask("blue", Op.GetOperationalIntentReference, entityid=INTENT)[0] == 404
    assert ask("blue", Op.GetSubscription, subscriptionid=second["subscription_id"])[0] == 404


def test_the_key_has_to_have_the_ovn_of_everything_that_may_be_there() -> None:
    ask = Ask()
    first = create(ask)
    status, body = ask("red", Op.CreateOperationalIntentReference, claim(), entityid=OTHER)
    assert status == 409
    (missing,) = body["missing_operational_intents"]
    assert (missing["id"], missing["ovn"]) == (INTENT, "Available from USS")
    assert ask("red", Op.CreateOperationalIntentReference, claim(key=(first["ovn"],)), entityid=OTHER)[0] == 201
    apart = [here(lower_m=70.0), here(start_s=900.0), box(LAT + 0.2, LON, start_s=600.0)]
    for number, volume in enumerate(apart):
        assert ask("red", Op.CreateOperationalIntentReference, claim(volume), entityid=make_uuid(f"{number}"))[0] == 201


@pytest.mark.parametrize(
    ("body", "scope", "status"),
    [
        (claim(state="Activated", **NEW), COORDINATION, 400),
        (claim(state="Accepted"), MONITORING, 403),
        ({**claim(), "extents": []}, COORDINATION, 400),
        (claim(here(start_s=-900.0)), COORDINATION, 400),
        (claim(subscription_id=SUBSCRIPTION), COORDINATION, 400),
        ({"state": "Accepted"}, COORDINATION, 400),
        (claim(box(LAT, LON, size_deg=2.0, start_s=600.0)), COORDINATION, 413),
    ],
)
def test_what_is_wrong_with_a_first_version_changes_nothing(body: Any, scope: str, status: int) -> None:
    ask = Ask()
    assert ask("blue", Op.CreateOperationalIntentReference, body, scope=scope, entityid=INTENT)[0] == status
    assert ask("blue", Op.GetOperationalIntentReference, entityid=INTENT)[0] == 404


def subscribe(volume: Volume4D, **more: Any) -> dict[str, Any]:
    return {
        "extents": volume_body(volume, EPOCH),
        "uss_base_url": "https://green",
        "notify_for_operational_intents": True,
        **more,
    }


def test_who_has_a_subscription_is_told_and_counts_what_it_is_told() -> None:
    ask = Ask()
    status, body = ask("green", Op.CreateSubscription, subscribe(here()), subscriptionid=SUBSCRIPTION)
    assert (status, body["subscription"]["notification_index"]) == (200, 0)

    def told(body: dict[str, Any]) -> list[int]:
        ((green, states),) = [(one["uss_base_url"], one["subscriptions"]) for one in body["subscribers"]]
        assert green == "https://green"
        return [one["notification_index"] for one in states if one["subscription_id"] == SUBSCRIPTION]

    _, body = ask("blue", Op.CreateOperationalIntentReference, claim(), entityid=INTENT)
    assert told(body) == [1]
    ovn = body["operational_intent_reference"]["ovn"]
    assert told(ask("blue", Op.DeleteOperationalIntentReference, entityid=INTENT, ovn=ovn)[1]) == [2]
    _, body = ask("blue", Op.CreateOperationalIntentReference, claim(here(lower_m=200.0)), entityid=OTHER)
    assert body["subscribers"] == [], "it is above what the subscription is for"
    assert ask("blue", Op.GetSubscription, subscriptionid=SUBSCRIPTION)[0] == 403
    area = {"area_of_interest": volume_body(here(), EPOCH)}
    assert len(ask("green", Op.QuerySubscriptions, area)[1]["subscriptions"]) == 1
    assert ask("blue", Op.QuerySubscriptions, area)[1]["subscriptions"] == []


def test_a_subscription_has_versions_and_stays_while_an_intent_has_it() -> None:
    ask = Ask()
    body = ask("blue", Op.CreateSubscription, subscribe(here()), subscriptionid=SUBSCRIPTION)[1]
    version = body["subscription"]["version"]
    assert ask("blue", Op.CreateSubscription, subscribe(here()), subscriptionid=SUBSCRIPTION)[0] == 409
    create(ask, subscription_id=SUBSCRIPTION)
    where = {"subscriptionid": SUBSCRIPTION, "version": version}
    found = ask("blue", Op.GetSubscription, subscriptionid=SUBSCRIPTION)[1]["subscription"]
    assert found["dependent_operational_intents"] == [INTENT]
    assert ask("blue", Op.DeleteSubscription, **where)[0] == 400
    updated = ask("blue", Op.UpdateSubscription, subscribe(here()), **where)[1]
    assert [one["id"] for one in updated["operational_intent_references"]] == [INTENT]
    assert ask("blue", Op.UpdateSubscription, subscribe(here()), **where)[0] == 409
    high = claim(here(lower_m=300.0), subscription_id=SUBSCRIPTION)
    assert ask("blue", Op.CreateOperationalIntentReference, high, entityid=OTHER)[0] == 400, "it does not cover that"
    neither = subscribe(here(), notify_for_operational_intents=False)
    assert ask("blue", Op.CreateSubscription, neither, subscriptionid=make_uuid("x"))[0] == 400


def test_an_intent_without_a_subscription_has_the_one_that_stands_for_none() -> None:
    ask = Ask()
    first = create(ask)
    assert first["subscription_id"] == NO_SUBSCRIPTION
    where = {"entityid": INTENT, "ovn": first["ovn"]}
    assert ask("blue", Op.UpdateOperationalIntentReference, claim(state="Activated"), **where)[0] == 400


def test_an_intent_of_a_uss_that_is_down_needs_no_key_before_take_off() -> None:
    ask = Ask()
    create(ask)
    state = {"old_version": "", "availability": "Down"}
    assert ask("red", Op.SetUssAvailability, state, uss_id="blue")[0] == 403
    status, body = ask("red", Op.SetUssAvailability, state, scope=ARBITRATION, uss_id="blue")
    assert (status, body["status"]) == (200, {"uss": "blue", "availability": "Down"})
    assert ask("red", Op.SetUssAvailability, state, scope=ARBITRATION, uss_id="blue")[0] == 409
    assert ask("red", Op.GetUssAvailability, uss_id="blue")[1] == body
    assert ask("red", Op.CreateOperationalIntentReference, claim(), entityid=OTHER)[0] == 201


def test_a_report_gets_an_id() -> None:
    moment = {"value": "2026-01-01T12:00:00Z", "format": "RFC3339"}
    exchange = {
        "url": "https://x",
        "method": "GET",
        "recorder_role": "Client",
        "request_time": moment,
        "problem": "slow",
    }
    status, body = Ask()("blue", Op.MakeDssReport, {"report_id": None, "exchange": exchange})
    assert status == 201
    assert len(body["report_id"]) == 36


def test_a_token_is_for_one_receiver_one_issuer_and_an_hour() -> None:
    store = TokenStore("blue", SECRET, EPOCH)
    token = store.get(0, "dss", COORDINATION)
    checker = TokenChecker(frozenset({"dss"}), (public_of(SECRET),), EPOCH)
    assert checker.check(0, token).uss == "blue"
    assert checker.check(0, token).scopes == {COORDINATION}
    assert store.get(NS_PER_S, "dss", COORDINATION) == token
    with pytest.raises(TokenError, match="expired"):
        checker.check(LIFETIME_S * NS_PER_S, token)
    renewed = store.get((LIFETIME_S - 1) * NS_PER_S, "dss", COORDINATION)
    assert checker.check(LIFETIME_S * NS_PER_S, renewed).uss == "blue"
    with pytest.raises(TokenError, match="another receiver than red"):
        TokenChecker(frozenset({"red"}), (public_of(SECRET),), EPOCH).check(0, token)
    with pytest.raises(TokenError, match="not valid"):
        TokenChecker(frozenset({"dss"}), (public_of(bytes(32)),), EPOCH).check(0, token)
    header, claims, signature = token.split(".")
    said = json.loads(base64.urlsafe_b64decode(claims + "=="))
    forged = base64.urlsafe_b64encode(json.dumps({**said, "sub": "red"}).encode()).decode().rstrip("=")
    for wrong in ("", "x", "a.b.c", f"{header}.{forged}.{signature}"):
        with pytest.raises(TokenError):
            checker.check(0, wrong)


def test_without_the_scope_there_is_no_access() -> None:
    ask = Ask()
    for scope in (Scope.ConstraintProcessing.value, ARBITRATION):
        assert ask("blue", Op.CreateOperationalIntentReference, claim(), scope=scope, entityid=INTENT)[0] == 403
    assert ask.dss.bad_requests == 2


PLACES = st.builds(
    box,
    st.floats(LAT - 0.03, LAT + 0.03),
    st.floats(LON - 0.03, LON + 0.03),
    size_deg=st.floats(1e-4, 0.03),
    lower_m=st.floats(0, 100),
    start_s=st.floats(0, 300),
)


@given(one=PLACES, other=PLACES)
def test_what_overlaps_may_intersect_for_the_dss(one: Volume4D, other: Volume4D) -> None:
    airspace = Airspace()
    airspace.put("one", [one])
    if airspace.find_overlaps([other]):
        ours, theirs = (
            extent_of([Area(each.outline, each.lower_m, each.upper_m, each.start_ns, each.end_ns)])
            for each in (one, other)
        )
        assert ours.may_intersect(theirs)
