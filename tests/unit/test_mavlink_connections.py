"""Wires to autopilots that run anyway: real sockets and a pseudo-terminal, cut and mended."""

from __future__ import annotations

import os
import pty
import socket
import time
import tty
from collections.abc import Callable

import pytest

import skyrange.io.mavlink.connections as wires
from skyrange.codec.mavlink import Packer
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.deframer import Piece
from skyrange.core.errors import InputError
from skyrange.io.mavlink.connections import Address, MavlinkConnection, make_connection

BEAT = Packer(1, 1).pack(mav.MAVLink_heartbeat_message(2, 3, 81, 0, 3, 3))
ASK = Packer(255, 190).pack(mav.MAVLink_param_request_list_message(1, 1))


@pytest.fixture(autouse=True)
def _soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wires, "RETRY_S", 0.02)


def read_until(wire: MavlinkConnection, holds: Callable[[list[Piece]], bool]) -> list[Piece]:
    pieces: list[Piece] = []
    deadline = time.monotonic() + 5.0
    while not holds(pieces):
        assert time.monotonic() < deadline, (wire.trouble, pieces)
        pieces += wire.read()
        time.sleep(0.001)
    return pieces


def frames(pieces: list[Piece]) -> list[bytes]:
    return [piece.data for piece in pieces if not piece.garbage]


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("tcp:127.0.0.1:5760", Address("tcp", "127.0.0.1", 5760)),
        ("tcp:[::1]:5760", Address("tcp", "::1", 5760)),
        ("udpin:0.0.0.0:14550", Address("udpin", "0.0.0.0", 14550)),
        ("udpout:localhost:1", Address("udpout", "localhost", 1)),
        ("serial:/dev/ttyACM0:57600", Address("serial", "/dev/ttyACM0", 57600)),
        ("serial:/dev/serial/by-path/a:b:57600", Address("serial", "/dev/serial/by-path/a:b", 57600)),
    ],
)
def test_addresses(text: str, address: Address) -> None:
    assert Address.of(text) == address
    assert str(address) == text


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("tpc:127.0.0.1:5760", "Did you mean 'tcp'"),
        ("", "tcp:ADDRESS:PORT"),
        ("tcp:127.0.0.1", "tcp:ADDRESS:PORT"),
        ("tcp:127.0.0.1:0", "tcp:ADDRESS:PORT"),
        ("tcp:127.0.0.1:65536", "tcp:ADDRESS:PORT"),
        ("tcp:127.0.0.1:٥", "tcp:ADDRESS:PORT"),
        ("tcp::5760", "tcp:ADDRESS:PORT"),
        ("udpout:drone.example:14550", "an IP address"),
        ("serial:/dev/ttyACM0", "serial:DEVICE:BAUD"),
        ("serial:/dev/ttyACM0:fast", "serial:DEVICE:BAUD"),
    ],
)
def test_what_is_no_address(text: str, told: str) -> None:
    with pytest.raises(InputError, match=told):
        Address.of(text)


def test_tcp_waits_for_a_listener_is_cut_and_comes_back() -> None:
    server = socket.socket()
    server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    server.bind(("127.0.0.1", 0))
    server.settimeout(5.0)
    wire = make_connection(Address("tcp", "127.0.0.1", server.getsockname()[1]))
    assert not wire.write(ASK)
    read_until(wire, lambda _: "refused" in wire.trouble)
    server.listen()
    for _ in range(2):
        read_until(wire, lambda _: wire.connected)
        peer, _ = server.accept()
        with peer:
            peer.sendall(b"noise" + BEAT[:10])
            peer.sendall(BEAT[10:])
            pieces = read_until(wire, lambda got: bool(frames(got)))
            assert [piece.data for piece in pieces] == [b"noise", BEAT]
            assert wire.write(ASK)
            assert peer.recv(100) == ASK
        read_until(wire, lambda _: not wire.connected)
    wire.close()
    wire.close()
    server.close()


def test_a_peer_that_does_not_read_costs_frames_and_no_memory_and_never_half_a_frame() -> None:
    server = socket.socket()
    server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    server.bind(("127.0.0.1", 0))
    server.listen()
    wire = make_connection(Address("tcp", "127.0.0.1", server.getsockname()[1]))
    read_until(wire, lambda _: wire.connected)
    peer, _ = server.accept()
    taken = 0
    while wire.write(ASK):
        taken += 1
    assert 0 < taken < 10_000_000
    assert wire.unsent == 1
    peer.settimeout(0.2)
    got = b""
    while len(got) < taken * len(ASK):
        got += peer.recv(1 << 20)
        wire.write(ASK)
    assert got.startswith(ASK * taken), "what was begun is ended before the next begins"
    wire.close()
    peer.close()
    server.close()


def test_udp_that_listens_keeps_to_whoever_spoke_mavlink_first() -> None:
    first, second = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    wire = make_connection(Address("udpin", "127.0.0.1", port))
    wire.read()
    assert wire.trouble == "nobody has called"
    second.sendto(b"hello", ("127.0.0.1", port))
    read_until(wire, bool)
    assert not wire.connected
    first.sendto(BEAT[:-1], ("127.0.0.1", port))
    first.sendto(BEAT, ("127.0.0.1", port))
    assert frames(read_until(wire, lambda got: bool(frames(got)))) == [BEAT]
    second.sendto(BEAT, ("127.0.0.1", port))
    read_until(wire, lambda _: wire.strangers == 1)
    assert wire.write(ASK)
    first.settimeout(2.0)
    assert first.recv(100) == ASK
    wire.again("quiet")
    read_until(wire, lambda _: wire.trouble == "nobody has called")
    second.sendto(BEAT, ("127.0.0.1", port))
    read_until(wire, lambda _: wire.connected)
    wire.close()
    first.close()
    second.close()


def test_udp_that_calls_speaks_first_and_outlives_a_refusal() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as there:
        there.bind(("127.0.0.1", 0))
        place = there.getsockname()
    wire = make_connection(Address("udpout", *place))
    wire.read()
    assert wire.write(ASK)
    read_until(wire, lambda _: wire.write(ASK))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as there:
        there.bind(place)
        there.settimeout(2.0)
        assert wire.write(ASK)
        assert wire.write(ASK)  # the first may have met the refusal of the one before
        data, peer = there.recvfrom(100)
        assert data == ASK
        there.sendto(BEAT, peer)
        assert frames(read_until(wire, lambda got: bool(frames(got)))) == [BEAT]
    wire.close()


def test_serial_device_is_read_written_pulled_out_and_plugged_in_again(tmp_path: os.PathLike[str]) -> None:
    pytest.importorskip("serial")
    device = os.path.join(tmp_path, "ttyTEST")
    wire = make_connection(Address("serial", device, 57600))
    read_until(wire, lambda _: "no such file" in wire.trouble)
    for _ in range(2):
        master, slave = pty.openpty()
        tty.setraw(master)
        os.symlink(os.ttyname(slave), device)
        read_until(wire, lambda _: wire.connected)
        os.write(master, BEAT + BEAT[:5])
        os.write(master, BEAT[5:])
        assert frames(read_until(wire, lambda got: len(frames(got)) == 2)) == [BEAT, BEAT]
        assert wire.write(ASK)
        assert os.read(master, 100) == ASK
        os.unlink(device)
        os.close(slave)
        os.close(master)
        read_until(wire, lambda _: not wire.connected)
    wire.close()


def test_a_serial_device_that_takes_nothing_holds_nobody_up(tmp_path: os.PathLike[str]) -> None:
    pytest.importorskip("serial")
    master, slave = pty.openpty()
    tty.setraw(master)
    wire = make_connection(Address("serial", os.ttyname(slave), 57600))
    read_until(wire, lambda _: wire.connected)
    began = time.monotonic()
    taken = 0
    while wire.write(ASK):
        taken += 1
        assert taken < 1_000_000
    assert time.monotonic() - began < 2.0
    wire.close()
    os.close(slave)
    os.close(master)
