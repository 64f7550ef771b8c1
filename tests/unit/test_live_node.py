"""One node of a live range by itself, in virtual time: peers that keep no order, taken addresses, clock changes."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable
from pathlib import Path

import pytest
import zmq
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from skyrange.assembly.build import build
from skyrange.core.errors import ComponentError
from skyrange.core.time import NS_PER_MS, NS_PER_S
from skyrange.io.mavlink.transports import UdpTransport
from skyrange.record import Recorder, load
from skyrange.record.folder import put_file
from skyrange.runtime.live.config import NodeConfig
from skyrange.runtime.live.deployment import assign_components
from skyrange.runtime.live.node.node import PAUSE_NS, SLICE_NS, Node
from skyrange.runtime.live.node.process import run_node
from skyrange.runtime.live.transport.addresses import Crossing, crossings, issue_credentials
from skyrange.runtime.live.transport.control import ControlClient, Message
from skyrange.scenario.toml_files import load_data
from tests.live_ranges import VirtualSystem

SCENARIO = {
    "name": "alone",
    "duration_s": 60.0,
    "origin": [-35.0, 149.0],
    "operators": [{"id": "blue", "vehicles": [{"id": "b1", "plan": {"path": {"points": [[0.0, 9.0]], "alt_m": 5.0}}}]}],
}
HEARTBEAT = mavlink.MAVLink(None, srcSystem=1).heartbeat_encode(2, 3, 0, 0, 3).pack(mavlink.MAVLink(None, srcSystem=1))


def alone(folder: Path, name: str, *endpoints: str) -> tuple[VirtualSystem, Node, Recorder, Crossing]:
    """A node that nobody else is there for, and where its link `gcs` is."""
    system = VirtualSystem()
    scenario = load_data(SCENARIO, "test")
    links = build(scenario).wiring.links
    place = next(
        one for one in crossings(links, assign_components(links, "component")) if one.link.name == "gcs:blue/b1"
    )
    built = build(scenario, local=frozenset(endpoints))
    recorder = Recorder.open(folder, built.header | {"node": {"name": name, "endpoints": list(endpoints)}})
    credentials = issue_credentials(zmq.curve_keypair()[0])
    config = NodeConfig(name, endpoints, "", "127.0.0.1", ("127.0.0.1", 1), (place,), credentials)
    return system, Node(config, built, recorder, system), recorder, place


def station(folder: Path) -> tuple[VirtualSystem, Node, Recorder, Crossing]:
    return alone(folder, "blue.gcs", "blue.gcs")


async def until(holds: Callable[[], object], seconds: float = 10.0) -> None:
    async with asyncio.timeout(seconds):
        while not holds():
            await asyncio.sleep(0.001)


def test_what_comes_before_the_start_is_counted_and_dropped(tmp_path: Path) -> None:
    system, node, recorder, place = station(tmp_path / "run")

    async def live() -> str:
        await node.bind()
        peer = await UdpTransport.open(lambda _: None, remote=place.address)
        peer.send(HEARTBEAT)
        await until(lambda: node.counts.early)
        await node.connect()
        node.boot()
        flying = asyncio.create_task(node.run(system.clock.monotonic_ns()))
        await until(lambda: node.status["now_ns"] >= 0)
        peer.send(HEARTBEAT)
        await until(lambda: node.counts.received)
        node.stop("interrupted")
        status = await flying
        node.close()
        recorder.close(status)
        return status

    assert system.run(live()) == "interrupted"
    assert (node.counts.early, node.counts.received) == (1, 1)
    frames = load(tmp_path / "run").table("frames").to_pylist()
    (heard,) = [row for row in frames if row["link"] == "gcs:blue/b1" and row["direction"] == "rev"]
    assert 0 <= heard["arrived_ns"] <= node.status["now_ns"]


def test_an_address_in_use_is_named(tmp_path: Path) -> None:
    system, node, recorder, place = station(tmp_path / "run")

    async def bind() -> None:
        await UdpTransport.open(lambda _: None, place.address)
        try:
            await node.bind()
        finally:
            node.close()
            recorder.close("failed")

    with pytest.raises(ComponentError, match=r"blue\.gcs.*gcs:blue/b1 at 127\.0\.0\.1:\d+: [Aa]ddress"):
        system.run(bind())


# --- time ------------------------------------------------------------------------------------------


def flown(
    node: Node, system: VirtualSystem, recorder: Recorder, meddle: Callable[[], object], seconds: float = 5.0
) -> dict[str, float]:
    """Its status after so many seconds; `meddle` is called after three."""

    async def live() -> None:
        await node.bind()
        node.boot()
        flying = asyncio.create_task(node.run(system.clock.monotonic_ns()))
        await asyncio.sleep(3.0)
        meddle()
        await asyncio.sleep(seconds - 3.0)
        node.stop("interrupted")
        await flying
        node.close()
        recorder.close("interrupted")

    system.run(live())
    return dict(node.status)


def test_it_keeps_the_pace_of_the_clock(tmp_path: Path) -> None:
    system, node, recorder, _ = alone(tmp_path / "run", "world", "oracle", "blue/b1.autopilot")
    status = flown(node, system, recorder, lambda: None)
    assert status["now_ns"] == pytest.approx(5 * NS_PER_S, abs=5 * NS_PER_MS)  # two ticks
    assert status["late_ns"] <= NS_PER_MS
    assert status["paused_ns"] == 0


def test_a_clock_that_is_set_back_takes_back_no_time_that_was_reached(tmp_path: Path) -> None:
    system, node, recorder, _ = alone(tmp_path / "run", "world", "oracle", "blue/b1.autopilot")
    zero_ns = system.clock.monotonic_ns()
    status = flown(node, system, recorder, lambda: node.set_zero(zero_ns + NS_PER_S))
    assert status["now_ns"] == pytest.approx(4 * NS_PER_S, abs=5 * NS_PER_MS)
    times = [row["time_ns"] for row in load(tmp_path / "run").table("truth").to_pylist()]
    assert times == sorted(set(times))


def test_a_world_makes_good_what_it_is_behind_slice_by_slice(tmp_path: Path) -> None:
    """Its clock jumps by two seconds: every tick of them happens, and what comes in meanwhile is taken in between."""
    system, node, recorder, _ = alone(tmp_path / "run", "world", "oracle", "blue/b1.autopilot")
    zero_ns = system.clock.monotonic_ns()
    turns: list[int] = []
    advance = node._kernel.advance

    def counted(until: int, inbound: object = ()) -> object:
        turns.append(until - node._kernel.now)
        return advance(until, inbound)  # type: ignore[arg-type]

    node._kernel.advance = counted  # type: ignore[method-assign, assignment]
    status = flown(node, system, recorder, lambda: node.set_zero(zero_ns - 2 * NS_PER_S))
    assert status["now_ns"] == pytest.approx(7 * NS_PER_S, abs=5 * NS_PER_MS)
    assert status["late_ns"] == pytest.approx(2 * NS_PER_S, abs=20 * NS_PER_MS)
    assert status["paused_ns"] == 0
    assert sum(turn for turn in turns if turn > SLICE_NS - 5 * NS_PER_MS) > 1.9 * NS_PER_S
    assert max(turns) <= SLICE_NS + 5 * NS_PER_MS
    times = [row["time_ns"] for row in load(tmp_path / "run").table("truth").to_pylist()]
    assert max(later - earlier for earlier, later in itertools.pairwise(times)) <= NS_PER_S // 10


def test_a_station_that_stood_still_does_once_what_was_due(tmp_path: Path) -> None:
    system, node, recorder, _ = station(tmp_path / "run")
    zero_ns = system.clock.monotonic_ns()
    status = flown(node, system, recorder, lambda: node.set_zero(zero_ns - 4 * NS_PER_S))
    assert status["paused_ns"] == pytest.approx(4 * NS_PER_S, abs=NS_PER_MS)
    assert status["paused_ns"] > PAUSE_NS
    frames = load(tmp_path / "run").table("frames").to_pylist()
    sent = sorted(row["sent_ns"] for row in frames if row["link"] == "gcs:blue/b1")
    # its heartbeats, once a second: none for the time in which it stood still, but one at its end
    assert not [at for at in sent if 3.1 * NS_PER_S < at < 6.9 * NS_PER_S]
    assert len([at for at in sent if 6.9 * NS_PER_S < at < 7.9 * NS_PER_S]) == 1


# --- the supervisor --------------------------------------------------------------------------------


class Scripted:
    """A control client on which a supervisor says what stands here, and then nothing more."""

    name, address, reached, refused = "blue.gcs", ("", 0), 1, 0

    def __init__(self, zero_ns: int) -> None:
        self.messages: list[Message] = [
            {"kind": "warm_up", "rehearse": False},
            {"kind": "connect"},
            {"kind": "start", "zero_ns": zero_ns},
            {"kind": "attack", "id": "nobody", "start_ns": 0},
        ]

    def open(self) -> None: ...

    def close(self) -> None: ...

    async def send(self, kind: str, blob: bytes = b"", /, **data: object) -> None: ...

    async def receive(self) -> tuple[Message, bytes]:
        if not self.messages:
            await asyncio.get_running_loop().create_future()
        return self.messages.pop(0), b""


class ScriptedSystem(VirtualSystem):
    def control_client(self, *_: object) -> ControlClient:
        return Scripted(self.clock.monotonic_ns())


def test_one_that_can_no_longer_obey_ends_and_keeps_its_record(tmp_path: Path) -> None:
    for name, data in build(load_data(SCENARIO, "test")).files.items():
        put_file(tmp_path, name, data)
    (tmp_path / "part.program").mkdir()
    credentials = issue_credentials(zmq.curve_keypair()[0])
    config = NodeConfig("blue.gcs", ("blue.gcs",), "part", "127.0.0.1", ("127.0.0.1", 1), (), credentials)
    system = ScriptedSystem()
    with pytest.raises(KeyError, match="nobody"):
        system.run(asyncio.wait_for(run_node(config, tmp_path, system), 10.0))
    assert load(tmp_path / "part").manifest["status"] == "failed"
