"""Whatever connects to a listener of the project, and keeps quiet: does who comes next get in, and is the log quiet?"""

from __future__ import annotations

import asyncio
import os
import re
import resource
import socket
import ssl
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import ExitStack, asynccontextmanager, suppress
from pathlib import Path
from typing import Any, Final

import aiohttp
import pytest

import skyrange
from skyrange.io import limited_listener
from skyrange.io.http.transports import HttpServerTransport
from skyrange.io.limited_listener import LimitedListener, find_idlest, listen, listen_unix, stream_factory
from skyrange.io.mavlink.transports import TcpTransport
from skyrange.io.mavlink.viewer_ports import ViewerPorts
from skyrange.runtime.live.transport.links import TcpListener
from skyrange.runtime.utm.web import Routes, WebService
from skyrange.view.server import RecordedStream, make_application, serve
from tests.utm_services import running, write

ROOT: Final = Path(skyrange.__file__).parent
MOST: Final = 12
Admit = Callable[[], Awaitable[None]]
"""Connects as who should get in, and fails where it does not."""


@asynccontextmanager
async def _open_approval() -> AsyncIterator[tuple[int, Admit]]:
    server = await HttpServerTransport.open(lambda piece: None)

    async def admit() -> None:
        async with (
            aiohttp.ClientSession() as session,
            session.get(f"http://127.0.0.1:{server.address[1]}/") as response,
        ):
            assert response.status == 405

    yield server.address[1], admit
    server.close()


@asynccontextmanager
async def _open_utm() -> AsyncIterator[tuple[int, Admit]]:
    web = WebService(Routes())
    listener = await listen(web.server, "127.0.0.1", 0)

    async def admit() -> None:
        url = f"http://127.0.0.1:{listener.address[1]}/healthy"
        async with aiohttp.ClientSession() as session, session.get(url) as response:
            assert response.status == 200

    yield listener.address[1], admit
    listener.close()
    await web.server.shutdown(0.1)


@asynccontextmanager
async def _open_utm_with_tls(paths: list[Path]) -> AsyncIterator[tuple[int, Admit]]:
    async with running(paths, only=("auth",)) as federation:
        url = federation.configs["auth"].base_url

        async def admit() -> None:
            context = ssl.create_default_context(cafile=str(paths[0].parent / "ca.crt"))
            async with aiohttp.ClientSession() as session, session.get(f"{url}/healthy", ssl=context) as response:
                assert response.status == 200

        yield int(url.rpartition(":")[2]), admit


@asynccontextmanager
async def _open_viewer() -> AsyncIterator[tuple[int, Admit]]:
    async with serve(make_application(RecordedStream(b"")), "127.0.0.1", 0) as url:

        async def admit() -> None:
            async with aiohttp.ClientSession() as session, session.get(url) as response:
                assert response.status == 200

        yield int(url.rstrip("/").rpartition(":")[2]), admit


@asynccontextmanager
async def _open_link() -> AsyncIterator[tuple[int, Admit]]:
    with socket.socket() as tried:
        tried.bind(("127.0.0.1", 0))
        address = tried.getsockname()
    server = await TcpListener.open(lambda piece: None, address)

    async def admit() -> None:
        peer = await TcpTransport.connect(lambda piece: None, address)
        while not server.send(b"x"):
            await asyncio.sleep(0.01)
        peer.close()

    yield address[1], admit
    server.close()


@asynccontextmanager
async def _open_lines() -> AsyncIterator[tuple[int, Admit]]:
    """As a tap process listens for its program."""

    async def echo(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(OSError):
            while line := await reader.readline():
                writer.write(line)
        writer.close()

    listener = await listen(stream_factory(echo, 1_024), "127.0.0.1", 0)

    async def admit() -> None:
        reader, writer = await asyncio.open_connection(*listener.address)
        writer.write(b"line\n")
        assert await reader.readline() == b"line\n"
        writer.close()

    yield listener.address[1], admit
    listener.close()
    await asyncio.sleep(0.01)


@asynccontextmanager
async def _open_viewer_port() -> AsyncIterator[tuple[int, Admit]]:
    """Of MAVLink viewers, and of their relay."""
    ports = ViewerPorts([0])

    async def poll() -> None:
        while True:
            ports.serve()
            await asyncio.sleep(0.001)

    async def admit() -> None:
        reader, writer = await asyncio.open_connection("127.0.0.1", ports.numbers[0])
        async with asyncio.timeout(2.0):
            while True:
                ports.show(0, b"x")
                with suppress(TimeoutError):
                    async with asyncio.timeout(0.02):
                        assert await reader.read(1) == b"x"
                        break
        writer.close()

    polling = asyncio.create_task(poll())
    yield ports.numbers[0], admit
    polling.cancel()
    ports.close()


LISTENERS: Final[dict[str, Callable[[], Any]]] = {
    "approval": _open_approval,
    "UTM service": _open_utm,
    "viewer": _open_viewer,
    "link": _open_link,
    "lines": _open_lines,
    "viewer port": _open_viewer_port,
}
HABITS: Final = {
    "silent": b"",
    "begins": b"GET / HT",
    "keeps alive": b"GET /healthy HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
    "begins TLS": b"\x16\x03\x01\x02\x00\x01",
}


@pytest.fixture(autouse=True)
def _few_connections(monkeypatch: pytest.MonkeyPatch) -> None:
    make: Any = LimitedListener.__init__

    def init(self: LimitedListener, *arguments: Any) -> None:
        make(self, *arguments[:3], min(arguments[3], MOST))

    monkeypatch.setattr(LimitedListener, "__init__", init)


def _is_open(connection: socket.socket) -> bool:
    connection.settimeout(0.0)
    try:
        while connection.recv(65_536):
            pass
        return False
    except BlockingIOError:
        return True
    except OSError:
        return False


async def _crowd_and_admit(opened: Any, habit: bytes) -> None:
    """Have `3 * MOST` clients of one habit there, and then one that has to be served; nothing is logged."""
    logged: list[Any] = []
    asyncio.get_running_loop().set_exception_handler(lambda loop, context: logged.append(context))
    async with opened as (port, admit):
        with ExitStack() as stack:
            crowd = []
            for _ in range(3 * MOST):
                client = stack.enter_context(socket.socket())
                client.settimeout(1.0)
                client.connect(("127.0.0.1", port))
                with suppress(OSError):
                    client.sendall(habit)
                crowd.append(client)
                await asyncio.sleep(0.002)
            async with asyncio.timeout(5.0):
                for _ in range(3):
                    await admit()
            assert sum(map(_is_open, crowd)) <= MOST
    assert not logged


def _take_descriptors() -> list[int]:
    """Take all descriptors that the process may have; who takes them has to close them."""
    taken = []
    with suppress(OSError):
        while True:
            taken.append(os.open("/dev/null", os.O_RDONLY))
    return taken


@pytest.mark.parametrize("habit", HABITS.values(), ids=HABITS)
@pytest.mark.parametrize("listener", LISTENERS.values(), ids=LISTENERS)
def test_a_crowd_that_keeps_its_connections_keeps_nobody_out(listener: Callable[[], Any], habit: bytes) -> None:
    asyncio.run(_crowd_and_admit(listener(), habit))


@pytest.fixture(scope="module")
def paths(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return write(tmp_path_factory.mktemp("utm"))


@pytest.mark.parametrize("habit", HABITS.values(), ids=HABITS)
def test_connections_are_counted_before_the_handshake_of_tls(paths: list[Path], habit: bytes) -> None:
    asyncio.run(_crowd_and_admit(_open_utm_with_tls(paths), habit))


def test_a_handshake_that_does_not_begin_ends(paths: list[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limited_listener, "HANDSHAKE_S", 0.1)

    async def body() -> None:
        async with _open_utm_with_tls(paths) as (port, _):
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            async with asyncio.timeout(3.0):
                assert await reader.read() == b""
            writer.close()

    asyncio.run(body())


def test_a_client_that_does_not_begin_tls_costs_no_buffers(monkeypatch: pytest.MonkeyPatch) -> None:
    """asyncio has 256 KiB for each connection over TLS."""
    begun: list[Any] = []

    async def connect(*arguments: Any, **more: Any) -> None:
        begun.append(arguments)
        raise ConnectionResetError

    async def body() -> None:
        monkeypatch.setattr(asyncio.get_running_loop(), "connect_accepted_socket", connect, raising=False)
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        listener = await listen(asyncio.Protocol, "127.0.0.1", 0, context=context)
        with ExitStack() as stack:
            clients = [stack.enter_context(socket.create_connection(listener.address)) for _ in range(5)]
            await asyncio.sleep(0.05)
            assert (len(begun), listener.connections) == (0, 5)
            clients[0].sendall(b"\x16")
            clients[1].close()
            await asyncio.sleep(0.05)
            assert (len(begun), listener.connections) == (1, 3)
        listener.close()
        await asyncio.sleep(0)

    asyncio.run(body())


def test_without_descriptors_a_listener_waits_quietly_and_then_goes_on() -> None:
    """Of each kind that asyncio serves: the exception handler hears nothing, and the idlest makes room."""

    async def body() -> None:
        logged: list[Any] = []
        asyncio.get_running_loop().set_exception_handler(lambda loop, context: logged.append(context))
        async with _open_lines() as (port, admit):
            before = resource.getrlimit(resource.RLIMIT_NOFILE)
            clients = [socket.socket() for _ in range(MOST // 2)]
            resource.setrlimit(resource.RLIMIT_NOFILE, (len(os.listdir("/proc/self/fd")) + 4, before[1]))
            taken: list[int] = []
            try:
                taken = _take_descriptors()
                for client in clients:
                    client.connect(("127.0.0.1", port))
                await asyncio.sleep(0.3)
            finally:
                for number in taken:
                    os.close(number)
                resource.setrlimit(resource.RLIMIT_NOFILE, before)
            async with asyncio.timeout(2.0):
                await admit()
            for client in clients:
                client.close()
        assert not logged

    asyncio.run(body())


def test_the_idlest_of_whoever_has_most_gives_way() -> None:
    with ExitStack() as stack:
        listening = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        pairs = []
        for _ in range(4):
            client = stack.enter_context(socket.create_connection(listening.getsockname()))
            pairs.append((client, stack.enter_context(listening.accept()[0])))
        own = [server for _, server in pairs]
        for place in (0, 2, 3):
            time.sleep(0.015)
            pairs[place][0].send(b"x")
            own[place].recv(1)
        same = dict.fromkeys(own, "a")
        assert find_idlest(same) is own[1]
        assert find_idlest({**same, own[0]: "b", own[1]: "b"}) in (own[1], own[2]), "two have two each"
        assert find_idlest({**same, own[1]: "b"}) is own[0], "b has one alone"
        assert find_idlest({}) is None


def test_a_unix_socket_keeps_those_that_are_there(tmp_path: Path) -> None:
    async def body() -> None:
        async def hold(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            await reader.read()
            writer.close()

        path = str(tmp_path / "x.sock")
        listener = listen_unix(stream_factory(hold, 64), path, most=3)
        assert os.stat(path).st_mode & 0o777 == 0o600
        ends = [await asyncio.open_unix_connection(path) for _ in range(5)]
        async with asyncio.timeout(2.0):
            assert [await reader.read() for reader, _ in ends[3:]] == [b"", b""]
        assert listener.connections == 3
        for _, writer in ends:
            writer.close()
        await asyncio.sleep(0.05)
        listener.close()
        listen_unix(stream_factory(hold, 64), path, most=3).close()

    asyncio.run(body())


def test_no_module_listens_another_way() -> None:
    words = (
        r"\b(start_server|start_unix_server|create_unix_server|TCPSite|SockSite|UnixSite)\(|loop\(\)\.create_server\("
    )
    found = {
        path.relative_to(ROOT).as_posix()
        for path in ROOT.rglob("*.py")
        if re.search(words, path.read_text()) and not path.is_relative_to(ROOT / "bench")
    }
    assert not found
