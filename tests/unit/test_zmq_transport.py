"""Links over ZeroMQ: payloads whole and in order; peers come, go and hold the right key; hostile bytes."""

from __future__ import annotations

import asyncio
import socket
import stat
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import zmq
import zmq.auth
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from skyrange.codec.mavlink.deframer import Piece
from skyrange.core.errors import InputError
from skyrange.io.mavlink.transports import LOOPBACK, Address
from skyrange.io.zeromq import context as zmq_room
from skyrange.io.zeromq import transport as zmq_sockets
from skyrange.io.zeromq.context import AT_ONCE
from skyrange.io.zeromq.curve_keys import Keys, load_keys, make_keys
from skyrange.io.zeromq.transport import ZmqTransport


class Heard:
    """What one end was told."""

    def __init__(self) -> None:
        self.frames: list[bytes] = []
        self.garbage: list[bytes] = []
        self.notes: list[tuple[str, str]] = []

    def on_piece(self, piece: Piece) -> None:
        (self.garbage if piece.garbage else self.frames).append(piece.data)

    def on_note(self, kind: str, detail: str) -> None:
        self.notes.append((kind, detail))

    def kinds(self) -> list[str]:
        return [kind for kind, _ in self.notes]


def run(body: Callable[[], Awaitable[None]]) -> None:
    async def bounded() -> None:
        async with asyncio.timeout(20):
            await body()

    asyncio.run(bounded())
    assert not zmq_room._CONTEXTS  # every end was closed, and the last one took the context along


async def until(condition: Callable[[], object]) -> None:
    async with asyncio.timeout(8):
        while not condition():
            await asyncio.sleep(0.002)


async def bind(heard: Heard, local: Address = (LOOPBACK, 0), keys: Keys | None = None) -> ZmqTransport:
    return await ZmqTransport.bind(heard.on_piece, local, keys=keys, on_note=heard.on_note)


async def bind_again(heard: Heard, local: Address) -> ZmqTransport:
    """As soon as the port is free."""
    while True:
        try:
            return await bind(heard, local)
        except OSError:
            await asyncio.sleep(0.002)


async def connect(heard: Heard, remote: Address, keys: Keys | None = None) -> ZmqTransport:
    return await ZmqTransport.connect(heard.on_piece, remote, keys=keys, on_note=heard.on_note)


@contextmanager
def foreign(address: Address, kind: int = zmq.DEALER) -> Iterator[zmq.Socket[bytes]]:
    """Another program's socket."""
    with zmq.Context() as context, context.socket(kind) as line:
        line.linger = 0
        line.connect(f"tcp://{address[0]}:{address[1]}")
        yield line


def free_port() -> int:
    with socket.socket() as line:
        line.bind((LOOPBACK, 0))
        return int(line.getsockname()[1])


def key_rings(folder: Path) -> dict[str, tuple[Path, Path]]:
    return {name: make_keys(folder, name) for name in ("oracle", "blue", "mallory")}


# --- frames ---------------------------------------------------------------------------------------


def test_payloads_cross_whole_and_in_order_both_ways() -> None:
    async def body() -> None:
        one, two = Heard(), Heard()
        a = await bind(one)
        b = await connect(two, a.address)
        assert not a.connected
        await until(lambda: a.connected and b.connected)
        there = [bytes([n % 251]) * (1 + n * 37 % 3_000) for n in range(600)] + [b"x" * zmq_sockets.MAX_BYTES]
        back = [b"back %d" % n for n in range(600)]
        for forth, answer in zip(there, back, strict=False):
            assert b.send(forth)
            assert a.send(answer)
        assert b.send(there[-1])
        await until(lambda: len(one.frames) == 601 and len(two.frames) == 600)
        assert one.frames == there
        assert two.frames == back
        assert (one.garbage, two.garbage) == ([], [])
        assert (a.counts.frames, a.counts.sent, a.counts.connections) == (601, 600, 1)
        assert one.kinds() == two.kinds() == ["connected"]
        a.close()
        b.close()
        assert not a.send(b"x")

    run(body)


def test_who_connects_may_start_first() -> None:
    async def body() -> None:
        one, two = Heard(), Heard()
        b = await connect(two, (LOOPBACK, free_port()))
        assert not b.send(b"early")
        assert b.counts.unsent == 1
        a = await bind(one, b.address)
        await until(lambda: a.connected and b.connected)
        assert b.send(b"now")
        await until(lambda: one.frames)
        assert one.frames == [b"now"]
        a.close()
        b.close()

    run(body)


@pytest.mark.parametrize("who", ["who binds", "who connects"])
def test_what_was_sent_before_close_arrives(who: str) -> None:
    async def body() -> None:
        one, two = Heard(), Heard()
        a = await bind(one)
        b = await connect(two, a.address)
        await until(lambda: a.connected and b.connected)
        closes, stays, heard = (a, b, two) if who == "who binds" else (b, a, one)
        for n in range(500):
            assert closes.send(b"%d" % n)
        closes.close()
        # nobody reads while this call blocks: what came must not be thrown away with the connection
        stays._monitor.poll(150)
        await until(lambda: len(heard.frames) == 500)
        assert heard.frames == [b"%d" % n for n in range(500)]
        stays.close()

    for _ in range(4):  # it is a race, which is lost now and then where it can be
        run(body)


def test_either_side_may_start_anew() -> None:
    async def body() -> None:
        one, two, three, four = Heard(), Heard(), Heard(), Heard()
        a = await bind(one)
        b = await connect(two, a.address)
        await until(lambda: a.connected and b.connected)
        a.close()
        await until(lambda: not b.connected)
        assert not b.send(b"to nobody")
        a = await bind_again(three, b.address)
        await until(lambda: a.connected and b.connected)
        assert a.send(b"again")
        assert b.send(b"here")
        await until(lambda: two.frames and three.frames)
        assert two.kinds() == ["connected", "disconnected", "connected"]
        b.close()
        await until(lambda: not a.connected)
        assert not a.send(b"to nobody")
        b = await connect(four, a.address)
        await until(lambda: a.connected and b.connected)
        assert a.send(b"and again")
        await until(lambda: four.frames)
        assert (two.frames, three.frames, four.frames) == ([b"again"], [b"here"], [b"and again"])
        assert (a.counts.unsent, b.counts.unsent, a.counts.refused) == (1, 0, 0)
        a.close()
        b.close()

    run(body)


def test_a_peer_that_comes_while_the_old_one_hangs_is_the_peer() -> None:
    async def body() -> None:
        one, old, new = Heard(), Heard(), Heard()
        a = await bind(one)
        b = await connect(old, a.address)
        await until(lambda: a.connected and b.connected)
        c = await connect(new, a.address)
        await until(lambda: a.counts.connections == 2 and c.connected)
        assert c.send(b"hello")
        await until(lambda: one.frames)
        for n in range(10):
            assert a.send(b"%d" % n)
        await until(lambda: len(new.frames) == 10)
        assert old.frames == []
        b.close()
        await until(lambda: a._connections == 1)
        assert a.connected
        assert a.send(b"still")
        await until(lambda: len(new.frames) == 11)
        for end in (a, c):
            end.close()

    run(body)


def test_when_a_later_peer_leaves_the_one_before_is_the_peer_again() -> None:
    async def body() -> None:
        one, two, three = Heard(), Heard(), Heard()
        a = await bind(one)
        b = await connect(two, a.address)
        await until(lambda: a.connected and b.connected)
        stranger = await connect(three, a.address)
        await until(lambda: a.counts.connections == 2 and stranger.connected)
        assert stranger.send(b"mine")
        await until(lambda: one.frames)
        assert a.send(b"to the stranger")
        await until(lambda: three.frames)
        stranger.close()
        await until(lambda: a._connections == 1)
        assert a.send(b"to the peer")
        await until(lambda: two.frames)
        assert two.frames == [b"to the peer"]
        for end in (a, b):
            end.close()

    run(body)


# --- bounds and hostile bytes ---------------------------------------------------------------------


def test_a_slow_reader_costs_no_more_than_its_queue() -> None:
    async def body() -> None:
        one = Heard()
        a = await ZmqTransport.bind(one.on_piece, queue=8)
        with foreign(a.address) as line:
            line.rcvhwm = 1  # of this and later connections
            line.send(b"I am here")
            await until(lambda: one.frames)
            payload = b"x" * 60_000
            sent = 0
            while a.send(payload):
                sent += 1
                assert sent < 2_000
                await asyncio.sleep(0)
            assert a.counts.overflowed == 1
            assert a.counts.sent == sent
            got = 0
            while line.poll(500):
                assert line.recv() == payload
                got += 1
            assert got == sent  # what it said yes to, arrives
            assert a.send(payload)
        a.close()

    run(body)


def test_what_is_no_single_payload_is_garbage() -> None:
    async def body() -> None:
        one = Heard()
        a = await bind(one)
        with foreign(a.address) as line:
            line.send(b"")  # announces itself
            line.send(b"")
            line.send_multipart([b"a", b"b", b""])
            line.send_multipart([b"", b"body"])  # as a REQ does
            line.send(b"good")
            await until(lambda: one.frames)
            assert one.frames == [b"good"]
            assert one.garbage == [b"ab", b"body"]
            assert (a.counts.garbage, a.counts.garbage_bytes) == (3, 6)
            assert a.send(b"answer")
            assert line.recv() == b"answer"
        a.close()

    run(body)


def test_what_is_too_long_is_not_sent_and_not_taken() -> None:
    async def body() -> None:
        one, two = Heard(), Heard()
        a = await ZmqTransport.bind(one.on_piece, max_bytes=100)
        b = await connect(two, a.address)
        await until(lambda: a.connected and b.connected)
        assert not a.send(b"x" * 101)
        assert not a.send(b"")
        assert a.counts.unfit == 2
        assert b.send(b"x" * 101)  # it does not know better, and is cut off
        await until(lambda: two.kinds()[:2] == ["connected", "disconnected"])
        await until(lambda: a.connected and b.connected)
        assert b.send(b"x" * 100)
        await until(lambda: one.frames)
        assert one.frames == [b"x" * 100]
        a.close()
        b.close()

    run(body)


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    st.lists(
        st.tuples(
            st.sampled_from(
                [
                    b"",
                    b"\xff\0\0\0\0\0\0\0\x01\x7f",
                    # greeting of ZMTP 3.1 with mechanism NULL, and with it half a command
                    b"\xff\0\0\0\0\0\0\0\x01\x7f\x03\x01NULL" + bytes(48),
                    b"\xff\0\0\0\0\0\0\0\x01\x7f\x03\x01CURVE" + bytes(47),
                    b"\x01\x00\x05\x00hell",
                ]
            ),
            st.binary(max_size=300),
        ),
        min_size=1,
        max_size=6,
    )
)
def test_random_bytes_are_refused_and_survived(runs: list[tuple[bytes, bytes]]) -> None:
    async def body() -> None:
        one, two = Heard(), Heard()
        a = await bind(one)
        b = await connect(two, a.address)
        await until(lambda: a.connected and b.connected)
        for head, tail in runs:
            _, writer = await asyncio.open_connection(*a.address)
            writer.write(head + tail)
            writer.close()
        await until(lambda: a.counts.refused == len(runs))
        assert a.connected
        assert b.send(b"well")
        assert a.send(b"fine")
        await until(lambda: one.frames and two.frames)
        assert (one.frames, one.garbage, two.frames) == ([b"well"], [], [b"fine"])
        a.close()
        b.close()

    run(body)


def test_a_flood_leaves_others_their_turn() -> None:
    async def body() -> None:
        one = Heard()
        a = await bind(one)
        turns = 0
        with foreign(a.address) as line:
            line.sndhwm = 0
            for n in range(20_000):
                line.send(b"%d" % n)
            while len(one.frames) < 20_000:
                turns += 1
                await asyncio.sleep(0)
            assert turns >= 20_000 // AT_ONCE // 3
            assert one.frames == [b"%d" % n for n in range(20_000)]
        a.close()

    run(body)


def test_an_end_may_be_closed_by_whom_it_tells() -> None:
    async def body() -> None:
        ends: list[ZmqTransport] = []
        a = await ZmqTransport.bind(lambda piece: ends[0].close())
        ends.append(a)
        with foreign(a.address) as line:
            line.send_multipart([b"close"])
            line.send_multipart([b"closed"])
            await until(lambda: a._closed)
        a.close()
        assert a.counts.frames == 1

    run(body)


# --- keys -----------------------------------------------------------------------------------------


def test_with_the_right_keys_a_link_works(tmp_path: Path) -> None:
    async def body() -> None:
        rings = key_rings(tmp_path)
        one, two = Heard(), Heard()
        a = await bind(one, keys=Keys.load(rings["oracle"][1], [rings["blue"][0], rings["mallory"][0]]))
        b = await connect(two, a.address, Keys.load(rings["blue"][1], [rings["oracle"][0]]))
        await until(lambda: a.connected and b.connected)
        assert b.send(b"secret")
        assert a.send(b"whisper")
        await until(lambda: one.frames and two.frames)
        assert (one.frames, two.frames, a.counts.refused) == ([b"secret"], [b"whisper"], 0)
        a.close()
        b.close()

    run(body)


@pytest.mark.parametrize("who", ["a key that is not allowed", "another server's key", "no key", "no ZeroMQ"])
def test_without_the_right_key_a_peer_is_refused_and_noted(who: str, tmp_path: Path) -> None:
    async def body() -> None:
        rings = key_rings(tmp_path)
        one, two, three = Heard(), Heard(), Heard()
        a = await bind(one, keys=Keys.load(rings["oracle"][1], [rings["blue"][0]]))
        b: ZmqTransport | None = None
        if who == "no ZeroMQ":
            _, writer = await asyncio.open_connection(*a.address)
            writer.write(b"GET / HTTP/1.1\r\n\r\n" * 10)
            writer.close()
        elif who == "no key":
            b = await connect(two, a.address)
        else:
            own, other = ("mallory", "oracle") if who == "a key that is not allowed" else ("blue", "mallory")
            b = await connect(two, a.address, Keys.load(rings[own][1], [rings[other][0]]))
        await until(lambda: one.notes)
        assert one.kinds()[0] == "refused"
        assert f":{a.address[1]}" in one.notes[0][1]
        assert not a.connected
        assert not a.send(b"secret")
        if b is not None:
            await until(lambda: "refused" in two.kinds())
            assert not b.send(b"poison")
            b.close()
        c = await connect(three, a.address, Keys.load(rings["blue"][1], [rings["oracle"][0]]))
        await until(lambda: a.connected and c.connected)
        assert a.send(b"secret")
        await until(lambda: three.frames)
        assert (one.frames, two.frames, a.counts.connections) == ([], [], 1)
        a.close()
        c.close()

    run(body)


def test_two_ends_of_a_process_let_different_peers_in(tmp_path: Path) -> None:
    async def body() -> None:
        rings = key_rings(tmp_path)
        for_blue, open_to_all, blue, mallory = Heard(), Heard(), Heard(), Heard()
        a = await bind(for_blue, keys=Keys.load(rings["oracle"][1], [rings["blue"][0]]))
        b = await bind(open_to_all)
        c = await connect(blue, a.address, Keys.load(rings["blue"][1], [rings["oracle"][0]]))
        d = await connect(mallory, b.address)
        await until(lambda: a.connected and b.connected and c.connected and d.connected)
        assert a.counts.refused == b.counts.refused == 0
        for end in (a, b, c, d):
            end.close()

    run(body)


def test_key_files_are_their_owners_alone_and_zeromqs_own(tmp_path: Path) -> None:
    folder = tmp_path / "keys"
    public, secret = make_keys(folder, "blue")
    assert [path.name for path in (public, secret)] == ["blue.key", "blue.key_secret"]
    assert [stat.S_IMODE(path.stat().st_mode) for path in (folder, public, secret)] == [0o700, 0o600, 0o600]
    assert load_keys(secret) == zmq.auth.load_certificate(secret)
    assert load_keys(public) == zmq.auth.load_certificate(public)
    assert load_keys(public).secret is None
    keys = Keys.load(secret, [public])
    assert keys.peers == {keys.public}
    assert keys.secret.decode() not in repr(keys)
    before = secret.read_bytes()
    with pytest.raises(InputError, match=r"blue\.key: is there already"):
        make_keys(folder, "blue")
    assert secret.read_bytes() == before
    secret.rename(folder / "red.key_secret")
    with pytest.raises(InputError, match=r"red\.key_secret: is there already"):
        make_keys(folder, "red")
    assert not (folder / "red.key").exists()
    with pytest.raises(InputError, match="letters, digits"):
        make_keys(folder, "../blue")
    with pytest.raises(InputError, match="a folder that can be written to"):
        make_keys(public, "blue")


def test_what_is_no_key_file_is_named(tmp_path: Path) -> None:
    public, secret = make_keys(tmp_path, "blue")
    other = load_keys(make_keys(tmp_path, "red")[0]).public
    with pytest.raises(InputError, match=r"nothing\.key: no such file.*skyrange keys"):
        load_keys(tmp_path / "nothing.key")
    with pytest.raises(InputError, match="only a public key"):
        Keys.load(public, [public])
    bad = tmp_path / "bad.key"
    for content, problem in [
        (b"", "no public-key"),
        (b"\xff" * 5_000, "no public-key"),
        (b'public-key = "short"\n', "public-key: 5 bytes that are no key"),
        (b"x" * 70_000, "more than 65536 bytes"),
        (secret.read_bytes().replace(load_keys(public).public, other), "not the secret-key's"),
    ]:
        bad.write_bytes(content)
        bad.chmod(0o600)
        with pytest.raises(InputError, match=problem):
            load_keys(bad)
    secret.chmod(0o640)
    with pytest.raises(InputError, match=r"permissions 0640.*chmod 600"):
        load_keys(secret)


@given(st.binary(max_size=400))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
def test_any_bytes_are_a_key_file_or_an_error(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "any.key"
    path.write_bytes(b"public-key = " + data)
    try:
        key = load_keys(path).public
    except InputError:
        return
    assert len(key) == 40


# --- addresses ------------------------------------------------------------------------------------


def test_a_port_in_use_is_named() -> None:
    async def body() -> None:
        heard = Heard()
        a = await bind(heard)
        with pytest.raises(OSError, match=f"{LOOPBACK}:{a.address[1]}: address already in use"):
            await bind(heard, a.address)
        b = await connect(heard, a.address)  # the failure took nothing from the others
        await until(lambda: a.connected and b.connected)
        a.close()
        b.close()

    run(body)


def test_beyond_loopback_it_takes_keys(tmp_path: Path) -> None:
    async def body() -> None:
        rings = key_rings(tmp_path)
        for make in (ZmqTransport.bind, ZmqTransport.connect):
            with pytest.raises(InputError, match=r"192\.0\.2\.1:5555.*loopback.*keys"):
                await make(lambda _: None, ("192.0.2.1", 5555))
        keys = Keys.load(rings["oracle"][1], [rings["blue"][0], rings["mallory"][0]])
        with pytest.raises(InputError, match="2 peers' keys"):
            await ZmqTransport.connect(lambda _: None, (LOOPBACK, 5555), keys=keys)
        end = await ZmqTransport.bind(lambda _: None, ("0.0.0.0", 0), keys=keys)
        assert end.address[0] == "0.0.0.0"
        end.close()

    run(body)
