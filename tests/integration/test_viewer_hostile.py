"""The viewer's server against clients that flood it, never read, talk nonsense, or come from elsewhere."""

from __future__ import annotations

import asyncio
import base64
import os
import random
import ssl
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import TypeVar

import aiohttp
import pytest
from aiohttp import web

from skyrange.core.errors import InputError
from skyrange.view import server
from skyrange.view.access import open_access
from skyrange.view.server import MAX_CLIENTS, LiveStream, make_application, serve
from skyrange.view.stream.messages import Message, decode_message
from tests.certificates import make_certificate

SCENE = Message("S", {"version": 1, "flying": True})
Result = TypeVar("Result")


def served(stream: LiveStream, use: Callable[[aiohttp.ClientSession, str], Awaitable[Result]]) -> Result:
    """What somebody learns from a server of a stream, within 30 s."""

    async def run() -> Result:
        async with serve(make_application(stream), "127.0.0.1", 0) as url, aiohttp.ClientSession() as session:
            return await asyncio.wait_for(use(session, url), 30.0)

    stream.publish(SCENE)
    return asyncio.run(run())


async def handshake(url: str) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    """A raw socket after the opening handshake (RFC 6455, 4.1)."""
    host, port = url.removeprefix("http://").strip("/").split(":")
    reader, writer = await asyncio.open_connection(host, int(port), limit=1 << 12)
    key = base64.b64encode(os.urandom(16)).decode()
    lines = ["GET /stream HTTP/1.1", f"Host: {host}:{port}", "Upgrade: websocket", "Connection: Upgrade"]
    lines += [f"Sec-WebSocket-Key: {key}", "Sec-WebSocket-Version: 13", "", ""]
    writer.write("\r\n".join(lines).encode())
    await reader.readuntil(b"\r\n\r\n")
    return reader, writer


async def gone(stream: LiveStream, left: int) -> None:
    """Wait until so many clients are left."""
    while len(stream._clients) > left:
        await asyncio.sleep(0.02)


def test_more_pages_than_may_be_open_are_told_to_come_later() -> None:
    async def use(session: aiohttp.ClientSession, url: str) -> None:
        sockets = [await session.ws_connect(url + "stream") for _ in range(MAX_CLIENTS)]
        assert all([(await socket.receive_bytes())[:1] == b"S" for socket in sockets])
        for _ in range(5):
            async with session.ws_connect(url + "stream") as refused:
                assert [message async for message in refused] == []
                assert refused.close_code == 1013
        await sockets.pop().close()
        await gone(stream, MAX_CLIENTS - 1)
        async with session.ws_connect(url + "stream") as admitted:
            assert (await admitted.receive_bytes())[:1] == b"S"
        for socket in sockets:
            await socket.close()

    stream = LiveStream()
    served(stream, use)


async def shout(socket: aiohttp.ClientWebSocketResponse, size: int) -> None:
    """Send as fast as the other end reads, for ten seconds."""
    until = time.monotonic() + 10.0
    while time.monotonic() < until:
        await socket.send_bytes(bytes(size))
        await asyncio.sleep(0)


@pytest.mark.parametrize("size", [1, 1000])
def test_a_page_that_talks_is_cut_off_and_others_are_served(size: int) -> None:
    async def use(session: aiohttp.ClientSession, url: str) -> float:
        async with session.ws_connect(url + "stream") as quiet, session.ws_connect(url + "stream") as loud:
            await quiet.receive_bytes()
            flood = asyncio.create_task(shout(loud, size))
            began = time.monotonic()
            stream.publish(Message("E", {"arm": 0, "names": []}))
            assert decode_message(await quiet.receive_bytes()).kind == "E"
            await gone(stream, 1)
            took_s = time.monotonic() - began
            with pytest.raises((ConnectionError, aiohttp.ClientError)):
                await flood
        return took_s

    stream = LiveStream()
    assert served(stream, use) < 5.0


class Counted(LiveStream):
    """A stream that knows how much waits for its clients."""

    def __init__(self) -> None:
        super().__init__()
        self.transports: list[asyncio.Transport] = []

    async def answer(self, request: web.Request) -> web.WebSocketResponse:
        assert isinstance(request.transport, asyncio.Transport)
        self.transports.append(request.transport)
        return await super().answer(request)


def test_a_client_that_never_reads_holds_nobody_up_and_is_disconnected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "HEARTBEAT_S", 1.0)
    count, noise = 60, random.Random(1)

    async def use(session: aiohttp.ClientSession, url: str) -> int:
        _, writer = await handshake(url)
        async with session.ws_connect(url + "stream", max_msg_size=0) as reading:
            await reading.receive_bytes()
            for _ in range(count):
                stream.publish(Message("E", {"arm": 0, "names": [noise.randbytes(100_000).hex()]}))
            for _ in range(count):
                assert (await reading.receive_bytes())[:1] == b"E"
            waiting = max(transport.get_write_buffer_size() for transport in stream.transports)
            await gone(stream, 1)
        writer.close()
        return waiting

    stream = Counted()
    assert 0 < served(stream, use) < 1 << 20


def test_nonsense_on_a_socket_ends_that_socket_alone() -> None:
    async def use(session: aiohttp.ClientSession, url: str) -> None:
        chance = random.Random(7)
        for _ in range(40):
            _, writer = await handshake(url)
            writer.write(chance.randbytes(chance.randrange(1, 3000)))
            if chance.random() < 0.5:
                writer.transport.abort()
            writer.close()
        async with session.ws_connect(url + "stream") as socket:
            assert (await socket.receive_bytes())[:1] == b"S"
            await gone(stream, 1)

    stream = LiveStream()
    served(stream, use)


@pytest.fixture(scope="module")
def pems(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return make_certificate(tmp_path_factory.mktemp("tls"))


def test_other_machines_need_the_printed_address_and_tls(pems: tuple[Path, Path]) -> None:
    access, stream = open_access("127.0.0.1", *pems), LiveStream()
    assert access is not None
    stream.publish(SCENE)

    async def run() -> None:
        trusted = ssl.create_default_context(cafile=pems[0])
        async with serve(make_application(stream, access=access), "127.0.0.1", 0) as url:
            base, _, token = url.partition("?token=")
            assert base.startswith("https://127.0.0.1:")
            assert len(token) >= 32
            async with aiohttp.ClientSession(connector=aiohttp.TCPConnector(ssl=trusted)) as stranger:
                for path in (
                    "",
                    "assets/page.js",
                    "stream",
                    "?token=",
                    f"?token={token[:-1]}",
                    f"assets/?token={token}",
                ):
                    async with stranger.get(base + path) as refused:
                        assert refused.status == 403
                        assert "set-cookie" not in refused.headers
                with pytest.raises(aiohttp.WSServerHandshakeError):
                    await stranger.ws_connect(base + "stream")
                with pytest.raises(aiohttp.ClientError):
                    await stranger.get(base.replace("https", "http") + f"?token={token}")
            jar, connector = aiohttp.CookieJar(unsafe=True), aiohttp.TCPConnector(ssl=trusted)  # of an IP address
            async with aiohttp.ClientSession(cookie_jar=jar, connector=connector) as page:
                async with page.get(url) as found:
                    assert (found.status, str(found.url)) == (200, base)
                    (sent,) = [given.headers["Set-Cookie"] for given in found.history]
                    assert all(word in sent for word in ("Secure", "HttpOnly", "SameSite=Strict"))
                async with page.ws_connect(base + "stream", origin=base.rstrip("/")) as socket:
                    assert (await socket.receive_bytes())[:1] == b"S"
                with pytest.raises(aiohttp.WSServerHandshakeError):
                    await page.ws_connect(base + "stream", origin="https://evil.example")

    asyncio.run(run())


def test_an_address_of_a_network_without_tls_is_refused(pems: tuple[Path, Path], tmp_path: Path) -> None:
    certificate, key = pems
    assert open_access("::1", None, None) is None
    for host in ("0.0.0.0", "10.0.0.1", "::"):
        with pytest.raises(InputError, match="TLS"):
            open_access(host, None, None)
    with pytest.raises(InputError, match="--key: missing"):
        open_access("10.0.0.1", certificate, None)
    with pytest.raises(InputError, match="--certificate: missing"):
        open_access("127.0.0.1", None, key)
    for pair in ((key, certificate), (certificate, tmp_path / "none.pem"), (certificate, tmp_path)):
        with pytest.raises(InputError, match="PEM files"):
            open_access("10.0.0.1", *pair)
