"""Every socket of a live range in flight gets random bytes, half messages, floods and slow readers: it survives."""

from __future__ import annotations

import os
import random
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
import zmq
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from skyrange.record.read.run import RunRecord
from skyrange.runtime.live.config import NodeConfig
from tests.integration.live_faults import RealHarmed
from tests.integration.live_programs import nodes

pytestmark = pytest.mark.realtime
SECONDS = 20.0
MOST_GROWN_KB = 150_000
"""Of a process's resident memory, over what it had when the range flew and nobody harmed it: ZeroMQ queues of 256
messages, the intake's 64 MB at worst, and 4 MB of rows before they are handed to the disk."""
HALF = mavlink.MAVLink(None, srcSystem=1).heartbeat_encode(2, 3, 0, 0, 3).pack(mavlink.MAVLink(None, srcSystem=1))[:9]
Address = tuple[str, int]
ZMTP = b"\xff\0\0\0\0\0\0\0\1\x7f"
"""How a ZeroMQ greeting begins."""


class Hostile:
    """Threads that mistreat addresses until they are stopped."""

    def __init__(self, seed: int) -> None:
        self.over = threading.Event()
        self.sent: dict[str, int] = {}
        """How often each was done."""
        self._seed = seed
        self._threads: list[threading.Thread] = []

    def begin(self, what: Callable[[Address, random.Random], None], address: Address, pause_s: float) -> None:
        """Do `what` to `address` again and again."""
        chance = random.Random(f"{self._seed} {what.__name__} {address}")

        def again() -> None:
            while not self.over.is_set():
                with suppress(OSError, zmq.ZMQError):
                    what(address, chance)
                    self.sent[what.__name__] = self.sent.get(what.__name__, 0) + 1
                self.over.wait(pause_s)

        self._threads.append(threading.Thread(target=again, daemon=True))
        self._threads[-1].start()

    def end(self) -> None:
        self.over.set()
        for thread in self._threads:
            thread.join(10.0)
            assert not thread.is_alive()


def datagrams(address: Address, chance: random.Random) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        for _ in range(200):
            own.sendto(chance.randbytes(chance.randrange(0, 1400)), address)
            own.sendto(HALF, address)


def streams(address: Address, chance: random.Random) -> None:
    with socket.create_connection(address, 1.0) as own:
        own.sendall(chance.choice([b"", HALF, ZMTP, b"PUT / HTTP/1.1\r\nContent-Length: 9999\r\n\r\n{"]))
        own.sendall(chance.randbytes(chance.randrange(0, 100_000)))


def many_connections(address: Address, chance: random.Random) -> None:
    own = []
    with suppress(OSError):
        own += [socket.create_connection(address, 1.0) for _ in range(50)]
    time.sleep(chance.random())
    for one in own:
        one.close()


def slow_readers(address: Address, chance: random.Random) -> None:
    with socket.socket() as own:
        own.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        own.settimeout(1.0)
        own.connect(address)
        own.sendall(b"GET / HTTP/1.1\r\n" + chance.randbytes(3))
        time.sleep(3.0)


def dealers(address: Address, chance: random.Random) -> None:
    """Let in by ZeroMQ, and no good: a flood, messages of many parts, one that is too long; never reading."""
    with zmq.Context() as context, context.socket(zmq.DEALER) as own:
        own.linger = 0
        own.sndtimeo = 500
        own.connect(f"tcp://{address[0]}:{address[1]}")
        for _ in range(5000):
            own.send(chance.randbytes(chance.randrange(1, 60)))
        own.send_multipart([chance.randbytes(9)] * 50)
        own.send(bytes(1 << 22))
        time.sleep(1.0)


def requests(address: Address, chance: random.Random) -> None:
    body = chance.randbytes(chance.randrange(1, 2000))
    head = f"PUT /uss/v1/x{chance.random()} HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\n"
    with socket.create_connection(address, 1.0) as own:
        for _ in range(20):
            own.sendall(head.encode() + b"Content-Length: %d\r\n\r\n" % len(body) + body)


def resident_kb(pid: int) -> int:
    with suppress(OSError):
        for line in Path(f"/proc/{pid}/status").read_text().splitlines():
            if line.startswith("VmRSS"):
                return int(line.split()[1])
    return 0


def addresses(folder: Path) -> dict[str, tuple[str, Address]]:
    """Transport and address of everything that listens, by link, and the control socket."""
    found: dict[str, tuple[str, Address]] = {}
    for path in (folder / "run" / ".parts").glob("*.program/node.json"):
        config = NodeConfig.from_json(path.read_text())
        found["control"] = ("control", config.control)
        found |= {one.link.name: (one.transport, one.address) for one in config.crossings}
    return found


WAYS: dict[str, tuple[tuple[Callable[[Address, random.Random], None], float], ...]] = {
    "udp": ((datagrams, 0.2),),
    "tcp": ((streams, 0.3), (many_connections, 2.0), (slow_readers, 1.0)),
    "zmq": ((streams, 0.5), (many_connections, 3.0), (slow_readers, 1.0), (dealers, 1.0)),
    "http": ((streams, 0.3), (requests, 0.3), (many_connections, 3.0), (slow_readers, 1.0)),
    "control": ((streams, 0.3), (many_connections, 2.0), (dealers, 2.0)),
}


def test_it_flies_on_under_random_bytes_floods_and_slow_readers(tmp_path: Path) -> None:
    harmed = RealHarmed.start(tmp_path, 40.0, "stop")
    hostile = Hostile(os.getpid())
    grown: dict[str, int] = {}
    try:
        harmed.reach(7.0)
        targets = addresses(tmp_path)
        assert {transport for transport, _ in targets.values()} == set(WAYS)
        pids = nodes(tmp_path)
        before = {name: resident_kb(pid) for name, pid in pids.items()}
        for transport, address in targets.values():
            for what, pause_s in WAYS[transport]:
                hostile.begin(what, address, pause_s)
        ends = time.monotonic() + SECONDS
        while time.monotonic() < ends and harmed.process.poll() is None:
            for name, pid in pids.items():
                grown[name] = max(grown.get(name, 0), resident_kb(pid) - before[name])
            time.sleep(0.5)
        hostile.end()
        record: RunRecord = harmed.end()
    finally:
        hostile.over.set()
        harmed.process.kill()
    assert harmed.process.returncode == 0, harmed.err
    assert record.status == "complete"
    assert {vehicle: outcome["state"] for vehicle, outcome in record.outcomes.items()} == {
        "blue/b1": "complete",
        "blue/b2": "complete",
    }
    assert set(hostile.sent) == {what.__name__ for ways in WAYS.values() for what, _ in ways}
    assert max(grown.values()) < MOST_GROWN_KB, grown
    live = record.manifest["live"]
    assert live["refused"] > 0  # at the control socket
    counts = live["counts"]
    assert counts["blue.gcs"]["garbage"] > 100
    assert all(counts[name]["refused"] > 10 for name in ("world", "approval", "blue/b1.proxy", "blue/b2.proxy"))
    assert counts["world"]["dropped"] > 0
    strange = [row for row in record.table("frames", ["link", "sender"]).to_pylist() if row["sender"] == "outside"]
    assert {row["link"].partition(":")[0] for row in strange} >= {"gcs", "rid_up", "rid_data"}
    kinds = set(record.table("decisions", ["kind"]).column("kind").to_pylist())
    assert "decision.bad_frame" in kinds
