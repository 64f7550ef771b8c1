"""What does a tap outside do with frames? The state by itself, then a node's door with real sockets."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from skyrange.contracts.frames import Fate, Frame
from skyrange.contracts.links import LinkEnds
from skyrange.contracts.mailboxes import Note
from skyrange.contracts.verdicts import Label
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_MS, NS_PER_S
from skyrange.runtime.live.taps import tap_process
from skyrange.runtime.live.taps.external_tap import MAX_HELD, ExternalTap, TapTerms
from skyrange.runtime.live.taps.tap_process import TapProcess, find_node_folder, parse_loopback
from skyrange.runtime.live.taps.tap_server import MAX_LINE_BYTES, SOCKET, TapServer, line_of, socket_path
from skyrange.runtime.live.transport.addresses import Crossing

LINK = LinkEnds("gcs:blue/b1", "blue.gcs", "blue/b1.companion")
HEARTBEAT = mavlink.MAVLink(None, 255).heartbeat_encode(6, 8, 0, 0, 4).pack(mavlink.MAVLink(None, 255))
S = NS_PER_S


class Record:
    def __init__(self) -> None:
        self.frames: list[Frame] = []
        self.labels: list[Label] = []
        self.notes: list[Note] = []

    def on_frame(self, frame: Frame) -> None:
        self.frames.append(frame)

    def on_label(self, label: Label) -> None:
        self.labels.append(label)

    def on_note(self, now: int, source: str, note: Note) -> None:
        self.notes.append(note)


def tapped(**terms: Any) -> tuple[ExternalTap, Record]:
    record = Record()
    tap = ExternalTap(TapTerms(link=LINK.name, **terms), LINK, "blue.gcs", True, record)
    tap.set_present(0, there=True)
    return tap, record


def frame(serial: int, payload: bytes = HEARTBEAT) -> Frame:
    return Frame(LINK.name, "fwd", LINK.a, serial, LINK.a, LINK.b, sent_ns=serial, payload=payload)


def said(**answer: Any) -> bytes:
    return json.dumps(answer).encode()


def test_what_is_asked_has_all_that_a_program_needs() -> None:
    tap, _ = tapped()
    asked = tap.take(S, frame(0), outgoing=True)
    assert asked == {
        "id": 1, "link": LINK.name, "direction": "fwd", "src": LINK.a, "dst": LINK.b, "at_s": 1.0,
        "payload": HEARTBEAT.hex(),
    }  # fmt: skip
    assert (tap.ready, tap.due) == ([], S + 200 * NS_PER_MS)


def test_pass_drop_replace_delay_and_inject_are_done_and_labelled() -> None:
    tap, record = tapped()
    frames = [frame(serial) for serial in range(5)]
    for one in frames:
        tap.take(S, one, outgoing=True)
    other = HEARTBEAT[:4] + b"\x07" + HEARTBEAT[5:]
    assert tap.answer(S, said(id=1, do="pass")) == ""
    assert tap.answer(S, said(id=2, do="drop")) == ""
    assert tap.answer(S, said(id=3, do="replace", payload="00")) == ""
    assert tap.answer(S, said(id=4, do="delay", delay_ms=500)) == ""
    assert tap.answer(S, said(id=5, do="replace", payload=other[:3].hex(), delay_ms=300)) == ""
    assert tap.answer(S, said(do="inject", id=1, direction="rev", payload="fe")) == ""
    passed, replaced, injected = tap.ready
    assert passed == (frames[0], True)
    assert (replaced[0].payload, replaced[0].parent, replaced[0].sender) == (b"\0", frames[2].id, tap.name)
    assert injected[1] is False
    assert (injected[0].src, injected[0].dst, injected[0].parent) == (LINK.b, LINK.a, frames[0].id)
    assert [one.fate for one in frames[1:3]] == [Fate.DROPPED, Fate.REPLACED]
    tap.ready.clear()
    tap.turn(S + 299 * NS_PER_MS)
    assert tap.ready == []
    tap.turn(S + 300 * NS_PER_MS)
    assert [one.parent for one, _ in tap.ready] == [frames[4].id]
    tap.turn(S + 500 * NS_PER_MS)
    assert tap.ready[1:] == [(frames[3], True)]
    told = [(label.action, label.frame, label.child, label.until_ns) for label in record.labels]
    child = tap.ready[0][0].id
    assert told == [
        ("drop", frames[1].id, None, None),
        ("replace", frames[2].id, replaced[0].id, None),
        ("replace", frames[4].id, child, None),
        ("inject", injected[0].id, None, None),
        ("delay", child, None, S + 300 * NS_PER_MS),
        ("delay", frames[3].id, None, S + 500 * NS_PER_MS),
    ]
    assert {label.attack for label in record.labels} == {"tap-process"}


@pytest.mark.parametrize(
    ("fail", "fate", "action"), [("open", Fate.IN_FLIGHT, "delay"), ("closed", Fate.DROPPED, "drop")]
)
def test_what_gets_no_answer_passes_or_not_and_that_is_labelled(fail: str, fate: Fate, action: str) -> None:
    tap, record = tapped(fail=fail, hold_ms=100)
    waits = frame(0)
    tap.take(S, waits, outgoing=True)
    tap.turn(tap.due - 1)
    assert (tap.ready, record.labels) == ([], [])
    tap.turn(tap.due)
    assert waits.fate is fate
    assert [one for one, _ in tap.ready] == ([waits] if fail == "open" else [])
    assert [label.action for label in record.labels] == [action]
    assert "waits for no answer" in tap.answer(2 * S, said(id=1, do="pass"))  # too late
    # nobody is there: dealt with at once, and what waited too
    left, later = frame(1), frame(2)
    tap.take(2 * S, left, outgoing=True)
    tap.set_present(2 * S, there=False)
    assert tap.take(2 * S, later, outgoing=True) is None
    assert {left.fate, later.fate} == {fate}
    assert (tap.counts.unanswered, tap.counts.unasked) == (2, 1)
    assert [note.data["what"] for note in record.notes] == ["came", "went"]


@pytest.mark.parametrize(
    ("line", "wrong"),
    [
        (b"", "line"),
        (b"[]", "line"),
        (b'{"do": "explode", "id": 1}', "do"),
        (b'{"do": "pass"}', "id"),
        (b'{"do": "pass", "id": 2}', "id"),
        (b'{"do": "pass", "id": 1, "payload": "00"}', "payload"),
        (b'{"do": "pass", "id": 1, "delay_ms": 5}', "delay_ms"),
        (b'{"do": "delay", "id": 1}', "delay_ms"),
        (b'{"do": "delay", "id": 1, "delay_ms": 1e9}', "delay_ms"),
        (b'{"do": "delay", "id": 1, "delay_ms": -1}', "delay_ms"),
        (b'{"do": "replace", "id": 1}', "payload"),
        (b'{"do": "replace", "id": 1, "payload": "0"}', "payload"),
        (b'{"do": "inject", "payload": "00"}', "direction"),
        (b'{"do": "pass", "id": 1, "more": 0}', "more"),
        (said(do="replace", id=1, payload=2 * HEARTBEAT.hex()), "2 MAVLink frames"),
    ],
)
def test_a_wrong_answer_is_told_and_changes_nothing(line: bytes, wrong: str) -> None:
    tap, record = tapped()
    tap.take(S, frame(0), outgoing=True)
    assert wrong in tap.answer(S, line)
    assert (tap.counts.strange, tap.ready, record.labels) == (1, [], [])
    assert tap.answer(S, said(id=1, do="pass")) == ""


@settings(max_examples=200, deadline=None)
@given(st.lists(st.binary(max_size=60) | st.from_regex(rb'\{"do":"(pass|drop|delay)","id":[0-4]\}', fullmatch=True)))
def test_whatever_is_said_each_frame_has_one_fate(lines: list[bytes]) -> None:
    tap, record = tapped()
    frames = [frame(serial) for serial in range(3)]
    for one in frames:
        tap.take(S, one, outgoing=True)
    for said_ in lines:
        tap.answer(S, said_)
    tap.turn(S + round(tap.terms.hold_ms * NS_PER_MS))
    going = [one.id for one, _ in tap.ready]
    gone = [one.id for one in record.frames]
    assert sorted(going + gone) == [one.id for one in frames]


def test_who_never_answers_does_not_fill_the_memory() -> None:
    tap, _ = tapped(hold_ms=60_000)
    for serial in range(MAX_HELD + 10):
        tap.take(S, frame(serial), outgoing=True)
    assert tap.counts.unasked == len(tap.ready) == 10


def test_the_end_leaves_nothing_unrecorded() -> None:
    tap, record = tapped()
    frames = [frame(serial) for serial in range(3)]
    for one in frames:
        tap.take(S, one, outgoing=True)
    tap.answer(S, said(id=1, do="pass"))
    tap.answer(S, said(id=2, do="delay", delay_ms=9000))
    tap.end(S + 1)
    assert {one.id for one in record.frames} == {one.id for one in frames}


def test_a_tap_listens_on_the_loopback_alone() -> None:
    assert (
        parse_loopback("localhost:7000")
        == parse_loopback("127.0.0.1:7000")
        == parse_loopback(":7000")
        == ("127.0.0.1", 7000)
    )
    for bad in ("0.0.0.0:7000", "10.0.0.1:7000", "127.0.0.1", "127.0.0.1:x", "127.0.0.1:70000"):
        with pytest.raises(InputError, match="loopback"):
            parse_loopback(bad)


# ---------------------------------------------------------------- the door


class Door:
    """A node's taps, and a tap process's line to them."""

    def __init__(self, folder: Path) -> None:
        self.record = Record()
        self.now: int | None = S
        self.taps = TapServer(
            [Crossing(LINK, "udp", "blue.gcs", ("127.0.0.1", 1))], frozenset({"blue.gcs"}), self.record
        )
        self.folder = folder

    async def open(self) -> None:
        await self.taps.open(self.folder, lambda: self.now, lambda: None)

    async def call(self, **terms: Any) -> tuple[asyncio.StreamReader, asyncio.StreamWriter, dict[str, Any]]:
        with socket_path(self.folder) as name:
            reader, writer = await asyncio.open_unix_connection(name)
        writer.write(line_of(terms))
        return reader, writer, json.loads(await reader.readline())


async def until(holds: Any) -> None:
    async with asyncio.timeout(2.0):
        while not holds():
            await asyncio.sleep(0.005)


def test_a_tap_process_comes_asks_answers_and_dies(tmp_path: Path) -> None:
    async def talk() -> Record:
        deep = tmp_path / ("long" * 30)  # a path that no Unix socket can have
        deep.mkdir()
        door = Door(deep)
        await door.open()
        assert (deep / SOCKET).stat().st_mode & 0o077 == 0  # nobody else's
        reader, writer, hello = await door.call(link=LINK.name, fail="closed")
        assert hello["fwd"] == [LINK.a, LINK.b]
        _, second, refused = await door.call(link=LINK.name)
        assert "tapped already" in refused["error"]
        second.close()
        first, lost = frame(0), frame(1)
        writer.write(line_of({"program": True}))
        await until(lambda: door.record.notes[-1].data["what"] == "came")
        assert door.taps.holds(LINK.name)
        door.taps.take(S, first, outgoing=True)
        asked = json.loads(await reader.readline())
        writer.write(b"garbage\n" + line_of({"id": asked["id"], "do": "pass"}))
        assert "error" in json.loads(await reader.readline())
        await until(lambda: door.taps.due == 0)
        assert door.taps.turn(S) == [(first, True)]
        writer.close()
        await until(lambda: door.record.notes[-1].data["what"] == "detached")
        door.taps.take(S, lost, outgoing=True)  # failed closed: the link is cut
        assert door.taps.turn(2 * S) == []
        assert lost.fate is Fate.DROPPED
        # another takes its place
        reader, writer, hello = await door.call(link=LINK.name, fail="open")
        door.taps.take(2 * S, frame(2), outgoing=True)
        assert len(door.taps.turn(2 * S)) == 1
        door.taps.close(3 * S)
        assert json.loads(await reader.readline())["end"]["unasked"] == 1
        assert await reader.read() == b""
        return door.record

    record = asyncio.run(talk())
    assert [note.data["what"] for note in record.notes] == ["attached", "came", "went", "detached", "attached"]


@pytest.mark.parametrize(
    ("terms", "why"),
    [
        ({"link": "gcs:blue/b2"}, "gcs:blue/b2 does not come out of this process"),
        ({"link": LINK.name, "fail": "ajar"}, "open"),
        ({"link": LINK.name, "hold_ms": 0}, "greater than or equal to 1"),
        ({}, "required"),
    ],
)
def test_wrong_terms_are_told(terms: dict[str, Any], why: str, tmp_path: Path) -> None:
    async def talk() -> dict[str, Any]:
        door = Door(tmp_path)
        await door.open()
        try:
            return (await door.call(**terms))[2]
        finally:
            door.taps.close(S)

    assert why in asyncio.run(talk())["error"]


def test_who_does_not_read_is_nobody(tmp_path: Path) -> None:
    async def talk() -> Record:
        door = Door(tmp_path)
        await door.open()
        _, writer, _ = await door.call(link=LINK.name, fail="closed")
        writer.write(line_of({"program": True}))
        await until(lambda: len(door.record.notes) == 2)
        for serial in range(3000):
            door.taps.take(S, frame(serial, bytes(4096)), outgoing=True)
        writer.close()
        door.taps.close(S)
        return door.record

    record = asyncio.run(talk())
    fates = [one.fate for one in record.frames]
    assert fates.count(Fate.DROPPED) + fates.count(Fate.IN_FLIGHT) == 3000
    assert 100 < fates.count(Fate.DROPPED) < 2900


def node(run: Path, name: str, endpoint: str, listener: str, *, door: bool = True) -> Path:
    folder = run / ".parts" / f"{name}.program"
    folder.mkdir(parents=True)
    orders = {"endpoints": [endpoint], "crossings": [{"link": {"name": LINK.name}, "listener": listener}]}
    (folder / "node.json").write_text(json.dumps(orders))
    if door:
        (folder / SOCKET).touch()
    return folder


def test_the_door_is_found_by_the_runs_folder(tmp_path: Path) -> None:
    assert find_node_folder(tmp_path / "none", LINK.name) is None
    run = tmp_path / "run"
    caller = node(run, "blue-b1.companion", LINK.b, LINK.a)
    assert find_node_folder(run, LINK.name) == caller  # the ground station is no process of the range
    station = node(run, "blue.gcs", LINK.a, LINK.a, door=False)
    assert find_node_folder(run, LINK.name) is None  # not yet
    (station / SOCKET).touch()
    assert find_node_folder(run, LINK.name) == station
    with pytest.raises(InputError, match=LINK.name):  # the nearest
        find_node_folder(run, "gcs:blue/b2")
    with pytest.raises(InputError, match="--group component"):
        find_node_folder(run, "rid_up:green/g7")
    (station / "node.json").write_text('{"endpo')
    assert find_node_folder(run, LINK.name) is None  # it is being written


async def called(port: int) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    return await asyncio.open_connection("127.0.0.1", port, limit=1 << 20)


def test_programs_come_one_at_a_time_and_may_talk_nonsense(tmp_path: Path) -> None:
    async def talk() -> tuple[Record, TapProcess]:
        door = Door(node(tmp_path, "blue.gcs", LINK.a, LINK.a, door=False))
        await door.open()
        told: list[str] = []
        tapping = TapProcess(TapTerms(link=LINK.name, fail="closed"), ("127.0.0.1", 0), tmp_path)
        serving = asyncio.create_task(tapping.relay(told.append))
        await until(lambda: told)
        port = int(told[0].rpartition(":")[2])
        reader, writer = await called(port)
        assert json.loads(await reader.readline())["tap"] == "tap-process@gcs:blue/b1.gcs"
        second, other = await called(port)
        assert "already" in json.loads(await second.readline())["error"]
        other.close()
        writer.write(bytes(range(9)) + b"\n" + b"[" * 5000 + b"\n")
        assert "error" in json.loads(await reader.readline())
        assert "error" in json.loads(await reader.readline())
        writer.write(b"x" * (MAX_LINE_BYTES + 100))  # a line without an end: it is hung up on
        assert await reader.read() == b""
        await until(lambda: door.record.notes[-1].data["what"] == "went")
        reader, writer = await called(port)  # another comes
        await reader.readline()
        await until(lambda: door.record.notes[-1].data["what"] == "came")
        door.taps.take(S, frame(0), outgoing=True)
        asked = json.loads(await reader.readline())
        writer.write(said(id=asked["id"], do="drop"))  # the last words of one that dies need no end of line
        writer.close()
        await until(lambda: door.record.labels)
        door.taps.close(2 * S)
        async with asyncio.timeout(2.0):
            await serving
        return door.record, tapping

    record, tapping = asyncio.run(talk())
    assert [label.action for label in record.labels] == ["drop"]
    assert (tapping.counts["handed"], tapping.counts["dropped"], tapping.counts["strange"]) == (1, 1, 2)


@pytest.mark.parametrize("reads", [True, False])
def test_the_end_of_the_range_is_no_error_while_a_program_is_connected(
    reads: bool, tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """asyncio reports a cancelled task of a server with a traceback, after the loop has closed."""
    monkeypatch.setattr(tap_process, "END_S", 0.05)

    async def talk() -> None:
        door = Door(node(tmp_path, "blue.gcs", LINK.a, LINK.a, door=False))
        await door.open()
        told: list[str] = []
        tapping = TapProcess(TapTerms(link=LINK.name), ("127.0.0.1", 0), tmp_path)
        serving = asyncio.create_task(tapping.relay(told.append))
        await until(lambda: told)
        reader, writer = await called(int(told[0].rpartition(":")[2]))
        await reader.readline()
        if not reads:  # as if its connection could not be closed, because data wait for it
            monkeypatch.setattr(tapping._program, "close", lambda: None)
        door.taps.close(S)
        async with asyncio.timeout(2.0):
            await serving
        writer.transport.abort()

    asyncio.run(talk())
    assert caplog.records == []


def test_a_range_that_has_ended_is_named(tmp_path: Path) -> None:
    (tmp_path / "manifest.json").write_text('{"status": "running"}')
    assert find_node_folder(tmp_path, LINK.name) is None
    (tmp_path / "manifest.json").write_text('{"status": "complete"}')
    with pytest.raises(InputError, match="complete"):
        find_node_folder(tmp_path, LINK.name)
