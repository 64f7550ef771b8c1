"""Probe (f): one agent pair over the kernel's link, over real UDP and over TCP in arbitrary chunks: the same frames."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import pytest

from skyrange.codec.mavlink import Packer, Piece, decode, dialect
from skyrange.contracts.components import Agent
from skyrange.contracts.links import Channel, LinkSpec
from skyrange.contracts.mailboxes import Arrival, Inbox, Outbox
from skyrange.core.chance import Chance
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import NS_PER_S, Time
from skyrange.io.mavlink.transports import LOOPBACK, TcpTransport, UdpTransport, listen_tcp
from skyrange.kernel import Kernel, Wiring
from tests.probes.toys import MS, Log

LINK = "gcs:blue/b1"
PARAMETERS = 60


@dataclass
class Asker:
    """Asks for parameter after parameter; the next when the last was answered."""

    name: str = "blue.gcs"
    service_ns: Time = 0
    next_index: int = 0
    packer: Packer = field(default_factory=lambda: Packer(255, 190))

    def __post_init__(self) -> None:
        self.ports: Sequence[Port] = [Port(self.name, LINK)]

    def _ask(self, out: Outbox) -> None:
        message = dialect.MAVLink_param_request_read_message(1, 1, b"", self.next_index)
        out.send(self.ports[0], self.packer.pack(message))
        self.next_index += 1

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        out = Outbox()
        if self.next_index == 0:
            self._ask(out)
        for arrival in inbox:
            if decode(arrival.payload).param_index == self.next_index - 1 and self.next_index < PARAMETERS:
                self._ask(out)
        return out

    def next_wakeup(self) -> Time | None:
        return 0 if self.next_index == 0 else None


@dataclass
class Answerer:
    """Answers each request with that parameter's value, and with noise before every seventh."""

    name: str = "blue/b1.companion"
    service_ns: Time = 0
    packer: Packer = field(default_factory=lambda: Packer(1, 1))

    def __post_init__(self) -> None:
        self.ports: Sequence[Port] = [Port(self.name, LINK)]

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        out = Outbox()
        for arrival in inbox:
            index = decode(arrival.payload).param_index
            name = f"P{index}".encode()
            out.send(
                self.ports[0],
                self.packer.pack(dialect.MAVLink_param_value_message(name, index * 0.5, 9, PARAMETERS, index)),
            )
        return out

    def next_wakeup(self) -> Time | None:
        return None


class End(Protocol):
    def send(self, payload: bytes) -> bool: ...
    def close(self) -> None: ...


class Seat:
    """Drives one agent from a socket: the agent's code is the one that ran in the kernel."""

    def __init__(self, agent: Agent) -> None:
        self.agent = agent
        self.end: End | None = None
        self.heard: list[bytes] = []
        self.garbage = 0
        self.now: Time = 0
        self.done = asyncio.Event()

    def on_piece(self, piece: Piece) -> None:
        if piece.garbage:
            self.garbage += len(piece.data)
            return
        self.heard.append(piece.data)
        ref = FrameId(LINK, "rev", "peer", len(self.heard))
        self._step(Inbox([Arrival(self.agent.ports[0], self.now, piece.data, "peer", ref)]))
        if len(self.heard) == PARAMETERS:
            self.done.set()

    def start(self) -> None:
        self._step(Inbox())

    def _step(self, inbox: Inbox) -> None:
        self.now += MS
        assert self.end is not None
        for departure in self.agent.step(self.now, inbox).each(self.agent.ports):
            assert self.end.send(departure.payload)


def in_virtual_time() -> tuple[list[bytes], list[bytes]]:
    log = Log()
    link = LinkSpec(LINK, "blue.gcs", "blue/b1.companion", Channel(latency_ns=5 * MS))
    kernel = Kernel(Wiring(seed=1, links=[link], agents=[Asker(), Answerer()]), [log])
    kernel.advance(NS_PER_S)
    rows = log.table()
    return [r[9] for r in rows if r[2] == "fwd"], [r[9] for r in rows if r[2] == "rev"]


async def over_udp() -> tuple[Seat, Seat]:
    asker, answerer = Seat(Asker()), Seat(Answerer())
    answerer.end = await UdpTransport.open(answerer.on_piece)
    asker.end = await UdpTransport.open(asker.on_piece, remote=answerer.end.address)
    asker.start()
    async with asyncio.timeout(20):
        await asker.done.wait()
    asker.end.close()
    answerer.end.close()
    return asker, answerer


async def rechunk(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, name: str, noise: bytes) -> None:
    """Pass a stream on in pieces of 1 to 9 bytes that have nothing to do with frames, `noise` first."""
    chance = Chance(12)
    writer.write(noise)
    count = 0
    while data := await reader.read(4096):
        while data:
            size = 1 + int(9 * chance.uniform4(name, 0, count)[0])
            count += 1
            writer.write(data[:size])
            await writer.drain()
            await asyncio.sleep(0)
            data = data[size:]
    writer.close()


async def over_tcp(noise: bytes) -> tuple[Seat, Seat]:
    asker, answerer = Seat(Asker()), Seat(Answerer())

    def accept() -> TcpTransport:
        answerer.end = TcpTransport(answerer.on_piece)
        return answerer.end

    server, address = await listen_tcp(accept)

    async def relay(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        far_reader, far_writer = await asyncio.open_connection(*address)
        await asyncio.gather(rechunk(reader, far_writer, "there", noise), rechunk(far_reader, writer, "back", noise))

    middle = await asyncio.start_server(relay, LOOPBACK, 0)
    asker.end = await TcpTransport.connect(asker.on_piece, middle.sockets[0].getsockname()[:2])
    asker.start()
    async with asyncio.timeout(20):
        await asker.done.wait()
    asker.end.close()
    async with asyncio.timeout(20):
        await asker.end.lost
    middle.close()
    server.close()
    return asker, answerer


@pytest.mark.parametrize(
    ("transport", "garbage"),
    [(over_udp, 0), (lambda: over_tcp(b""), 0), (lambda: over_tcp(b"\xfdnoise\xfe\x00\xff"), 9)],
    ids=["udp", "tcp", "tcp with noise"],
)
def test_the_same_frames_over_every_transport(
    transport: Callable[[], Coroutine[Any, Any, tuple[Seat, Seat]]], garbage: int
) -> None:
    asked, answered = in_virtual_time()
    assert len(asked) == len(answered) == PARAMETERS
    asker, answerer = asyncio.run(transport())
    assert answerer.heard == asked
    assert asker.heard == answered
    assert (answerer.garbage, asker.garbage) == (garbage, garbage)


def test_half_a_datagram_is_garbage_and_not_the_start_of_the_next() -> None:
    frame = Packer(1, 1).pack(dialect.MAVLink_param_value_message(b"P", 1.0, 9, 1, 0))

    async def exchange() -> tuple[list[Piece], UdpTransport]:
        got: list[Piece] = []
        listener = await UdpTransport.open(got.append)
        sender = await UdpTransport.open(got.append, remote=listener.address)
        for data in (frame[:10], frame, frame[10:]):
            sender.send(data)
        async with asyncio.timeout(10):
            while len(got) < 3:
                await asyncio.sleep(0.001)
        sender.close()
        listener.close()
        return got, listener

    got, listener = asyncio.run(exchange())
    assert [(piece.data, piece.garbage) for piece in got] == [(frame[:10], True), (frame, False), (frame[10:], True)]
    assert listener.counts.frames == 1
