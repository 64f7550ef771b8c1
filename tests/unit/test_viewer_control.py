"""Who controls a run through the viewer's server, and what becomes of all other requests."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable, Mapping
from concurrent.futures import Future
from dataclasses import asdict
from typing import Any, TypeVar

import aiohttp
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyrange.core.errors import InputError
from skyrange.view import control_server
from skyrange.view.control import Command, RunControl
from skyrange.view.control_server import MAX_BYTES, MAX_PER_S, ControlServer, parse_command
from skyrange.view.server import LiveStream, make_application, serve

Result = TypeVar("Result")
Ask = Callable[[aiohttp.ClientSession, str, ControlServer], Awaitable[Result]]
STATE = {"acts": [], "now_s": 1.5}


class Recorded:
    """Something that can be controlled: it keeps the commands, and refuses acts whose id is "no"."""

    def __init__(self) -> None:
        self.commands: list[Command] = []
        self.silent = False
        self.state: Mapping[str, Any] = STATE

    def submit(self, command: Command) -> Future[Mapping[str, Any]]:
        answer: Future[Mapping[str, Any]] = Future()
        if self.silent:
            return answer
        if command.act == "no":
            answer.set_exception(InputError.one("attack no", "start", "has started", "an act that has not"))
            return answer
        self.commands.append(command)
        answer.set_result({"at_s": 1.51})
        return answer


def asked(ask: Ask[Result], target: Recorded | None = None, clock: Callable[[], float] = lambda: 0.0) -> Result:
    """What a client learns from a server that controls `target`."""

    async def run() -> Result:
        control = ControlServer(target or Recorded(), clock=clock)
        application = make_application(LiveStream(), control)
        async with serve(application, "127.0.0.1", 0) as url, aiohttp.ClientSession() as session:
            return await ask(session, url, control)

    return asyncio.run(run())


async def post(
    session: aiohttp.ClientSession, url: str, token: str, body: bytes | str, **headers: str
) -> tuple[int, Any]:
    sent = {"Authorization": f"Bearer {token}", **headers}
    async with session.post(url + "control", data=body, headers=sent) as response:
        return response.status, await response.json(content_type=None)


def test_without_control_nothing_is_offered() -> None:
    async def ask() -> tuple[list[int], str]:
        async with (
            serve(make_application(LiveStream()), "127.0.0.1", 0) as url,
            aiohttp.ClientSession() as session,
        ):
            found = []
            for path in ("control", "open/x"):
                async with session.get(url + path) as response:
                    found.append(response.status)
            async with session.post(url + "control", data=b"{}") as response:
                found.append(response.status)
            async with session.get(url) as response:
                return found, await response.text()

    statuses, page = asyncio.run(ask())
    assert statuses == [404, 404, 404]
    assert "data-control" not in page


def test_who_has_the_token_is_obeyed_and_answered() -> None:
    target = Recorded()

    async def ask(session: aiohttp.ClientSession, url: str, control: ControlServer) -> list[Any]:
        answers = [
            await post(session, url, control.token, json.dumps(body))
            for body in ({"do": "start", "act": "ghost"}, {"do": "pause"}, {"do": "speed", "speed": 2})
        ]
        answers.append(await post(session, url, control.token, '{"do": "start", "act": "no"}'))
        async with session.get(url) as response:
            page = await response.text()
        async with session.get(url + "control", headers={"Authorization": f"Bearer {control.token}"}) as response:
            assert response.headers["Cache-Control"] == "no-store"
            assert response.headers["X-Content-Type-Options"] == "nosniff"
            state = await response.json()
        assert "data-control" in page
        assert control.token not in page
        return [*answers, state]

    *obeyed, refused, state = asked(ask, target)
    assert [(status, answer["at_s"]) for status, answer in obeyed] == [(200, 1.51)] * 3
    assert all(answer["state"] == STATE for _, answer in obeyed)
    assert refused[0] == 409
    assert "has started" in refused[1]["error"]
    assert {key: state[key] for key in STATE} == STATE
    assert (state["counts"]["obeyed"], state["counts"]["refused"]) == (3, 1)
    assert target.commands == [Command("start", act="ghost"), Command("pause"), Command("speed", speed=2.0)]


STRANGERS: list[tuple[str, str]] = [("", ""), ("Bearer", ""), ("Bearer", "x"), ("Basic", "TOKEN"), ("Bearer", "TOKEN ")]


@pytest.mark.parametrize(("scheme", "token"), STRANGERS)
def test_nobody_else_is_obeyed(scheme: str, token: str) -> None:
    target = Recorded()

    async def ask(session: aiohttp.ClientSession, url: str, control: ControlServer) -> tuple[list[int], int]:
        given = token.replace("TOKEN ", control.token + "é").replace("TOKEN", control.token)
        headers = {"Authorization": f"{scheme} {given}"} if scheme else {}
        statuses = []
        async with session.get(url + "control", headers=headers) as response:
            statuses.append(response.status)
        async with session.post(url + "control", data=b'{"do": "pause"}', headers=headers) as response:
            statuses.append(response.status)
            assert control.token not in await response.text()
        return statuses, control.counts.strangers

    assert asked(ask, target) == ([401, 401], 2)
    assert target.commands == []


@pytest.mark.parametrize("headers", [{"Origin": "https://evil.example"}, {"Origin": "null"}, {"Host": "evil.example"}])
def test_pages_of_others_are_refused_even_with_the_token(headers: dict[str, str]) -> None:
    target = Recorded()

    async def ask(session: aiohttp.ClientSession, url: str, control: ControlServer) -> list[int]:
        sent = {"Authorization": f"Bearer {control.token}", **headers}
        statuses = []
        for method in ("GET", "POST", "OPTIONS"):
            async with session.request(method, url + "control", data=b'{"do": "pause"}', headers=sent) as response:
                statuses.append(response.status)
        return statuses

    assert asked(ask, target) == [403, 403, 403]
    assert target.commands == []


def test_what_is_malformed_or_too_long_is_counted_and_survived() -> None:
    target = Recorded()
    bodies = (
        b"",
        b"{",
        b"[" * MAX_BYTES,
        b"\xff\xfe",
        b'{"do": "pause", "x": 1}',
        b" " * (MAX_BYTES + 1),
        b"x" * 2_000_000,
    )

    async def ask(session: aiohttp.ClientSession, url: str, control: ControlServer) -> tuple[list[int], dict[str, int]]:
        statuses = [(await post(session, url, control.token, body))[0] for body in bodies]
        assert (await post(session, url, control.token, '{"do": "resume"}'))[0] == 200
        return statuses, asdict(control.counts)

    statuses, counts = asked(ask, target)
    assert statuses == [400] * 5 + [413] * 2
    assert (counts["malformed"], counts["too_long"], counts["obeyed"]) == (5, 2, 1)
    assert target.commands == [Command("resume")]


def test_a_flood_is_counted_and_survived() -> None:
    target, wall = Recorded(), [0.0]

    async def ask(session: aiohttp.ClientSession, url: str, control: ControlServer) -> tuple[list[int], int]:
        calls = [post(session, url, control.token, '{"do": "pause"}') for _ in range(3 * int(MAX_PER_S))]
        statuses = [status for status, _ in await asyncio.gather(*calls)]
        wall[0] += 1.0
        assert (await post(session, url, control.token, '{"do": "resume"}'))[0] == 200
        return statuses, control.counts.too_many

    statuses, too_many = asked(ask, target, lambda: wall[0])
    assert statuses.count(200) == MAX_PER_S
    assert statuses.count(429) == too_many == 2 * MAX_PER_S


def test_a_command_that_is_not_carried_out_in_time_is_withdrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(control_server, "ANSWER_S", 0.05)
    control = RunControl()  # without a run, nothing carries it out

    async def ask(session: aiohttp.ClientSession, url: str, server: ControlServer) -> tuple[int, Any, int]:
        status, answer = await post(session, url, server.token, '{"do": "pause"}')
        return status, answer, server.counts.unanswered

    status, answer, unanswered = asked(ask, control)  # type: ignore[arg-type]
    assert (status, unanswered) == (503, 1)
    assert "withdrawn" in answer["error"]
    (left,) = control._waiting
    assert left[1].cancelled()


def test_the_address_for_the_browser_leads_to_the_token_once() -> None:
    async def ask(session: aiohttp.ClientSession, url: str, control: ControlServer) -> list[tuple[int, str]]:
        found = []
        for address in (url + "open/wrong", control.address_once(url), control.address_once(url), url + "open/None"):
            async with session.get(address, allow_redirects=False) as response:
                found.append((response.status, response.headers.get("Location", "")))
        assert control.address(url).endswith(found[1][1])
        return found

    wrong, right, again, none = asked(ask)
    assert right[0] == 303
    assert [wrong, again, none] == [(404, "")] * 3


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["do", "act", "speed"]), inner),
    max_leaves=5,
)
dos = st.sampled_from(["start", "stop", "pause", "resume", "speed", "fly", "", None])
bodies = st.binary(max_size=60) | json_values.map(lambda value: json.dumps(value).encode()) | st.fixed_dictionaries(
    {"do": dos}, optional={"act": json_values, "speed": json_values}
).map(lambda value: json.dumps(value).encode())  # fmt: skip


@given(body=bodies)
def test_any_bytes_are_a_command_or_none(body: bytes) -> None:
    command = parse_command(body)
    if command is None:
        return
    data: dict[str, Any] = {"do": command.do}
    if command.do in ("start", "stop"):
        data["act"] = command.act
    if command.do == "speed":
        data["speed"] = command.speed
    assert data == json.loads(body)
    assert parse_command(json.dumps(data).encode()) == command
