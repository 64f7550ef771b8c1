"""What the viewer's server answers, and to whom."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import TypeVar

import aiohttp
import pytest

from skyrange.core.errors import InputError
from skyrange.view.server import RecordedStream, make_application, serve

DATA = bytes(range(100))
Result = TypeVar("Result")


def asked(ask: Callable[[aiohttp.ClientSession, str], Awaitable[Result]]) -> Result:
    """What a client learns from a server of `DATA`."""

    async def run() -> Result:
        async with (
            serve(make_application(RecordedStream(DATA)), "127.0.0.1", 0) as url,
            aiohttp.ClientSession() as session,
        ):
            return await ask(session, url)

    return asyncio.run(run())


@pytest.mark.parametrize(
    ("wanted", "status", "body", "said"),
    [
        (None, 200, DATA, None),
        ("bytes=10-19", 206, DATA[10:20], "bytes 10-19/100"),
        ("bytes=90-", 206, DATA[90:], "bytes 90-99/100"),
        ("bytes=-5", 206, DATA[95:], "bytes 95-99/100"),
        ("bytes=90-400", 206, DATA[90:], "bytes 90-99/100"),
        ("bytes=100-", 416, b"", "bytes */100"),
        ("bytes=20-10", 200, DATA, None),
        ("bytes=1-2,5-6", 200, DATA, None),
        ("pages=1-2", 200, DATA, None),
    ],
)
def test_ranges(wanted: str | None, status: int, body: bytes, said: str | None) -> None:
    async def ask(session: aiohttp.ClientSession, url: str) -> tuple[int, bytes, str | None]:
        headers = {} if wanted is None else {"Range": wanted}
        async with session.get(url + "stream", headers=headers) as response:
            return response.status, await response.read(), response.headers.get("Content-Range")

    assert asked(ask) == (status, body, said)


@pytest.mark.parametrize(
    ("path", "headers", "status"),
    [
        ("assets/stream.js", {}, 200),
        ("assets/none.js", {}, 404),
        ("assets/..%2fserver.py", {}, 404),
        ("assets/%2e%2e/server.py", {}, 404),
        ("server.py", {}, 404),
        ("stream", {"Host": "evil.example"}, 403),
        ("stream", {"Host": "127.0.0.1.evil.example:80"}, 403),
        ("stream", {"Origin": "https://evil.example"}, 403),
        ("stream", {"Origin": "null"}, 403),
    ],
)
def test_only_files_of_the_viewer_are_answered_and_only_to_its_own_page(
    path: str, headers: dict[str, str], status: int
) -> None:
    async def ask(session: aiohttp.ClientSession, url: str) -> tuple[int, str]:
        async with session.get(url + path, headers=headers) as response:
            return response.status, response.headers.get("X-Content-Type-Options", "")

    found, guarded = asked(ask)
    assert found == status
    assert guarded == "nosniff" or status == 403


def test_a_port_that_is_taken_is_an_error_that_names_it() -> None:
    async def ask(_session: aiohttp.ClientSession, url: str) -> None:
        port = int(url.rsplit(":", 1)[1].strip("/"))
        with pytest.raises(InputError, match=rf"127\.0\.0\.1:{port}"):
            async with serve(make_application(RecordedStream(DATA)), "127.0.0.1", port):
                pass

    asked(ask)
