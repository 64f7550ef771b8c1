"""Control channel of a live range: messages, keys, files in split_chunks, clocks of other machines."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
import zmq
from hypothesis import given
from hypothesis import strategies as st

from skyrange.assembly.build import build
from skyrange.core.errors import ComponentError, InputError
from skyrange.io.zeromq.curve_keys import Keys, load_member, load_range, make_range_keys
from skyrange.runtime.live.clock import JUMP_NS, ClockOffset, ClockSample, quickest_sample
from skyrange.runtime.live.config import NodeConfig
from skyrange.runtime.live.deployment import assign_components
from skyrange.runtime.live.system import RealSystem, System
from skyrange.runtime.live.transport.addresses import crossings, issue_credentials
from skyrange.runtime.live.transport.control import (
    CHUNK_BYTES,
    MAX_MESSAGE_BYTES,
    ZmqControlClient,
    ZmqControlServer,
    list_files,
    pack_message,
    path_inside,
    read_chunk,
    split_chunks,
    unpack_message,
    write_chunk,
)
from skyrange.scenario.shipped import load
from tests.live_ranges import VirtualSystem

MS = 1_000_000


def test_a_config_survives_its_file() -> None:
    links = build(load("rid-spoofing")).wiring.links
    places = crossings(links, assign_components(links, "component"))
    credentials = issue_credentials(zmq.curve_keypair()[0])
    config = NodeConfig("world", ("oracle",), ".parts/world", "127.0.0.1", ("127.0.0.1", 1), tuple(places), credentials)
    assert NodeConfig.from_json(config.to_json()) == config


@given(st.binary(max_size=200))
def test_control_survives_any_bytes(data: bytes) -> None:
    said = unpack_message(data)
    assert said is None or isinstance(said["kind"], str)


def test_control_takes_objects_of_a_kind_and_nothing_else() -> None:
    assert unpack_message(pack_message("status", now_ns=5)) == {"kind": "status", "now_ns": 5}
    for wrong in (b"[]", b'{"kind": 3}', b"{}", b"nonsense", b"[" * 5000, pack_message("x", y="z" * MAX_MESSAGE_BYTES)):
        assert unpack_message(wrong) is None


def within(seconds: float, talk: Callable[[], Awaitable[Any]]) -> Any:
    async def timed() -> Any:
        async with asyncio.timeout(seconds):
            return await talk()

    return asyncio.run(timed())


def test_supervisor_and_node_receive_from_each_other() -> None:
    (public, secret), credentials = (pair := zmq.curve_keypair()), issue_credentials(pair[0])

    async def talk() -> tuple[Any, ...]:
        server = ZmqControlServer(Keys(public, secret, frozenset({credentials.control.public})))
        server.open()
        client = ZmqControlClient("blue.gcs", server.address, credentials.control)
        client.open()
        try:
            await client._socket.send(b"no message")
            await client.send("chunk", b"\0\xff", at=3)
            received = await server.receive()
            await server.send("nobody", "stop")
            await server.send(received[0], "start", zero_ns=7)
            return received, await client.receive(), server.strange
        finally:
            client.close()
            server.close()

    received, answer, strange = within(5.0, talk)
    assert received == ("blue.gcs", {"kind": "chunk", "at": 3}, b"\0\xff")
    assert answer == ({"kind": "start", "zero_ns": 7}, b"")
    assert strange == 1


@pytest.mark.parametrize("size", [CHUNK_BYTES - 1, CHUNK_BYTES])
def test_a_whole_chunk_of_a_file_arrives_at_both_sides(size: int) -> None:
    (public, secret), credentials = (pair := zmq.curve_keypair()), issue_credentials(pair[0])

    async def talk() -> tuple[int, int]:
        server = ZmqControlServer(Keys(public, secret, frozenset({credentials.control.public})))
        server.open()
        client = ZmqControlClient("blue.gcs", server.address, credentials.control)
        client.open()
        try:
            await client.send("chunk", bytes(size))
            who, _, up = await server.receive()
            await server.send(who, "file", bytes(size))
            return len(up), len((await client.receive())[1])
        finally:
            client.close()
            server.close()

    assert within(10.0, talk) == (size, size)


@pytest.mark.parametrize("system", [RealSystem(), VirtualSystem()], ids=["real", "virtual"])
def test_a_peer_with_another_key_is_refused_and_counted(system: System) -> None:
    (public, secret), credentials = (pair := zmq.curve_keypair()), issue_credentials(pair[0])
    unknown = zmq.curve_keypair()
    stranger = Keys(*unknown, frozenset({public}))
    misled = Keys(credentials.control.public, credentials.control.secret, frozenset({unknown[0]}))

    async def talk() -> tuple[int, int, int, int]:
        server = system.control_server(Keys(public, secret, frozenset({credentials.control.public})))
        server.open()
        named = (("blue.gcs", stranger), ("red.gcs", misled))
        clients = [system.control_client(name, server.address, keys) for name, keys in named]
        for client in clients:
            client.open()
            if isinstance(client, ZmqControlClient):
                client._socket.linger = 0
            await client.send("done", status="complete")
        try:
            receiving = asyncio.create_task(server.receive())
            async with asyncio.timeout(10.0):
                while not (clients[0].refused and clients[1].reached > 1 and server.refused > 1):
                    await asyncio.sleep(0.02)
            assert not receiving.done()
            receiving.cancel()
            return clients[0].refused, clients[1].refused, server.refused, server.strange
        finally:
            for client in clients:
                client.close()
            server.close()

    refused, misled_refused, counted, strange = system.run(talk())
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


@pytest.mark.parametrize("names", [["lab2", "range"], ["lab2", "a/b"], ["lab2", "lab2"], ["lab2", "taken"]])
def test_keys_that_cannot_all_be_made_leave_nothing_behind(tmp_path: Path, names: list[str]) -> None:
    taken = names[-1] == "taken"
    folder = tmp_path / "new" / "keys"
    if taken:
        folder.mkdir(parents=True)
        (folder / "taken.key").touch()
    with pytest.raises(InputError):
        make_range_keys(folder, names)
    assert [path.name for path in tmp_path.rglob("*")] == (["new", "keys", "taken.key"] if taken else [])


# --- files in pieces -------------------------------------------------------------------------------


def test_a_file_arrives_as_it_left(tmp_path: Path) -> None:
    data = bytes(range(256)) * (CHUNK_BYTES // 128) + b"end"
    for name, content in (("a/b.bin", data), ("empty", b"")):
        for offset, piece in split_chunks(content):
            write_chunk(tmp_path, name, offset, piece)
    assert (tmp_path / "a/b.bin").read_bytes() == data
    assert list_files(tmp_path) == [("a/b.bin", len(data)), ("empty", 0)]
    assert read_chunk(tmp_path, "a/b.bin", CHUNK_BYTES) == data[CHUNK_BYTES : 2 * CHUNK_BYTES]


@pytest.mark.parametrize("name", ["/etc/passwd", "../x", "a/../../x", "", "a\0b", "..\\x"])
def test_no_name_leads_out_of_the_folder(tmp_path: Path, name: str) -> None:
    with pytest.raises(ComponentError, match="outside"):
        path_inside(tmp_path, name)


# --- clocks ----------------------------------------------------------------------------------------


@given(
    offset=st.integers(-(10**15), 10**15),
    out=st.integers(0, 10**9),
    back=st.integers(0, 10**9),
    at=st.integers(0, 10**15),
)
def test_the_true_offset_is_within_the_uncertainty(offset: int, out: int, back: int, at: int) -> None:
    sample = ClockSample(at + offset - out, at, at + offset + back)
    assert abs(sample.offset_ns - offset) <= sample.uncertainty_ns
    assert quickest_sample([ClockSample(0, 5, 10**10), sample]) == sample


def measured(offset_ns: int, at_ns: int, round_ns: int = 2 * MS) -> ClockSample:
    return ClockSample(at_ns + offset_ns - round_ns // 2, at_ns, at_ns + offset_ns + round_ns // 2)


def test_drift_is_told_in_millionths_and_a_jump_is_none() -> None:
    clock = ClockOffset()
    for second in range(60):
        clock.add_sample(measured(7_000 * MS + second * 50_000, second * 1_000 * MS), 0)
    told = clock.manifest_entry
    assert told["drift_ppm"] == pytest.approx(50.0, abs=0.1)
    assert 0.0 < told["drift_uncertainty_ppm"] < 10.0
    assert told["offset_s"] == pytest.approx(7.0 + 59 * 50e-6, abs=told["uncertainty_s"])
    clock.add_sample(measured(5_000 * MS, 70_000 * MS), 1_000 * MS)
    assert clock.manifest_entry["jumps"] == [{"at_s": 69.0, "by_s": pytest.approx(-2.003, abs=0.002)}]
    assert clock.drift_ppm is None
    clock.add_sample(measured(5_000 * MS + JUMP_NS // 2, 71_000 * MS), 1_000 * MS)
    assert len(clock.jumps) == 1


def test_a_slow_answer_does_not_move_a_clock_that_is_known_better() -> None:
    clock = ClockOffset()
    clock.add_sample(measured(7_000 * MS, 0), 0)
    slow = ClockSample(7_000 * MS + 1_000 * MS, 1_000 * MS + 40 * MS, 7_000 * MS + 1_000 * MS + 41 * MS)
    clock.add_sample(slow, 0)
    assert abs(slow.offset_ns - 7_000 * MS) > 10 * MS
    assert clock.offset_ns == 7_000 * MS
    assert clock.uncertainty_ns >= MS
    clock.add_sample(measured(7_000 * MS + 4 * MS, 2_000 * MS), 0)  # no answer in between allows what was known
    assert clock.offset_ns == 7_004 * MS
