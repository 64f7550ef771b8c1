"""However many strangers connect to a listener, it holds few of them, its peers get in, and descriptors are left."""

from __future__ import annotations

import asyncio
import os
import resource
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
import zmq

from skyrange.io.http.transports import HttpClientTransport, HttpServerTransport
from skyrange.io.limited_listener import MAX_CONNECTIONS
from skyrange.io.mavlink.transports import TcpTransport
from skyrange.io.mavlink.viewer_ports import MAX_MORE_VIEWERS, ViewerPorts
from skyrange.io.processes.program import SPARE_FILES, Program, reserve_files, spare_files
from skyrange.io.zeromq.context import MAX_PENDING, MAX_WITHOUT_KEY, ConnectionLimit, _received_bytes
from skyrange.io.zeromq.curve_keys import Keys
from skyrange.io.zeromq.transport import ZmqTransport
from skyrange.runtime.live.transport.control import ZmqControlClient, ZmqControlServer
from skyrange.runtime.live.transport.links import TcpListener

CROWD = 400
GREETING = bytes.fromhex("ff00000000000000017f03004e554c4c") + bytes(48)
READY = bytes.fromhex("041a0552454144590b536f636b65742d547970650000000644") + b"EALER"
HOLD = f"""
import socket, sys, time
greeting = bytes.fromhex(sys.argv[2])
own = []
for number in range({CROWD}):
    one = socket.create_connection(("127.0.0.1", int(sys.argv[1])), 5)
    try:
        one.sendall(greeting)
    except OSError:
        pass
    own.append(one)
print("there", flush=True)
time.sleep(60)
"""


@contextmanager
def crowd(port: int, greeting: bytes = b"") -> Iterator[subprocess.Popen[bytes]]:
    """Another process with `CROWD` connections to a port, each of which has sent `greeting` and sends no more."""
    arguments = [sys.executable, "-c", HOLD, str(port), greeting.hex()]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE) as process:
        try:
            yield process
        finally:
            process.kill()


async def all_there(process: subprocess.Popen[bytes]) -> None:
    assert process.stdout is not None
    assert await asyncio.to_thread(process.stdout.readline) == b"there\n"


async def until(holds: Callable[[], object], seconds: float = 20.0) -> None:
    async with asyncio.timeout(seconds):
        while not holds():
            await asyncio.sleep(0.02)


def open_files() -> int:
    return len(os.listdir("/proc/self/fd"))


@pytest.mark.parametrize(
    "greeting", [b"", b"\xff", GREETING, bytes(range(64))], ids=["silent", "slow", "ZMTP", "other"]
)
def test_the_control_socket_holds_few_strangers_and_lets_its_nodes_in(greeting: bytes) -> None:
    async def talk() -> None:
        (public, secret), (own, own_secret) = zmq.curve_keypair(), zmq.curve_keypair()
        server = ZmqControlServer(Keys(public, secret, frozenset({own})))
        server.open()
        before = open_files()
        with crowd(server.address[1], greeting) as process:
            await all_there(process)
            await until(lambda: open_files() < before + MAX_PENDING + 10)
            clients = [
                ZmqControlClient(f"n{n}", server.address, Keys(own, own_secret, frozenset({public}))) for n in range(3)
            ]
            for client in clients:
                client.open()
                await client.send("hello")
            async with asyncio.timeout(10):
                assert {(await server.receive())[0] for _ in clients} == {"n0", "n1", "n2"}
            assert greeting == bytes(range(64)) or server.refused >= CROWD - MAX_PENDING - 10
            for client in clients:
                client.close()
        server.close()

    asyncio.run(talk())


@pytest.mark.parametrize(
    ("greeting", "most"), [(b"", MAX_PENDING), (GREETING + READY, MAX_WITHOUT_KEY)], ids=["silent", "let in"]
)
def test_a_link_over_zeromq_holds_few_strangers_and_keeps_its_peer(greeting: bytes, most: int) -> None:
    async def talk() -> None:
        heard: list[bytes] = []
        server = await ZmqTransport.bind(lambda piece: heard.append(piece.data))
        client = await ZmqTransport.connect(lambda piece: heard.append(piece.data), server.address)
        await until(lambda: client.send(b"before"))
        await until(lambda: heard)
        before = open_files()
        with crowd(server.address[1], greeting) as process:
            await all_there(process)
            await until(lambda: open_files() < before + most + 10)
            assert client.send(b"after")
            await until(lambda: b"after" in heard)
            assert server.send(b"back")
            await until(lambda: b"back" in heard)
        client.close()
        server.close()

    asyncio.run(talk())


def test_a_stranger_gives_way_on_tcp_even_if_it_does_not_read() -> None:
    async def talk() -> None:
        with socket.socket() as tried:
            tried.bind(("127.0.0.1", 0))
            address = tried.getsockname()
        server = await TcpListener.open(lambda piece: None, address)
        before = open_files()
        with crowd(address[1]) as process:
            there = asyncio.create_task(all_there(process))
            while not there.done():
                server.send(bytes(280))
                await asyncio.sleep(0.001)
            await until(lambda: open_files() <= before + 3)
            peer = await TcpTransport.connect(lambda piece: None, address)
            await until(lambda: server.send(b"x"))
            peer.close()
        server.close()

    asyncio.run(talk())


def test_an_approval_service_answers_among_silent_clients() -> None:
    async def talk() -> None:
        asked: list[bytes] = []
        server = await HttpServerTransport.open(lambda piece: asked.append(piece.data))
        before = open_files()
        with crowd(server.address[1], b"PUT /x") as process:
            await all_there(process)
            await until(lambda: open_files() <= before + MAX_CONNECTIONS + 5)
            client = await HttpClientTransport.open(lambda piece: None, server.address)
            for _ in range(3):
                client.send(b'{"method":"PUT","path":"/x","body":{}}')
            await until(lambda: len(asked) >= 3)
            client.close()
        server.close()
        await asyncio.sleep(0.1)

    asyncio.run(talk())


def test_viewers_of_all_ports_together_are_limited() -> None:
    ports = ViewerPorts([0] * 40)
    try:
        own = []
        for _ in range(8):
            own += [socket.create_connection(("127.0.0.1", port), 5) for port in ports.numbers]
            ports.serve()
        for _ in range(10):
            ports.serve()
        assert ports.counts.viewers == 8 * 40
        assert ports.counts.displaced == 8 * 40 - 40 - MAX_MORE_VIEWERS
        for one in own:
            one.close()
    finally:
        ports.close()


def test_the_system_tells_how_much_a_connection_received() -> None:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        with socket.create_connection(listener.getsockname()) as client:
            server, _ = listener.accept()
            with server:
                assert _received_bytes(server.fileno()) == 0
                client.sendall(bytes(300))
                server.recv(300)
                assert _received_bytes(server.fileno()) == 300


def test_a_limit_survives_descriptors_that_are_none() -> None:
    limit = ConnectionLimit(with_keys=True)
    with Path("/dev/null").open() as file:
        for descriptor in (-1, 10_000, file.fileno()):
            limit.add(descriptor)
            limit.remove(descriptor)
    assert limit.shut_down == 0


@pytest.fixture
def few_files() -> Iterator[None]:
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (open_files() + 100, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_NOFILE, before)


def test_a_program_starts_when_strangers_have_taken_all_other_descriptors(few_files: None, tmp_path: Path) -> None:
    taken = []
    with suppress(OSError):
        while True:
            taken.append(os.open("/dev/null", os.O_RDONLY))
    try:
        limit = resource.getrlimit(resource.RLIMIT_NOFILE)
        program = Program("true", ["true"], tmp_path)
        program.kill()
        assert resource.getrlimit(resource.RLIMIT_NOFILE) == limit
        with spare_files():
            own = [os.open("/dev/null", os.O_RDONLY) for _ in range(SPARE_FILES)]
            with pytest.raises(OSError, match="Too many open files"):
                os.open("/dev/null", os.O_RDONLY)
        taken += own
    finally:
        for one in taken:
            os.close(one)


def test_the_reserve_is_kept_below_the_limit(few_files: None) -> None:
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    reserve_files()
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    assert soft == min(hard, 65_536) - SPARE_FILES
    with spare_files():
        assert resource.getrlimit(resource.RLIMIT_NOFILE)[0] == min(hard, 65_536)
