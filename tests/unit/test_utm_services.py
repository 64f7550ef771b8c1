"""UTM services over HTTP: a federation with TLS decides, survives restarts, and refuses what is wrong."""

from __future__ import annotations

import asyncio
import json
import random
import ssl
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from skyrange.core.chance import Chance
from skyrange.core.geodesy import Origin
from skyrange.core.ids import APPROVAL
from skyrange.core.time import NS_PER_S
from skyrange.core.volumes import Volume4D
from skyrange.runtime.utm.agent_host import UNIX
from skyrange.runtime.utm.web import WebService
from skyrange.testing.checks.approval_policies import EPOCH, box
from skyrange.utm.contract import ApprovalContext, OperationalIntent, intent_id
from skyrange.utm.federated.plugin import FEDERATED
from skyrange.utm.intent_states import IntentState
from skyrange.utm.messages import DecisionBody, Request, encode
from tests.approval_stations import LAT, LON, fly_requests
from tests.hostile_json import HOSTILE, in_object
from tests.utm_services import SERVICES, Federation, later, run, running, write, write_one

pytestmark = pytest.mark.rotating

COORDINATION = "utm.strategic_coordination"


@pytest.fixture(scope="module")
def paths(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return write(tmp_path_factory.mktemp("utm"))


@pytest.fixture
def fresh(paths: list[Path]) -> list[Path]:
    for database in paths[0].parent.glob("*.db*"):
        database.unlink()
    return paths


def moved(volume: Volume4D, by_ns: int) -> Volume4D:
    return replace(volume, start_ns=volume.start_ns + by_ns, end_ns=volume.end_ns + by_ns)


def wanted(
    vehicle: str, start_ns: int, north: float = 0.0, *, priority: int = 0, state: IntentState = IntentState.ACCEPTED
) -> OperationalIntent:
    volume = moved(box(LAT + north, LON, start_s=0.0), start_ns)
    return OperationalIntent(intent_id(vehicle), vehicle.split("/", 1)[0], vehicle, (volume,), priority, state)


def test_two_uss_decide_by_what_they_share_and_a_rejection_has_alternatives(fresh: list[Path]) -> None:
    async def body() -> None:
        async with running(fresh) as federation:
            start_ns = later(600)
            assert (await federation.want(wanted("blue/a", start_ns)))["decision"] == "Accepted"
            refused = await federation.want(wanted("red/b", start_ns))
            assert refused["decision"] == "Rejected"
            assert refused["reason"].startswith("volume 1 overlaps a volume of north")
            offered = refused["alternatives"][0]
            assert offered["delay_s"] > 0 or offered["climb_m"] > 0
            aside = await federation.want(wanted("red/b", start_ns, 0.01), version=1)
            assert aside["decision"] == "Accepted"
            assert len(aside["ovn"]) >= 16
            first = wanted("blue/a", start_ns)
            assert (await federation.ask("blue", Request.end(first)))[1]["decision"] == "Ended"
            assert (await federation.want(wanted("red/c", start_ns)))["decision"] == "Accepted"

    run(body)


def test_what_was_accepted_is_known_after_a_restart_of_everything(fresh: list[Path]) -> None:
    start_ns = later(600)

    async def before() -> None:
        async with running(fresh) as federation:
            for vehicle, north in (("blue/a", 0.0), ("red/a", 0.01), ("green/a", 0.02)):
                assert (await federation.want(wanted(vehicle, start_ns, north)))["decision"] == "Accepted"
            assert (await federation.ask("green", Request.end(wanted("green/a", start_ns))))[0] == 200

    async def after() -> None:
        async with running(fresh) as federation:
            active = wanted("blue/a", start_ns, state=IntentState.ACTIVATED)
            assert (await federation.want(active, version=1))["decision"] == "Accepted"
            assert (await federation.want(wanted("red/b", start_ns)))["decision"] == "Rejected"
            assert (await federation.want(wanted("red/b", start_ns, 0.02), version=1))["decision"] == "Accepted"
            stranger = replace(wanted("blue/a", start_ns), operator="green", vehicle="green/a")
            assert (await federation.ask("green", Request.of(stranger, UNIX)))[0] == 403, "it is blue's intent"

    run(before)
    run(after)


def test_a_uss_whose_dss_is_gone_accepts_nothing_and_one_that_is_gone_claims_all_that_it_had(
    fresh: list[Path],
) -> None:
    start_ns = later(600)

    async def without_dss() -> None:
        async with running(fresh, only=("auth", "north")) as federation:
            body = await federation.want(wanted("blue/a", start_ns))
            assert body["decision"] == "Rejected"
            assert body["reason"].startswith("DSS: ")
            assert not body["alternatives"], "a station would ask for the same for ever"

    async def first() -> None:
        async with running(fresh) as federation:
            assert (await federation.want(wanted("red/a", start_ns)))["decision"] == "Accepted"

    async def without_south() -> None:
        async with running(fresh, only=("auth", "dss", "north")) as federation:
            assert (await federation.want(wanted("blue/a", start_ns, 0.003)))["decision"] == "Rejected"

    for part in (without_dss, first, without_south):
        run(part)


def steps(count: int, seed: int) -> list[tuple[str, int, int, int, bool]]:
    chance = random.Random(seed)
    operators = [name for names in SERVICES.values() for name in names]
    return [
        (
            f"{chance.choice(operators)}/f{chance.randrange(3)}",
            chance.randrange(4),
            chance.randrange(3),
            chance.choice([0, 0, 0, 20]),
            chance.random() < 0.25,
        )
        for _ in range(count)
    ]


def requests(found: list[tuple[str, int, int, int, bool]], start_ns: int) -> list[Request]:
    made = []
    for number, (vehicle, place, slot, priority, ends) in enumerate(found):
        intent = wanted(vehicle, start_ns + 90 * slot * NS_PER_S, 0.0006 * place, priority=priority)
        made.append(Request.end(intent) if ends else Request.of(intent, UNIX, number + 1))
    return made


def said(body: DecisionBody) -> Any:
    offered = [(one.delay_s, one.climb_m, one.east_m, one.north_m) for one in body.alternatives]
    return body.decision, body.reason, offered, body.conflicts


def test_decisions_are_the_same_over_http_with_a_database_and_in_virtual_time(fresh: list[Path]) -> None:
    found = steps(60, seed=3)
    over_http: dict[str, list[Any]] = {operator: [] for names in SERVICES.values() for operator in names}

    async def body() -> None:
        async with running(fresh) as federation:
            for (vehicle, *_), request in zip(found, requests(found, later(600)), strict=True):
                operator = vehicle.split("/", 1)[0]
                status, answer = await federation.ask(operator, request)
                assert status == 200, answer
                over_http[operator].append(said(DecisionBody.model_validate(answer)))

    run(body)
    context = ApprovalContext(f"{APPROVAL}.federated", list(over_http), Origin(LAT, LON), EPOCH, Chance(1))
    service = FEDERATED(FEDERATED.params.model_validate({"services": SERVICES}), context)
    asks: dict[str, list[tuple[float, bytes]]] = {operator: [] for operator in over_http}
    start_ns = EPOCH.unix_ns + 600 * NS_PER_S
    for number, ((vehicle, *_), request) in enumerate(zip(found, requests(found, start_ns), strict=True)):
        asks[vehicle.split("/", 1)[0]].append((0.1 + 2.0 * number, encode(request)))
    stations, _ = fly_requests(asks, 130.0, service.agents, service.links, 1)
    virtual = {
        name: [said(one) for _, one in station.answers if not one.overruled] for name, station in stations.items()
    }
    assert virtual == over_http
    flat = [one[0] for rows in over_http.values() for one in rows]
    assert min(flat.count("Accepted"), flat.count("Rejected"), flat.count("Ended")) > 3, "the steps are worth comparing"


def test_an_authority_decides_alone_and_knows_after_a_restart_what_it_has_accepted(tmp_path: Path) -> None:
    paths, start_ns = write_one(tmp_path), later(600)

    async def before() -> None:
        async with running(paths) as services:
            assert (await services.want(wanted("blue/a", start_ns)))["decision"] == "Accepted"
            assert (await services.want(wanted("green/a", start_ns, 0.01)))["decision"] == "Accepted"
            refused = await services.want(wanted("red/a", start_ns))
            assert (refused["decision"], len(refused["alternatives"]) > 0) == ("Rejected", True)
            assert (await services.want(wanted("red/a", start_ns, priority=5), version=1))["conflicts"] == 1
            assert (await services.ask("green", Request.end(wanted("green/a", start_ns))))[0] == 200

    async def after() -> None:
        async with running(paths) as services:
            assert (await services.want(wanted("blue/a", start_ns), version=1))["decision"] == "Rejected", "overruled"
            assert (await services.want(wanted("blue/b", start_ns, 0.01)))["decision"] == "Accepted", "green has ended"
            active = wanted("red/a", start_ns, priority=5, state=IntentState.ACTIVATED)
            assert (await services.want(active, version=2))["decision"] == "Accepted"
            stranger = replace(wanted("red/a", start_ns), operator="green", vehicle="green/a")
            assert (await services.ask("green", Request.of(stranger, UNIX)))[0] == 403

    run(before)
    run(after)


@pytest.mark.parametrize(
    ("service", "method", "path", "token", "status"),
    [
        ("north", "GET", "/", "", 404),
        ("north", "GET", "/healthy", "", 200),
        ("north", "PUT", f"/v1/operational_intents/{intent_id('blue/a')}", "", 401),
        ("north", "PUT", f"/v1/operational_intents/{intent_id('blue/a')}", "guess", 401),
        ("north", "GET", "/uss/v1/operational_intents/x", COORDINATION, 404),
        ("north", "GET", f"/uss/v1/operational_intents/{intent_id('x')}", "", 401),
        ("north", "GET", f"/uss/v1/operational_intents/{intent_id('x')}", COORDINATION, 404),
        ("dss", "POST", "/dss/v1/operational_intent_references/query", COORDINATION, 400),
        ("dss", "GET", f"/dss/v1/constraint_references/{intent_id('x')}", COORDINATION, 403),
        ("dss", "DELETE", "/dss/v1/subscriptions/", COORDINATION, 400),
        ("auth", "GET", "/token", "", 401),
        ("north", "GET", "/flight_planning/v1/status", "", 401),
        ("north", "GET", "/flight_planning/v1/status", COORDINATION, 403),
    ],
)
def test_a_wrong_request_has_the_status_of_the_standard(
    paths: list[Path], service: str, method: str, path: str, token: str, status: int
) -> None:
    async def body() -> None:
        async with running(paths) as federation:
            given = await federation.token("north", token) if token.startswith("utm.") else token
            assert (await federation.call(service, method, path, token=given))[0] == status

    run(body)


@settings(max_examples=5, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_no_bytes_stop_a_service(paths: list[Path], data: st.DataObject) -> None:
    async def body() -> None:
        async with running(paths) as federation:
            tokens = [await federation.token("north", COORDINATION), "", "a.b.c"]
            for _ in range(20):
                service = data.draw(st.sampled_from(["north", "dss", "auth"]))
                method = data.draw(st.sampled_from(["GET", "PUT", "POST", "DELETE", "PATCH"]))
                start = data.draw(
                    st.sampled_from(
                        [
                            "/dss/v1/operational_intent_references/",
                            "/uss/v1/operational_intents/",
                            "/v1/operational_intents/",
                            "/flight_planning/v1/flight_plans/",
                            "/token",
                            "/",
                        ]
                    )
                )
                rest = data.draw(st.sampled_from(["query", intent_id("x"), "%00", "%ff", "..", "?a=b", "x" * 600, ""]))
                content = data.draw(st.sampled_from([b"", b"{}", b"[]", b"{", b"\xff", b"[" * 5_000, b'{"extents":1}']))
                url = federation.configs[service].base_url + start + rest
                headers = {"Authorization": f"Bearer {data.draw(st.sampled_from(tokens))}"}
                async with federation.session.request(method, url, data=content, headers=headers) as response:
                    assert response.status < 500, await response.text()
            for service in ("north", "dss", "auth"):
                assert (await federation.call(service, "GET", "/healthy"))[0] == 200

    run(body)


BODIES = [
    ("north", "PUT", f"/v1/operational_intents/{intent_id('x')}"),
    ("north", "POST", "/uss/v1/operational_intents"),
    ("north", "PUT", f"/flight_planning/v1/flight_plans/{intent_id('x')}"),
    ("dss", "PUT", f"/dss/v1/operational_intent_references/{intent_id('x')}"),
    ("dss", "POST", "/dss/v1/operational_intent_references/query"),
]


def test_a_body_that_no_strict_reader_takes_is_answered_with_400_at_once(paths: list[Path]) -> None:
    """With a token where one is checked before the body, and without one elsewhere."""
    longest = b"\xc3\xa9" * 2_000_000  # more than a frame takes once it is ASCII

    async def body() -> None:
        async with running(paths) as federation:
            operator = federation.configs["north"].uss.operators["blue"]  # type: ignore[union-attr]
            tokens = {"/v1": operator, "/flight_planning": await federation.token("uss_qualifier", PLAN)}
            for service, method, path in BODIES:
                url = federation.configs[service].base_url + path
                token = next((token for start, token in tokens.items() if path.startswith(start)), "")
                headers = {"Authorization": f"Bearer {token}"} if token else {}
                for name, text in HOSTILE.items():
                    for data in (text, in_object(text)):
                        async with asyncio.timeout(2.0):
                            async with federation.session.request(method, url, data=data, headers=headers) as response:
                                assert response.status == 400, (path, name, await response.text())
                async with asyncio.timeout(4.0):
                    data = in_object(b'"' + longest + b'"')
                    async with federation.session.request(method, url, data=data, headers=headers) as response:
                        assert response.status in (400, 413), path

    run(body)


def test_a_clean_end_leaves_nothing_in_the_write_ahead_log(tmp_path: Path, fresh: list[Path]) -> None:
    async def body(paths: list[Path], vehicle: str) -> None:
        async with running(paths) as services:
            assert (await services.want(wanted(vehicle, later(600))))["decision"] == "Accepted"

    for paths in (fresh, write_one(tmp_path)):
        run(lambda: body(paths, "blue/a"))  # noqa: B023 - it is run at once
        databases = list(paths[0].parent.glob("*.db"))
        assert databases
        assert not list(paths[0].parent.glob("*.db-*"))


def test_a_request_at_which_a_service_fails_is_logged_with_its_reason(
    paths: list[Path], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async def fail(*args: Any) -> Any:
        raise ZeroDivisionError("of the test")

    async def body() -> None:
        async with running(paths, only=("auth",)) as federation:
            for _ in range(5):
                status, answer = await federation.call("auth", "GET", "/healthy")
                assert (status, list(answer)) == (500, ["message"])
                assert "of the test" not in answer["message"]

    monkeypatch.setattr(WebService, "_answer", fail)
    run(body)
    assert [record.exc_info[0] for record in caplog.records if record.exc_info] == [ZeroDivisionError] * 3
    assert "/healthy" in caplog.text


def test_certificates_pass_the_strict_checks_of_newer_clients(paths: list[Path]) -> None:
    async def body() -> None:
        async with running(paths, only=("auth",)) as federation:
            context = ssl.create_default_context(cafile=str(paths[0].parent / "ca.crt"))
            context.verify_flags |= ssl.VERIFY_X509_STRICT  # the default of Python 3.13
            url = federation.configs["auth"].base_url + "/healthy"
            async with federation.session.get(url, ssl=context) as response:
                assert response.status == 200

    run(body)


def test_a_body_that_is_too_long_is_refused(paths: list[Path]) -> None:
    async def body() -> None:
        async with running(paths) as federation:
            long = {"x": "y" * 5_000_000}
            token = await federation.token("north", COORDINATION)
            path = "/dss/v1/operational_intent_references/query"
            assert (await federation.call("dss", "POST", path, long, token))[0] == 413

    run(body)


# ---------------------------------------------------------------- the interfaces for automated tests

PLAN, DIRECT = "interuss.flight_planning.plan", "interuss.flight_planning.direct_automated_test"


def flight_plan(start_ns: int, north: float = 0.0, *, usage: str = "Planned", priority: int = 0) -> dict[str, Any]:
    (volume,) = wanted("blue/x", start_ns, north).volumes
    data = json.loads(encode(Request.of(wanted("blue/x", start_ns, north), UNIX)))["body"]["volumes"]
    assert volume.lower_m < volume.upper_m
    basic = {"usage_state": usage, "uas_state": "Nominal", "area": data}
    return {
        "flight_plan": {"basic_information": basic, "astm_f3548_21": {"priority": priority}},
        "execution_style": "IfAllowed",
        "request_id": intent_id("request"),
    }


async def plan(federation: Federation, service: str, id_: str, body: dict[str, Any] | None) -> tuple[str, str]:
    token = await federation.token("uss_qualifier", PLAN)
    method = "DELETE" if body is None else "PUT"
    status, answer = await federation.call(service, method, f"/flight_planning/v1/flight_plans/{id_}", body, token)
    assert status == 200, answer
    return answer["planning_result"], answer["flight_plan_status"]


def test_flight_plans_of_automated_tests_are_intents(fresh: list[Path]) -> None:
    async def body() -> None:
        async with running(fresh) as federation:
            now_ns, direct = later(-5), await federation.token("uss_qualifier", DIRECT)
            plans = await federation.token("uss_qualifier", PLAN)
            status, answer = await federation.call("north", "GET", "/flight_planning/v1/status", token=direct)
            assert (status, answer["status"]) == (200, "Ready")
            one, two = intent_id("one"), intent_id("two")
            assert await plan(federation, "north", one, flight_plan(now_ns)) == ("Completed", "Planned")
            assert await plan(federation, "south", two, flight_plan(now_ns)) == ("Rejected", "NotPlanned")
            active = flight_plan(now_ns, usage="InUse")
            assert await plan(federation, "north", one, active) == ("Completed", "OkToFly")
            assert await plan(federation, "south", two, flight_plan(now_ns, priority=9)) == ("Completed", "Planned")
            query = {"after": UNIX.rfc3339(now_ns)}
            for service in ("north", "south"):
                status, answer = await federation.call(
                    service,
                    "GET",
                    "/flight_planning/v1/user_notifications",
                    token=plans,
                    params=query,
                )
                assert [note["conflicts"] for note in answer["user_notifications"]] == ["Single"], service
            hypothetical = {**active, "execution_style": "Hypothetical"}
            assert await plan(federation, "north", one, hypothetical) == ("NotSupported", "OkToFly")
            area = {"request_id": one, "extent": active["flight_plan"]["basic_information"]["area"][0]}
            status, answer = await federation.call(
                "north", "POST", "/flight_planning/v1/clear_area_requests", area, direct
            )
            assert (status, answer["outcome"]["success"]) == (200, True)
            assert await plan(federation, "south", two, None) == ("Completed", "Closed")
            assert await plan(federation, "north", intent_id("3"), flight_plan(now_ns)) == ("Completed", "Planned")

    run(body)


def test_an_authorization_service_issues_tokens_to_its_clients_for_their_scopes(paths: list[Path]) -> None:
    async def body() -> None:
        async with running(paths) as federation:
            secret = federation.secret("north")
            form = {
                "grant_type": "client_credentials",
                "client_id": "north",
                "client_secret": secret,
                "audience": "localhost",
                "scope": COORDINATION,
            }

            async def ask(**changes: str) -> tuple[int, Any]:
                url = federation.configs["auth"].base_url + "/token"
                async with federation.session.post(url, data={**form, **changes}) as response:
                    return response.status, await response.json()

            status, body = await ask()
            assert (status, body["token_type"]) == (200, "Bearer")
            path = f"/uss/v1/operational_intents/{intent_id('x')}"
            assert (await federation.call("north", "GET", path, token=body["access_token"]))[0] == 404
            wrong = {
                (401, "invalid_client"): {"client_secret": "guess"},
                (400, "unsupported_grant_type"): {"grant_type": "password"},
                (400, "invalid_request"): {"audience": ""},
                (400, "invalid_scope"): {"scope": PLAN},
            }
            for (status, error), change in wrong.items():
                answer = await ask(**change)
                assert (answer[0], answer[1]["error"]) == (status, error)
            elsewhere = (await ask(audience="elsewhere"))[1]["access_token"]
            assert (await federation.call("north", "GET", path, token=elsewhere))[0] == 401

    run(body)
