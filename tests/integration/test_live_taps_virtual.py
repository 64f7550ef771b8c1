"""An external tap on a live range in virtual time: what its program does to frames, its death, another in its place."""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_S
from skyrange.record import RunRecord
from skyrange.runtime.live.taps.external_tap import TapTerms
from skyrange.runtime.live.taps.tap_process import TapProcess
from tests.integration.live_programs import ONE_AIRCRAFT, kinds
from tests.integration.live_virtual import VirtualFlight, fly_virtual, prepared
from tests.live_ranges import VirtualProcess

pytestmark = pytest.mark.rotating

LINK, TAP = "gcs:blue/b1", "tap-process@gcs:blue/b1.gcs"
ARM, MISSION_START, DO_SET_MODE, AUTO, GUIDED = 400, 300, 176, 3, 4
Line = dict[str, Any]


class Tool:
    """A program that calls a tap process and does what `decide` says of each frame."""

    def __init__(self, decide: Callable[[Line], Line]) -> None:
        self.decide = decide
        self.hello: Line = {}
        self.done: list[str] = []
        self.errors: list[str] = []

    async def run(self, address: tuple[str, int]) -> int:
        reader, writer = await asyncio.open_connection(*address, limit=1 << 22)
        self.hello = json.loads(await reader.readline())
        while line := await reader.readline():
            frame = json.loads(line)
            if "error" in frame:
                self.errors.append(frame["error"])
            elif "payload" in frame:
                answer = self.decide(frame)
                self.done.append(answer["do"])
                writer.write(json.dumps({"id": frame["id"], **answer}).encode() + b"\n")
        return 0


def meddle_with_orders() -> Callable[[Line], Line]:
    """As the tool of the how-to page: arming a second late, GUIDED in AUTO's place, the mission never started."""
    packer = mavlink.MAVLink(None)
    held: set[str] = set()

    def decide(frame: Line) -> Line:
        (message,) = mavlink.MAVLink(None).parse_buffer(bytes.fromhex(frame["payload"]))
        if message.get_type() == "COMMAND_LONG" and message.command == ARM and not held:
            held.add(frame["payload"])
            return {"do": "delay", "delay_ms": 1000}
        if message.get_type() == "COMMAND_LONG" and message.command == MISSION_START:
            return {"do": "drop"}
        if message.get_type() == "COMMAND_LONG" and message.command == DO_SET_MODE and message.param2 == AUTO:
            packer.seq, packer.srcSystem = message.get_seq(), message.get_srcSystem()
            packer.srcComponent, message.param2 = message.get_srcComponent(), GUIDED
            return {"do": "replace", "payload": message.pack(packer).hex()}
        return {"do": "pass"}

    return decide


async def tapped(
    flight: VirtualFlight, tool: Tool | None, **terms: Any
) -> tuple[TapProcess, VirtualProcess, VirtualProcess | None]:
    """A tap process on `LINK` and a program at it."""
    system = flight.system
    tapping = TapProcess(TapTerms(link=LINK, **terms), ("127.0.0.1", 0), flight.folder, 60.0, system.clock)
    words: list[str] = []

    async def relay() -> int:
        await tapping.relay(words.append)
        return 0

    process = system.begin("tap", relay())
    said = await flight.until(lambda: words or process.ended, 70.0, "a tap")
    assert words, (said, process.last_words())
    found = re.fullmatch(rf"{LINK} is tapped; a program may call 127\.0\.0\.1:(\d+)", words[0])
    assert found is not None
    program = system.begin("tool", tool.run(("127.0.0.1", int(found[1])))) if tool is not None else None
    return tapping, process, program


def events(record: RunRecord, kind: str) -> list[tuple[int, Line]]:
    rows = record.table("events").to_pylist()
    return [(row["time_ns"], json.loads(row["data"])) for row in rows if row["kind"] == kind]


@pytest.mark.slow
def test_a_program_delays_and_alters_commands_and_dies(tmp_path: Path) -> None:
    tool = Tool(meddle_with_orders())
    taps: list[TapProcess] = []

    async def meddle(flight: VirtualFlight) -> None:
        tapping, _, program = await tapped(flight, tool)
        taps.append(tapping)
        assert program is not None
        await flight.until(lambda: {"delay", "replace", "drop"} <= set(tool.done), 30.0, "all that it does")
        await asyncio.sleep(0.5)
        program.kill()  # failed open: the ground station orders again

    record = fly_virtual(prepared(ONE_AIRCRAFT.format(seconds=16), tmp_path), meddle)
    assert tool.hello["tap"] == TAP
    assert tool.errors == []
    assert taps[0].counts["replaced"] > 0
    assert taps[0].counts["delayed"] > 0

    frames = {frame.id: frame for frame in record.frames_with_payloads()}
    labels = record.table("labels").to_pylist()
    assert {label["attack"] for label in labels} == {"tap-process"}
    assert {label["actor"] for label in labels} == {TAP}
    delays = [label for label in labels if label["action"] == "delay" and label["until_ns"] - label["at_ns"] > NS_PER_S]
    assert len(delays) == 1
    late = frames[delays[0]["frame"]]
    assert (late.sender, late.direction, late.fate) == ("blue.gcs", "fwd", "delivered")
    assert late.arrived_ns > delays[0]["until_ns"] - NS_PER_S // 100 > late.sent_ns + NS_PER_S
    alters = [label for label in labels if label["action"] == "replace"]
    for label in alters:
        before, after = frames[label["frame"]], frames[label["child"]]
        assert (before.sender, before.fate) == ("blue.gcs", "replaced")
        assert (after.sender, after.parent, after.fate) == (label["actor"], before.id, "delivered")
        assert after.payload != before.payload
    drops = [frames[label["frame"]] for label in labels if label["action"] == "drop"]
    assert {(frame.sender, frame.fate) for frame in drops} == {("blue.gcs", "dropped")}
    # what was altered went on to the autopilot, and nothing came from nowhere
    passed_on = [
        frame for frame in frames.values() if frame.link == "log:blue/b1" and frame.parent == alters[0]["child"]
    ]
    assert len(passed_on) == 1
    assert record.manifest["crossings"]["outside"] == 0
    told = events(record, "event.tap")
    assert [data["what"] for _, data in told] == ["attached", "came", "went"]
    went_ns = told[-1][0]
    autos = [at for at, data in events(record, "event.mode") if data["mode"] == "AUTO"]
    assert min(autos) > went_ns
    assert "event.takeoff" in kinds(record, "blue/b1")


@pytest.mark.slow
def test_a_program_that_never_answers_costs_each_frame_its_hold(tmp_path: Path) -> None:
    class Mute(Tool):
        async def run(self, address: tuple[str, int]) -> int:
            reader, _ = await asyncio.open_connection(*address, limit=1 << 22)
            while await reader.readline():
                pass
            return 0

    async def meddle(flight: VirtualFlight) -> None:
        await tapped(flight, Mute(dict), hold_ms=150.0)

    record = fly_virtual(prepared(ONE_AIRCRAFT.format(seconds=10), tmp_path), meddle)
    labels = [label for label in record.table("labels").to_pylist() if label["until_ns"] is not None]
    held_ms = [(label["until_ns"] - label["at_ns"]) / 1e6 for label in labels]
    assert len(held_ms) > 100
    assert all(150.0 <= held < 152.0 for held in held_ms)
    frames = [frame for frame in record.frames_with_payloads() if frame.link == LINK]
    assert not any(frame.fate == "dropped" for frame in frames)


@pytest.mark.parametrize(("fail", "aloft"), [pytest.param("open", True, marks=pytest.mark.slow), ("closed", False)])
def test_while_no_program_is_there_frames_pass_or_are_dropped(fail: str, aloft: bool, tmp_path: Path) -> None:
    async def meddle(flight: VirtualFlight) -> None:
        await tapped(flight, None, fail=fail)

    record = fly_virtual(prepared(ONE_AIRCRAFT.format(seconds=9), tmp_path), meddle)
    assert ("event.takeoff" in kinds(record, "blue/b1")) is aloft
    actions = {label["action"] for label in record.table("labels").to_pylist()}
    assert actions == (set() if aloft else {"drop"})


@pytest.mark.slow
def test_a_tap_process_that_is_killed_gives_the_link_back_and_another_takes_its_place(tmp_path: Path) -> None:
    serials: list[int] = []

    async def meddle(flight: VirtualFlight) -> None:
        first = Tool(lambda _: {"do": "drop"})
        _, process, _ = await tapped(flight, first)
        await flight.reach(3.0)
        with pytest.raises(InputError, match="tapped already"):
            await TapProcess(TapTerms(link=LINK), ("127.0.0.1", 0), flight.folder, 5.0).relay(print)
        process.kill()
        await flight.reach(6.0)
        beat = mavlink.MAVLink(None, 255).heartbeat_encode(6, 8, 0, 0, 4).pack(mavlink.MAVLink(None, 255)).hex()
        second = Tool(lambda _: {"do": "inject", "direction": "fwd", "payload": beat})
        await tapped(flight, second)
        await flight.until(lambda: len(second.done) > 3, 20.0, "four more")
        serials.append(len(second.done))

    record = fly_virtual(prepared(ONE_AIRCRAFT.format(seconds=12), tmp_path), meddle)
    frames = [frame for frame in record.frames_with_payloads() if frame.link == LINK]
    dropped = [frame.sent_ns / NS_PER_S for frame in frames if frame.fate == "dropped"]
    assert max(dropped) <= 3.1
    between = [frame for frame in frames if 3.2 < frame.sent_ns / NS_PER_S < 5.9]
    assert {frame.fate for frame in between} == {"delivered"}
    injected = [frame for frame in frames if frame.sender == TAP]
    assert len(injected) >= serials[0]
    assert {frame.fate for frame in injected} <= {"delivered", "in_flight"}
    told = [data["what"] for _, data in events(record, "event.tap")]
    assert told[:6] == ["attached", "came", "went", "detached", "attached", "came"]


def test_a_link_within_a_process_cannot_be_tapped(tmp_path: Path) -> None:
    async def meddle(flight: VirtualFlight) -> None:
        await flight.reach(1.0)
        with pytest.raises(InputError, match="--group component"):
            await TapProcess(TapTerms(link=LINK), ("127.0.0.1", 0), flight.folder, 5.0, flight.system.clock).relay(
                print
            )

    fly_virtual(prepared(ONE_AIRCRAFT.format(seconds=3), tmp_path, group="one"), meddle)


def test_a_tap_waits_for_its_range_and_no_longer(tmp_path: Path) -> None:
    async def meddle(flight: VirtualFlight) -> None:
        began = asyncio.get_running_loop().time()
        with pytest.raises(InputError, match="a live range that flies"):
            await TapProcess(TapTerms(link=LINK), ("127.0.0.1", 0), tmp_path / "none", 2.0, flight.system.clock).relay(
                print
            )
        assert 2.0 <= asyncio.get_running_loop().time() - began < 2.3

    fly_virtual(prepared(ONE_AIRCRAFT.format(seconds=3), tmp_path), meddle)
