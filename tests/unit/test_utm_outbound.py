"""Does a USS get one response to every request, whatever the service that it asks, or the token endpoint, does?"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any, Final

import aiohttp
import jwt
import pytest
from aiohttp import web

from skyrange.codec.f3548.frames import UssRequest, UssResponse, decode, encode
from skyrange.contracts.mailboxes import Departure
from skyrange.core.ids import Port
from skyrange.runtime.utm import federation
from skyrange.runtime.utm.federation import Outbound
from skyrange.runtime.utm.tokens import TokenClient
from tests.hostile_json import HOSTILE, in_object

Handler = Callable[[web.BaseRequest], Awaitable[web.StreamResponse]]
PORT: Final = Port("approval.north", "uss:dss")


def _say(body: bytes = b"{}", status: int = 200, **headers: str) -> Handler:
    async def handle(request: web.BaseRequest) -> web.StreamResponse:
        return web.Response(status=status, body=body, headers=headers)

    return handle


async def _hang_up(request: web.BaseRequest) -> web.StreamResponse:
    assert request.transport is not None
    request.transport.abort()
    return web.Response()


async def _be_silent(request: web.BaseRequest) -> web.StreamResponse:
    await asyncio.sleep(60)
    return web.Response()


async def _break_off(request: web.BaseRequest) -> web.StreamResponse:
    response = web.StreamResponse(headers={"Content-Length": "100"})
    await response.prepare(request)
    await response.write(b"{")
    assert request.transport is not None
    request.transport.abort()
    return response


FAILURES: Final[dict[str, Handler]] = {
    "hangs up": _hang_up,
    "is silent": _be_silent,
    "breaks off": _break_off,
    "says nothing": _say(b""),
    "says a list": _say(b"[]"),
    "says HTML": _say(b"<html>", 502),
    "redirects": _say(b"", 302, Location="http://localhost/"),
    "says too much": _say(b" " * 5_000_000),
    "says what no frame holds": _say(b'{"a":"' + "é".encode() * 1_500_000 + b'"}'),
    "says that it is compressed": _say(b"{}", 200, **{"Content-Encoding": "gzip"}),
    **{f"answers {status}": _say(b'{"message":"no"}', status) for status in (299, 400, 401, 403, 429, 500, 503, 599)},
    **{f"says {name}": _say(in_object(text, access_token=text)) for name, text in HOSTILE.items()},
}


def _token(**claims: Any) -> bytes:
    token = jwt.encode({"sub": "north", **claims}, "k" * 32, "HS256")
    return b'{"access_token":"' + token.encode() + b'"}'


async def _ask(dss: Handler, tokens: Handler, count: int = 1) -> tuple[list[UssResponse], list[str]]:
    """The responses to `count` requests, one after the other, and what the services were asked for."""
    asked: list[str] = []

    async def handle(request: web.BaseRequest) -> web.StreamResponse:
        asked.append(request.path)
        return await (tokens if request.path == "/token" else dss)(request)

    server = web.Server(handle)
    listening = await asyncio.get_running_loop().create_server(server, "127.0.0.1", 0)
    base = f"http://127.0.0.1:{listening.sockets[0].getsockname()[1]}"
    delivered: asyncio.Queue[bytes] = asyncio.Queue()
    async with aiohttp.ClientSession() as session:
        client = TokenClient(session, f"{base}/token", "north", "secret")
        outbound = Outbound(
            session, client, {PORT.link: base}, lambda port, payload, sender: delivered.put_nowait(payload)
        )
        responses = []
        for exchange in range(1, count + 1):
            request = UssRequest(exchange=exchange, method="GET", path="/dss/v1/x", token="localhost scope")
            outbound.on_departure(Departure(PORT, encode(request)))
            async with asyncio.timeout(3.0):
                response = decode(await delivered.get())
            assert isinstance(response, UssResponse)
            assert response.exchange == exchange
            responses.append(response)
        outbound.close()
    listening.close()
    await server.shutdown(0.1)
    return responses, asked


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(federation, "CALL_S", 0.3)


@pytest.mark.parametrize("failure", FAILURES.values(), ids=FAILURES)
def test_every_failure_of_a_service_is_one_response(failure: Handler) -> None:
    (response,), _ = asyncio.run(_ask(failure, _say(_token(exp=9_000_000_000))))
    assert response.body is None or "message" in response.body or not response.body


@pytest.mark.parametrize("failure", FAILURES.values(), ids=FAILURES)
def test_every_failure_of_the_token_endpoint_is_one_response_with_a_reason(failure: Handler) -> None:
    (response,), asked = asyncio.run(_ask(_say(), failure))
    assert response.status == 503
    assert response.body is not None
    assert response.body["message"]
    assert set(asked) == {"/token"}, "aiohttp asks once more where a server hangs up"


@pytest.mark.parametrize("token", [b"x.y.z", b"", _token(exp="soon"), _token(exp=10**400), _token(exp=None), _token()])
def test_a_token_of_any_form_is_one_response(token: bytes) -> None:
    body = token if token.startswith(b"{") else b'{"access_token":"' + token + b'"}'
    (response,), _ = asyncio.run(_ask(_say(), _say(body)))
    assert response.status in (200, 503)


def test_a_token_that_is_not_taken_is_not_shown_again() -> None:
    _, asked = asyncio.run(_ask(_say(b"", 401), _say(_token(exp=9_000_000_000)), 2))
    assert asked == ["/token", "/dss/v1/x"] * 2
    _, asked = asyncio.run(_ask(_say(b"", 200), _say(_token(exp=9_000_000_000)), 2))
    assert asked == ["/token", "/dss/v1/x", "/dss/v1/x"]
