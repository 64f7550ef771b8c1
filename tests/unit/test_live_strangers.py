"""Strangers at the transports of a live range: the peer keeps its place, floods are dropped."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from skyrange.codec.mavlink.deframer import Piece
from skyrange.core.time import NS_PER_S
from skyrange.io.mavlink.transports import MAX_UNSENT_BYTES, TcpTransport, UdpTransport
from skyrange.runtime.live.node.node import BURST_S, BYTES_HZ, FRAMES_HZ, MAX_WAITING_BYTES, IngressRateLimiter
from skyrange.runtime.live.transport.links import TcpConnector, TcpListener

FRAME = mavlink.MAVLink(None, srcSystem=1).heartbeat_encode(2, 3, 0, 0, 3).pack(mavlink.MAVLink(None, srcSystem=1))


async def until(holds: Callable[[], object], seconds: float = 5.0) -> None:
    async with asyncio.timeout(seconds):
        while not holds():
            await asyncio.sleep(0.005)


def free_port() -> int:
    with socket.socket() as tried:
        tried.bind(("127.0.0.1", 0))
        return int(tried.getsockname()[1])


def test_a_tcp_peer_that_speaks_keeps_its_place_and_one_that_comes_back_has_it_again() -> None:
    async def live() -> None:
        heard: list[Piece] = []
        address = ("127.0.0.1", free_port())
        server = await TcpListener.open(heard.append, address)
        silent = await TcpTransport.connect(heard.append, address)  # a port scan
        await until(lambda: server.send(FRAME))
        got: list[Piece] = []
        peer = TcpConnector(got.append, address)
        await until(lambda: silent.lost.done())
        await until(lambda: peer.send(FRAME))
        await until(lambda: heard)
        for _ in range(5):
            stranger = await TcpTransport.connect(heard.append, address)
            stranger.send(FRAME)
            await until(stranger.lost.done)
        assert server.refused == 5
        assert server.send(FRAME)
        await until(lambda: got)
        peer.close()
        await until(lambda: not server.send(FRAME))
        anew = TcpConnector(got.append, address)
        await until(lambda: anew.send(FRAME))
        await until(lambda: len(heard) > 1)
        assert server.refused == 5
        anew.close()
        server.close()

    asyncio.run(live())


def test_a_tcp_peer_that_does_not_read_costs_no_more_than_a_buffer() -> None:
    async def live() -> None:
        address = ("127.0.0.1", free_port())
        server = await TcpListener.open(lambda _: None, address)
        with socket.socket() as slow:
            slow.connect(address)
            await until(lambda: server.send(FRAME))
            sent = 0
            while server.send(bytes(1000)) and sent < 100_000:
                sent += 1
            assert sent < 100_000
            assert server._peer is not None
            assert server._peer._transport is not None
            assert server._peer._transport.get_write_buffer_size() <= MAX_UNSENT_BYTES
        server.close()

    asyncio.run(live())


def test_a_udp_end_answers_who_spoke_mavlink_and_not_who_sent_anything_else() -> None:
    async def live() -> None:
        heard: list[Piece] = []
        station = await UdpTransport.open(heard.append)
        got: list[Piece] = []
        aircraft = await UdpTransport.open(got.append, remote=station.address)
        aircraft.send(FRAME)
        await until(lambda: heard)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.sendto(b"\xfd no frame", station.address)
            await until(lambda: len(heard) > 1)
            assert heard[-1].garbage
            station.send(FRAME)
            await until(lambda: got)
            # a caller sends where it was told to, whoever speaks to it
            stranger.sendto(FRAME, aircraft.address)
            await until(lambda: len(got) > 1)
            aircraft.send(FRAME)
            await until(lambda: len(heard) > 2)
        station.close()
        aircraft.close()

    asyncio.run(live())


def test_a_flood_on_one_link_is_dropped_and_harms_no_other() -> None:
    ingress = IngressRateLimiter()
    for _ in range(100_000):
        ingress.admit(NS_PER_S, "flooded", b"x")
    ingress.admit(NS_PER_S, "other", b"y")
    waiting = ingress.drain()
    assert len(waiting) == FRAMES_HZ * BURST_S + 1
    assert waiting[-1] == (NS_PER_S, "other", b"y")
    assert ingress.dropped == 100_000 - FRAMES_HZ * BURST_S
    for _ in range(100_000):
        ingress.admit(2 * NS_PER_S, "flooded", b"x")
    assert len(ingress.drain()) == FRAMES_HZ


@pytest.mark.parametrize("lanes", [1, 100])
def test_what_waits_is_bounded_in_bytes(lanes: int) -> None:
    ingress = IngressRateLimiter()
    big = bytes(1 << 20)
    for number in range(100 * lanes):
        ingress.admit(0, str(number % lanes), big)
    held = sum(len(data) for _, _, data in ingress.waiting)
    assert held == min(lanes * BURST_S * BYTES_HZ, MAX_WAITING_BYTES)
    assert ingress.dropped == 100 * lanes - held // len(big)
