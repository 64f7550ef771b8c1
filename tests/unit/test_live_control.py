"""What nodes, machines and supervisor of a live range say to each other, and who may say anything."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
import zmq
from hypothesis import given
from hypothesis import strategies as st

from skyrange.core.errors import ComponentError, InputError
from skyrange.io.curve_keys import Keys, load_member, load_range, make_range_keys
from skyrange.runtime.live.addresses import crossings
from skyrange.runtime.live.clock import JUMP_NS, Echo, Offset, best
from skyrange.runtime.live.control import CHUNK_BYTES, MOST_BYTES, ControlServer, ControlClient, packed, unpacked
from skyrange.runtime.live.files import chunks, inside, listed, read_chunk, write_chunk
from skyrange.runtime.live.orders import NodeConfig
from skyrange.runtime.live.passes import issue
from skyrange.runtime.live.plan import plan
from skyrange.scenario.catalogue import load
from skyrange.scenario.wire import wire

MS = 1_000_000


def test_orders_survive_their_file() -> None:
    links = wire(load("rid-spoofing")).wiring.links
    places = crossings(links, plan(links, "component"))
    passes = issue(zmq.curve_keypair()[0])
    orders = NodeConfig("world", ("oracle",), ".parts/world", "127.0.0.1", ("127.0.0.1", 1), tuple(places), passes)
    assert NodeConfig.from_json(orders.to_json()) == orders


@given(st.binary(max_size=200))
def test_control_survives_any_bytes(data: bytes) -> None:
    said = unpacked(data)
    assert said is None or isinstance(said["kind"], str)


def test_control_takes_objects_of_a_kind_and_nothing_else() -> None:
    assert unpacked(packed("status", now_ns=5)) == {"kind": "status", "now_ns": 5}
    for wrong in (b"[]", b'{"kind": 3}', b"{}", b"nonsense", b"[" * 5000, packed("x", y="z" * MOST_BYTES)):
        assert unpacked(wrong) is None


def within(seconds: float, talk: Callable[[], Awaitable[Any]]) -> Any:
    async def timed() -> Any:
        async with asyncio.timeout(seconds):
            return await talk()

    return asyncio.run(timed())


def test_supervisor_and_node_hear_each_other() -> None:
    (public, secret), passes = (pair := zmq.curve_keypair()), issue(pair[0])

    async def talk() -> tuple[Any, ...]:
        desk = ControlServer(Keys(public, secret, frozenset({passes.desk.public})))
        desk.open()
        phone = ControlClient("blue.gcs", desk.address, passes.desk)
        phone.open()
        try:
            await phone._socket.send(b"no message")
            await phone.tell("chunk", b"\0\xff", at=3)
            heard = await desk.hear()
            await desk.tell("nobody", "stop")
            await desk.tell(heard[0], "start", zero_ns=7)
            return heard, await phone.hear(), desk.strange
        finally:
            phone.close()
            desk.close()

    heard, answer, strange = within(5.0, talk)
    assert heard == ("blue.gcs", {"kind": "chunk", "at": 3}, b"\0\xff")
    assert answer == ({"kind": "start", "zero_ns": 7}, b"")
    assert strange == 1


def test_who_has_another_key_is_refused_and_counted() -> None:
    (public, secret), passes = (pair := zmq.curve_keypair()), issue(pair[0])
    unknown = zmq.curve_keypair()
    stranger = Keys(*unknown, frozenset({public}))
    misled = Keys(passes.desk.public, passes.desk.secret, frozenset({unknown[0]}))

    async def talk() -> tuple[int, int, int, int]:
        desk = ControlServer(Keys(public, secret, frozenset({passes.desk.public})))
        desk.open()
        phones = [ControlClient(name, desk.address, keys) for name, keys in (("blue.gcs", stranger), ("red.gcs", misled))]
        for phone in phones:
            phone.open()
            phone._socket.linger = 0
            await phone.tell("done", status="complete")
        try:
            hearing = asyncio.create_task(desk.hear())
            while not (phones[0].refused and phones[1].reached > 1 and desk.refused > 1):
                await asyncio.sleep(0.02)
            assert not hearing.done()
            hearing.cancel()
            return phones[0].refused, phones[1].refused, desk.refused, desk.strange
        finally:
            for phone in phones:
                phone.close()
            desk.close()

    refused, misled_refused, counted, strange = within(10.0, talk)
    assert refused >= 1
    assert misled_refused == 0  # it cannot know: under the wrong key it understands no answer
    assert counted >= 2
    assert strange == 0


# --- the keys of a range ---------------------------------------------------------------------------


def test_a_range_knows_its_machines_until_their_keys_are_gone(tmp_path: Path) -> None:
    own, lab2, lab3 = make_range_keys(tmp_path / "keys", ["lab2", "lab3"])
    (lab4,) = make_range_keys(tmp_path / "keys", ["lab4"])
    ours = load_range(own.parent)
    members = [load_member(path) for path in (lab2, lab3, lab4)]
    assert ours.peers == {one.public for one in members}
    assert all(one.peers == {ours.public} for one in members)
    lab3.with_suffix(".key").unlink()
    assert load_range(own.parent).peers == {members[0].public, members[2].public}


def test_files_that_are_no_keys_of_a_range_are_named(tmp_path: Path) -> None:
    own, lab2 = make_range_keys(tmp_path / "keys", ["lab2"])
    for path, problem in ((own, "no key of a range"), (lab2.with_suffix(".key"), "only a public key")):
        with pytest.raises(InputError, match=problem):
            load_member(path)
    with pytest.raises(InputError, match=r"range\.key_secret.*skyrange keys"):
        load_range(tmp_path)
    with pytest.raises(InputError, match="another name"):
        make_range_keys(tmp_path / "keys", ["range"])


# --- files in pieces -------------------------------------------------------------------------------


def test_a_file_arrives_as_it_left(tmp_path: Path) -> None:
    data = bytes(range(256)) * (CHUNK_BYTES // 128) + b"end"
    for name, content in (("a/b.bin", data), ("empty", b"")):
        for offset, piece in chunks(content):
            write_chunk(tmp_path, name, offset, piece)
    assert (tmp_path / "a/b.bin").read_bytes() == data
    assert listed(tmp_path) == [("a/b.bin", len(data)), ("empty", 0)]
    assert read_chunk(tmp_path, "a/b.bin", CHUNK_BYTES) == data[CHUNK_BYTES : 2 * CHUNK_BYTES]


@pytest.mark.parametrize("name", ["/etc/passwd", "../x", "a/../../x", "", "a\0b", "..\\x"])
def test_no_name_leads_out_of_the_folder(tmp_path: Path, name: str) -> None:
    with pytest.raises(ComponentError, match="outside"):
        inside(tmp_path, name)


# --- clocks ----------------------------------------------------------------------------------------


@given(
    offset=st.integers(-(10**15), 10**15),
    out=st.integers(0, 10**9),
    back=st.integers(0, 10**9),
    at=st.integers(0, 10**15),
)
def test_the_true_offset_is_within_the_uncertainty(offset: int, out: int, back: int, at: int) -> None:
    echo = Echo(at + offset - out, at, at + offset + back)
    assert abs(echo.offset_ns - offset) <= echo.uncertainty_ns
    assert best([Echo(0, 5, 10**10), echo]) == echo


def measured(offset_ns: int, at_ns: int, round_ns: int = 2 * MS) -> Echo:
    return Echo(at_ns + offset_ns - round_ns // 2, at_ns, at_ns + offset_ns + round_ns // 2)


def test_drift_is_told_in_millionths_and_a_jump_is_none() -> None:
    clock = Offset()
    for second in range(60):
        clock.take(measured(7_000 * MS + second * 50_000, second * 1_000 * MS), 0)
    told = clock.told
    assert told["drift_ppm"] == pytest.approx(50.0, abs=0.1)
    assert 0.0 < told["drift_uncertainty_ppm"] < 10.0
    assert told["offset_s"] == pytest.approx(7.0 + 59 * 50e-6, abs=told["uncertainty_s"])
    clock.take(measured(5_000 * MS, 70_000 * MS), 1_000 * MS)
    assert clock.told["jumps"] == [{"at_s": 69.0, "by_s": pytest.approx(-2.003, abs=0.002)}]
    assert clock.drift_ppm is None
    clock.take(measured(5_000 * MS + JUMP_NS // 2, 71_000 * MS), 1_000 * MS)
    assert len(clock.jumps) == 1


def test_a_slow_answer_does_not_move_a_clock_that_is_known_better() -> None:
    clock = Offset()
    clock.take(measured(7_000 * MS, 0), 0)
    slow = Echo(7_000 * MS + 1_000 * MS, 1_000 * MS + 40 * MS, 7_000 * MS + 1_000 * MS + 41 * MS)
    clock.take(slow, 0)
    assert abs(slow.offset_ns - 7_000 * MS) > 10 * MS
    assert clock.offset_ns == 7_000 * MS
    assert clock.uncertainty_ns >= MS
    clock.take(measured(7_000 * MS + 4 * MS, 2_000 * MS), 0)  # no answer in between allows what was known
    assert clock.offset_ns == 7_004 * MS
