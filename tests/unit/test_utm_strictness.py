"""Does a DSS take exactly what the standards allow: outlines, ids, base URLs, and the times of tokens?"""

from __future__ import annotations

import json
import math
from typing import Any

import jwt
import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from hypothesis import given
from hypothesis import strategies as st
from uas_standards.astm.f3548.v21.api import OPERATIONS
from uas_standards.astm.f3548.v21.api import OperationID as Op
from uas_standards.astm.f3548.v21.constants import Scope

from skyrange.codec.f3548.operations import check_request, find_operation, path_of
from skyrange.codec.f3548.values import area_of
from skyrange.core.errors import DecodeError
from skyrange.core.geodesy import wrap_longitude
from skyrange.core.time import NS_PER_S
from skyrange.testing.checks.approval_policies import EPOCH
from skyrange.utm.federated.tokens import EDDSA, ISSUER, TokenChecker, TokenError, public_of
from skyrange.utm.messages import PATH, decode_request_body
from tests.approval_stations import ask
from tests.unit.test_utm_dss import INTENT, MONITORING, NEW, OTHER, SECRET, SUBSCRIPTION, Ask, claim, create

MANAGEMENT, PROCESSING = Scope.ConstraintManagement.value, Scope.ConstraintProcessing.value


def outline(points: list[tuple[float, float]]) -> dict[str, Any]:
    return {"volume": {"outline_polygon": {"vertices": [{"lat": lat, "lng": lng} for lat, lng in points]}}}


def is_taken(points: list[tuple[float, float]]) -> bool:
    try:
        area_of(outline(points), EPOCH, "volume")
    except DecodeError:
        return False
    return True


@given(
    angles=st.lists(st.integers(0, 359), min_size=3, max_size=12, unique=True).map(sorted),
    center=st.sampled_from([(47.0, 8.0), (0.0, 0.0), (10.0, 180.0), (-60.0, -179.999)]),
    data=st.data(),
)
def test_an_outline_is_taken_if_and_only_if_it_neither_crosses_nor_repeats(
    angles: list[int], center: tuple[float, float], data: st.DataObject
) -> None:
    """Corners on a circle: in their order they are an outline; with two exchanged, edges cross."""
    ring = [
        (center[0] + 0.01 * math.sin(math.radians(a)), wrap_longitude(center[1] + 0.01 * math.cos(math.radians(a))))
        for a in angles
    ]
    assert is_taken(ring)
    assert is_taken(ring[::-1])
    place = data.draw(st.integers(0, len(ring)))
    assert not is_taken([*ring[:place], data.draw(st.sampled_from(ring)), *ring[place:]]), "a vertex twice"
    if len(ring) >= 4:
        first = data.draw(st.integers(0, len(ring) - 2))
        swapped = [*ring[:first], ring[first + 1], ring[first], *ring[first + 2 :]]
        assert not is_taken(swapped), "edges cross"


@pytest.mark.parametrize(
    "points",
    [
        [(0.0, 0.0), (0.0, 1.0), (0.0, 2.0)],
        [(0.0, 0.0), (0.0, 2.0), (0.0, 1.0), (1.0, 1.0)],
        [(0.0, 0.0), (0.0, 2.0), (1.0, 2.0), (0.0, 1.0), (1.0, 0.0)],
        [(0.0, 180.0), (1.0, 180.0), (1.0, 179.0), (0.0, -180.0)],
    ],
    ids=["a line", "an edge back on itself", "a corner on an edge", "one meridian named twice"],
)
def test_what_encloses_nothing_or_touches_itself_is_refused(points: list[tuple[float, float]]) -> None:
    assert not is_taken(points)


def test_the_dss_refuses_such_outlines_and_stores_nothing() -> None:
    ask_dss = Ask()
    body = claim()
    vertices = body["extents"][0]["volume"]["outline_polygon"]["vertices"]
    for wrong in ([*vertices, vertices[0]], [vertices[1], vertices[0], *vertices[2:]]):
        body["extents"][0]["volume"]["outline_polygon"]["vertices"] = wrong
        status, answer = ask_dss("blue", Op.CreateOperationalIntentReference, body, entityid=INTENT)
        assert status == 400
        assert "outline" in answer["message"]
    assert not list(ask_dss.dss.store.intents)


# ---------------------------------------------------------------- ids


def test_every_path_has_its_ids_in_upper_case_too() -> None:
    parameters = {
        "entityid": INTENT,
        "subscriptionid": SUBSCRIPTION,
        "ovn": "aB-1",
        "version": "aB-2",
        "uss_id": "Uss",
        "log_set_id": "1",
    }
    for operation in OPERATIONS:
        found = find_operation(*path_of(operation, **parameters))
        assert found is not None, operation
        upper = {
            name: text.upper() if name in ("entityid", "subscriptionid") else text for name, text in parameters.items()
        }
        assert find_operation(*path_of(operation, **upper)) == found
        assert set(found.parameters.values()) <= set(parameters.values())


def test_an_intent_is_found_by_its_id_in_upper_case_and_told_in_lower_case() -> None:
    ask_dss = Ask()
    made = create(ask_dss, id_=INTENT.upper(), **NEW)
    assert made["id"] == INTENT
    status, body = ask_dss("blue", Op.GetOperationalIntentReference, entityid=INTENT)
    assert (status, body["operational_intent_reference"]["id"]) == (200, INTENT)
    subscription = made["subscription_id"]
    changed = claim(subscription_id=subscription.upper())
    status, body = ask_dss(
        "blue", Op.UpdateOperationalIntentReference, changed, entityid=INTENT.upper(), ovn=made["ovn"]
    )
    assert (status, body["operational_intent_reference"]["subscription_id"]) == (200, subscription)


def test_an_operator_may_write_ids_in_upper_case() -> None:
    body = json.loads(ask("blue/a"))["body"]
    lower = decode_request_body("PUT", PATH + body["id"], json.dumps(body).encode())
    upper = json.dumps({**body, "id": body["id"].upper()}).encode()
    assert decode_request_body("PUT", PATH + body["id"].upper(), upper) == lower


# ---------------------------------------------------------------- base URLs

URLS = {
    "https://uss.example.com": True,
    "http://localhost:8071/uss": True,
    "https://[::1]:8071": True,
    "HTTPS://USS": True,
    "": False,
    "uss": False,
    "ftp://uss": False,
    "file:///etc/passwd": False,
    "javascript:alert(1)": False,
    "https://": False,
    "https:///path": False,
    "https://user:secret@uss": False,
    "https://uss?x=1": False,
    "https://uss#x": False,
    "https://uss/\n/x": False,
    "https://uss /x": False,
    "https://uss\\x": False,
    "https://us\u0455": False,
    "https://uss:99999": False,
    "https://uss:0": False,
    "https://[::1": False,
}


@pytest.mark.parametrize(("url", "expected"), URLS.items())
def test_a_base_url_is_one_to_which_a_path_can_be_appended(url: str, expected: bool) -> None:
    """Of intents, of the subscriptions that come with them, of constraints, and of subscriptions of their own."""
    extents = claim()["extents"]
    requests: list[tuple[Op, Any, str, dict[str, str]]] = [
        (Op.CreateOperationalIntentReference, claim() | {"uss_base_url": url}, MONITORING, {"entityid": INTENT}),
        (
            Op.CreateOperationalIntentReference,
            claim(new_subscription={"uss_base_url": url}),
            MONITORING,
            {"entityid": OTHER},
        ),
        (Op.CreateConstraintReference, {"extents": extents, "uss_base_url": url}, MANAGEMENT, {"entityid": OTHER}),
        (
            Op.CreateSubscription,
            {"extents": extents[0], "uss_base_url": url, "notify_for_operational_intents": True},
            PROCESSING,
            {"subscriptionid": SUBSCRIPTION},
        ),
    ]
    asker: Any = Ask()
    for operation, body, scope, parameters in requests:
        if expected:
            check_request(operation, body)
        else:
            coordination = Scope.StrategicCoordination.value
            status, answer = asker("blue", operation, body, scope=f"{coordination} {scope}", **parameters)
            assert (status, "uss_base_url" in answer["message"]) == (400, True), answer


# ---------------------------------------------------------------- times of tokens


@given(
    before_s=st.integers(-5, 5),
    now_s=st.integers(0, 20),
    lasts_s=st.integers(1, 10),
    fraction=st.sampled_from([0, 0.5]),
)
def test_a_token_is_taken_from_its_nbf_to_its_exp(before_s: int, now_s: int, lasts_s: int, fraction: float) -> None:
    start_s = EPOCH.unix_ns // NS_PER_S
    nbf, exp = start_s + 5 + before_s + fraction, start_s + 5 + before_s + lasts_s
    claims = {"iss": ISSUER, "sub": "blue", "aud": "dss", "scope": "x", "exp": exp}
    key = Ed25519PrivateKey.from_private_bytes(SECRET)
    checker = TokenChecker(frozenset({"dss"}), (public_of(SECRET),), EPOCH)
    token = jwt.encode({**claims, "nbf": nbf}, key, EDDSA)
    at_s = start_s + now_s
    for _ in range(2):  # also where its signature is known already
        if at_s >= exp:
            with pytest.raises(TokenError, match="expired"):
                checker.check(now_s * NS_PER_S, token)
        elif at_s < nbf:
            with pytest.raises(TokenError, match="not valid yet"):
                checker.check(now_s * NS_PER_S, token)
        else:
            assert checker.check(now_s * NS_PER_S, token).uss == "blue"


@pytest.mark.parametrize("nbf", ["soon", True, None, [], {}])
def test_an_nbf_that_is_no_time_gives_no_access(nbf: Any) -> None:
    claims = {"iss": ISSUER, "sub": "blue", "aud": "dss", "scope": "x", "exp": EPOCH.unix_ns // NS_PER_S + 60}
    token = jwt.PyJWS().encode(
        json.dumps({**claims, "nbf": nbf}).encode(), Ed25519PrivateKey.from_private_bytes(SECRET), EDDSA
    )
    with pytest.raises(TokenError, match="nbf"):
        TokenChecker(frozenset({"dss"}), (public_of(SECRET),), EPOCH).check(0, token)
