"""Supervisor of a live range, in virtual time: how processes come up, and what it does where one does not."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest

from skyrange.core.errors import ComponentError, ShortfallError
from skyrange.record import load
from skyrange.runtime.live.config import NodeConfig
from skyrange.runtime.live.node.node import Node
from skyrange.runtime.live.supervisor.supervisor import END_S, START_S, run_range
from skyrange.runtime.live.transport.control import Message
from tests.integration.live_virtual import VirtualFlight, fly_virtual, prepared
from tests.live_ranges import VirtualProcess, VirtualSystem
from tests.live_ranges.messages import MemoryControlServer

pytestmark = pytest.mark.rotating

SCENARIO = """
name = "supervised"
seed = 4
duration_s = 10
origin = [-35.363328, 149.1652241]

[[operators]]
id = "blue"
vehicles = [{ id = "b1", plan = { path = { points = [[0.0, 10.0]], alt_m = 4.0 }, end = "land" } }]
"""


class Mute(VirtualSystem):
    """A system on which the nodes named in `mute` never send a message."""

    mute: frozenset[str] = frozenset()

    def start_node(self, root: Path, config: NodeConfig, through: Any = ()) -> VirtualProcess:
        if config.name not in self.mute:
            return super().start_node(root, config, through)
        return self.begin(config.name, _sleep())


async def _sleep() -> int:
    await asyncio.sleep(3600.0)
    return 0


def running(system: VirtualSystem) -> list[str]:
    return [process.name for starts in system.processes.values() for process in starts if process.running]


def test_a_supervisor_that_no_longer_receives_ends_the_range_and_names_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def receive(_: MemoryControlServer) -> tuple[str, Message, bytes]:
        raise RuntimeError("the socket is broken")

    monkeypatch.setattr(MemoryControlServer, "receive", receive)
    system = Mute()
    system.mute = frozenset({"world"})
    flight = prepared(SCENARIO, tmp_path, system=system, group="one")
    began_ns = system.virtual.now_ns
    with pytest.raises(ComponentError, match="the socket is broken"):
        run_range(flight.range)
    assert (system.virtual.now_ns - began_ns) / 1e9 < END_S + 1.0  # the node does not stop when told
    assert list(system.processes) == ["world"]
    assert running(system) == []
    manifest = json.loads((flight.folder / "manifest.json").read_text())
    assert manifest["status"] == "failed"
    assert "the socket is broken" in manifest["error"]


def test_a_node_that_does_not_come_up_is_named_after_a_while(tmp_path: Path) -> None:
    system = Mute()
    system.mute = frozenset({"blue.gcs"})
    flight = prepared(SCENARIO, tmp_path, system=system)
    began_ns = system.virtual.now_ns
    with pytest.raises(ComponentError, match=rf"blue\.gcs not here within {START_S:g} s"):
        run_range(flight.range)
    assert START_S < (system.virtual.now_ns - began_ns) / 1e9 < START_S + END_S + 2.0
    assert running(system) == []


def test_a_node_that_dies_before_the_start_is_named_at_once(tmp_path: Path) -> None:
    system = VirtualSystem(start_s=5.0)
    flight = prepared(SCENARIO, tmp_path, system=system, on_death="restart")

    async def kill(flight: VirtualFlight) -> None:
        await flight.until(lambda: "blue.gcs" in system.processes, 5.0, "a process")
        system.process("blue.gcs").kill()

    began_ns = system.virtual.now_ns
    with pytest.raises(ComponentError, match=r"blue\.gcs: signal SIGKILL"):
        fly_virtual(flight, kill)
    assert (system.virtual.now_ns - began_ns) / 1e9 < 15.0
    assert running(system) == []


def test_all_boot_before_time_0_and_are_paced_by_the_clock(tmp_path: Path) -> None:
    """One pace for all: the range's time is the clock's, and a node is never behind where nothing holds it up."""
    seen: list[tuple[float, float]] = []

    async def look(flight: VirtualFlight) -> None:
        while True:
            member = flight.range.members.get("world")
            if member is not None and member.state == "flying":
                seen.append((flight.range.now_s, member.status["now_ns"] / 1e9))
            await asyncio.sleep(0.1)

    system = VirtualSystem(start_s=3.0)
    record = fly_virtual(prepared(SCENARIO, tmp_path, system=system), look)
    assert record.status == "complete"
    assert record.manifest["timings"]["real_time_factor"] == pytest.approx(1.0, abs=0.1)
    assert record.manifest["live"]["fell_behind"] == []
    # it reports twice a second, and is never ahead of the clock
    flown = [(now, told) for now, told in seen if 1.0 < now < 10.0]
    assert len(flown) > 80
    assert all(-0.6 < told - now <= 0.0 for now, told in flown), flown


def test_ctrl_c_ends_it_and_the_record_is_whole(tmp_path: Path) -> None:
    flight = prepared(SCENARIO, tmp_path)

    async def interrupt(flight: VirtualFlight) -> None:
        await flight.reach(6.0)
        flight.interrupt.requested = True

    with pytest.raises(ShortfallError, match=r"interrupted at 6\.\d s"):
        fly_virtual(flight, interrupt)
    record = load(flight.folder)
    assert record.status == "interrupted"
    assert {node["status"] for node in record.manifest["nodes"]} == {"interrupted"}
    assert max(record.table("truth", ["time_ns"]).column("time_ns").to_pylist()) > 5.9e9
    assert not (flight.folder / ".parts").exists()


def test_ctrl_c_while_processes_come_up_starts_nothing_any_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flight, sent = prepared(SCENARIO, tmp_path), list[str]()
    send = MemoryControlServer.send

    async def record_kind(self: MemoryControlServer, who: str, kind: str, blob: bytes = b"", /, **data: Any) -> None:
        sent.append(kind)
        await send(self, who, kind, blob, **data)

    monkeypatch.setattr(MemoryControlServer, "send", record_kind)

    async def interrupt(flight: VirtualFlight) -> None:
        await flight.until(lambda: "warm_up" in sent, 60.0, "a process that comes up")
        flight.interrupt.requested = True

    with pytest.raises(ShortfallError, match=r"interrupted at 0\.0 s"):
        fly_virtual(flight, interrupt)
    assert set(sent) == {"warm_up", "stop"}
    assert running(flight.system) == []
    assert load(flight.folder).status == "interrupted"


@pytest.mark.slow
def test_a_node_is_started_anew_three_times_and_no_more(tmp_path: Path) -> None:
    flight = prepared(SCENARIO.replace("duration_s = 10", "duration_s = 12"), tmp_path, on_death="restart")

    async def kill(flight: VirtualFlight) -> None:
        await flight.reach(1.0)
        while True:
            flight.system.process("blue.gcs").kill()
            await asyncio.sleep(2.0)

    record = fly_virtual(flight, kill)
    assert len(flight.system.processes["blue.gcs"]) == 4
    assert record.manifest["live"]["started_anew"] == {"blue.gcs": ["signal SIGKILL"] * 3}
    assert record.manifest["live"]["ended"] == {"blue.gcs": "signal SIGKILL"}
    assert [node["status"] for node in record.manifest["nodes"] if node["name"] == "blue.gcs"] == ["killed"] * 4


def test_a_node_whose_code_breaks_is_named_with_its_last_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flight = prepared(SCENARIO, tmp_path)
    advance = Node._advance

    def broken(node: Node, now: int) -> None:
        if now > 2e9 and node._config.name == "blue.gcs":
            raise ZeroDivisionError("by nothing")
        advance(node, now)

    monkeypatch.setattr(Node, "_advance", broken)
    with pytest.raises(ComponentError, match=r"(?s)blue\.gcs: exit 1\. It said last:.*ZeroDivisionError: by nothing"):
        run_range(flight.range)
    assert running(flight.system) == []
    record = load(flight.folder)
    assert record.status == "failed"
    assert {node["name"]: node["status"] for node in record.manifest["nodes"]}["blue.gcs"] == "failed"
