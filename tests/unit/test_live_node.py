"""One process of a live range, on its own: what it makes of a peer that knows no order."""

from __future__ import annotations

import asyncio
import socket
import time
from pathlib import Path

import pytest
import zmq
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from skyrange.core.errors import ComponentError
from skyrange.record import Recorder, load
from skyrange.runtime.live import process
from skyrange.runtime.live.addresses import Crossing, crossings
from skyrange.runtime.live.control import Message
from skyrange.runtime.live.node import Node
from skyrange.runtime.live.orders import NodeConfig
from skyrange.runtime.live.passes import issue
from skyrange.runtime.live.plan import plan
from skyrange.scenario.load import build
from skyrange.scenario.wire import Rig, wire

SCENARIO = {
    "name": "alone",
    "duration_s": 60.0,
    "origin": [-35.0, 149.0],
    "operators": [{"id": "blue", "vehicles": [{"id": "b1", "plan": {"path": {"points": [[0.0, 9.0]], "alt_m": 5.0}}}]}],
}
HEARTBEAT = mavlink.MAVLink(None, srcSystem=1).heartbeat_encode(2, 3, 0, 0, 3).pack(mavlink.MAVLink(None, srcSystem=1))


def free_port(kind: int) -> int:
    with socket.socket(socket.AF_INET, kind) as tried:
        tried.bind(("127.0.0.1", 0))
        return int(tried.getsockname()[1])


def station(folder: Path) -> tuple[Node, Rig, Recorder, Crossing]:
    scenario = build(SCENARIO, "test")
    links = wire(scenario).wiring.links
    made = plan(links, "component")
    port = free_port(socket.SOCK_DGRAM)
    place = next(one for one in crossings(links, made) if one.link.name == "gcs:blue/b1")
    place = Crossing(place.link, place.transport, place.listener, ("127.0.0.1", port))
    rig = wire(scenario, local=frozenset({"blue.gcs"}))
    recorder = Recorder.open(folder, rig.header | {"node": {"name": "blue.gcs", "endpoints": ["blue.gcs"]}})
    passes = issue(zmq.curve_keypair()[0])
    orders = NodeConfig("blue.gcs", ("blue.gcs",), "", "127.0.0.1", ("127.0.0.1", 1), (place,), passes)
    return Node(orders, rig, recorder), rig, recorder, place


def test_what_comes_before_the_start_is_counted_and_dropped(tmp_path: Path) -> None:
    async def live() -> tuple[Node, str]:
        node, _, recorder, place = station(tmp_path / "run")
        await node.bind()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
            peer.sendto(HEARTBEAT, place.address)
            while not node.counts.early:
                await asyncio.sleep(0.01)
            await node.connect()
            node.boot()
            flying = asyncio.create_task(node.fly(time.monotonic_ns()))
            while node.status["now_ns"] < 0:
                await asyncio.sleep(0.01)
            peer.sendto(HEARTBEAT, place.address)
            while not node.counts.received:
                await asyncio.sleep(0.01)
            node.stop("interrupted")
            status = await flying
        node.close()
        recorder.close(status)
        return node, status

    node, status = asyncio.run(live())
    assert status == "interrupted"
    assert (node.counts.early, node.counts.received) == (1, 1)
    frames = load(tmp_path / "run").table("frames").to_pylist()
    (heard,) = [row for row in frames if row["link"] == "gcs:blue/b1" and row["direction"] == "rev"]
    assert 0 <= heard["arrived_ns"] <= node.status["now_ns"]


class Told:
    """A phone on which a supervisor says what stands here, and then nothing more."""

    def __init__(self, *_: object) -> None:
        zero_ns = time.monotonic_ns()
        self.says = [
            {"kind": "warm_up", "rehearse": False},
            {"kind": "connect"},
            {"kind": "start", "zero_ns": zero_ns},
            {"kind": "attack", "id": "nobody", "start_ns": 0},
        ]

    def open(self) -> None: ...

    def close(self) -> None: ...

    async def tell(self, kind: str, blob: bytes = b"", /, **data: object) -> None: ...

    async def hear(self) -> tuple[Message, bytes]:
        if not self.says:
            await asyncio.get_running_loop().create_future()
        return self.says.pop(0), b""


def test_one_that_can_no_longer_obey_ends_and_keeps_its_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process, "Phone", Told)
    monkeypatch.setattr(process, "warm_up", lambda _, rehearse: None)
    for name, data in wire(build(SCENARIO, "test")).attachments.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(data)
    (tmp_path / "part.program").mkdir()
    passes = issue(zmq.curve_keypair()[0])
    orders = NodeConfig("blue.gcs", ("blue.gcs",), "part", "127.0.0.1", ("127.0.0.1", 1), (), passes)
    with pytest.raises(KeyError, match="nobody"):
        asyncio.run(asyncio.wait_for(process.serve(orders, tmp_path), 10.0))
    assert load(tmp_path / "part").manifest["status"] == "failed"


def test_an_address_in_use_is_named(tmp_path: Path) -> None:
    async def bind() -> None:
        node, _, recorder, place = station(tmp_path / "run")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.bind(place.address)
            try:
                await node.bind()
            finally:
                node.close()
                recorder.close("failed")

    with pytest.raises(ComponentError, match=r"blue\.gcs.*gcs:blue/b1 at 127\.0\.0\.1:\d+: [Aa]ddress"):
        asyncio.run(bind())
