"""Faults injected into a live range in flight: on processes and sockets, or in virtual time; the table of the docs.

`python -m tests.integration.live_faults docs/explanation/live-faults.md` flies all of them for some ten minutes, and
puts the table into the page.
"""

from __future__ import annotations

import asyncio
import itertools
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from skyrange.core.errors import ComponentError, SkyrangeError
from skyrange.core.time import NS_PER_S
from skyrange.record import RunRecord, load
from tests.integration.live_programs import MAIN, nodes, until
from tests.integration.live_virtual import JITTER_S, VirtualFlight, fly_virtual, prepared
from tests.live_ranges import VirtualNetwork, VirtualSystem
from tests.ports import OFFSET

SCENARIO = """
name = "faults"
seed = 4
duration_s = {seconds}

[origin]
lat = -35.363328
lon = 149.1652241

[radio]

[live]
on_death = "{on_death}"

[[operators]]
id = "blue"

[[operators.vehicles]]
id = "b1"
plan = {{ path = {{ points = [[0.0, 30.0]], alt_m = 4.0 }}, end = "land" }}
params = {{ FS_GCS_ENABLE = 1, FS_GCS_TIMEOUT = 4, RTL_ALT = 400, RTL_LOIT_TIME = 0 }}

[[operators.vehicles]]
id = "b2"
start = [40.0, 0.0]
plan = {{ path = {{ points = [[0.0, 30.0]], alt_m = 4.0 }}, end = "land" }}
params = {{ FS_GCS_ENABLE = 1, FS_GCS_TIMEOUT = 25, RTL_ALT = 400, RTL_LOIT_TIME = 0 }}
"""
"""Two aircraft, 30 m out and down there: within 33 s if nothing comes in between. b1's autopilot goes home four seconds
after it last heard its ground station, b2's after 25."""
ALOFT_S = 5.0
"""From when both took off to the fault: they are on their way out."""
START_S = 3.0
"""What a process takes to start, as docs/explanation/live-faults.md says of real ones; in virtual time."""
SAID = {
    "decision.link_lost": "link lost",
    "decision.link_restored": "link restored",
    "decision.resumed": "flies already: watched",
    "decision.left": "has flown already",
    "decision.gave_up": "given up",
}
DONE = {"event.landed": "landed"}


class Row(NamedTuple):
    """A line of the table."""

    fault: str
    aircraft: str
    station: str
    """What its ground station notes from then on."""
    autopilot: str
    outcome: str


class Harmed(Protocol):
    """A live range that faults are injected into."""

    hit_s: float
    """The range's time at which the first fault was injected."""

    async def kill(self, *parts: str) -> None:
        """Kill the processes that record into these parts."""

    async def pause(self, part: str, seconds: float = 5.0) -> None:
        """Stop a process, and let it go on."""

    async def hold_up(self, part: str, seconds: float = 4.0) -> None:
        """Have a process that is being started take so much longer, at least: b1's failsafe does not wait for it."""

    async def until(self, time_s: float) -> None:
        """Wait for the range's time."""

    async def cut_tcp(self) -> None:
        """Reset the TCP connection of the link log:blue/b2."""

    async def fill_disk(self) -> None:
        """Let no process write any more."""


@dataclass
class RealHarmed:
    """A live range of processes in a folder of its own. Its methods block: nothing else runs in their event loop."""

    folder: Path
    process: subprocess.Popen[str]
    out: str = ""
    err: str = ""
    hit_s: float = 0.0

    @classmethod
    def start(cls, folder: Path, seconds: float, on_death: str) -> RealHarmed:
        scenario = folder / "faults.toml"
        scenario.write_text(SCENARIO.format(seconds=seconds, on_death=on_death))
        command = [
            sys.executable, "-c", MAIN, "live", str(scenario), "--out", str(folder / "run"),
            "--port-offset", str(OFFSET), "--json",
        ]  # fmt: skip
        return cls(folder, subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True))

    def now_s(self) -> float:
        """The range's time, as its world last recorded it; -1 before."""
        part = self.part("world")
        if not (part / ".spool" / "truth-0000.arrows").exists():
            return -1.0
        times = load(part).table("truth", ["time_ns"]).column("time_ns")
        return max(times.to_pylist(), default=-NS_PER_S) / NS_PER_S

    def reach(self, time_s: float) -> None:
        until(lambda: self.now_s() >= time_s, 300.0, f"{time_s:g} s of flight", self.process)
        self.hit_s = self.hit_s or time_s

    async def until(self, time_s: float) -> None:
        self.reach(time_s)

    def aloft(self) -> None:
        """Wait until both have been in the air for a while."""

        def taken_off() -> bool:
            part = self.part("world")
            kinds = load(part).table("events", ["kind"]).column("kind").to_pylist() if self.now_s() > 0 else []
            return kinds.count("event.takeoff") == 2

        until(taken_off, 300.0, "both aloft", self.process)
        self.reach(self.now_s() + ALOFT_S)

    def part(self, node: str) -> Path:
        return self.folder / "run" / ".parts" / node

    def pid(self, node: str) -> int:
        return nodes(self.folder)[node]

    async def kill(self, *parts: str) -> None:
        for part in parts:
            os.kill(self.pid(part), signal.SIGKILL)

    async def pause(self, part: str, seconds: float = 5.0) -> None:
        pid = self.pid(part)
        os.kill(pid, signal.SIGSTOP)
        time.sleep(seconds)
        os.kill(pid, signal.SIGCONT)

    async def hold_up(self, part: str, seconds: float = 4.0) -> None:
        until(lambda: part in nodes(self.folder), 20.0, f"a start of {part}", self.process)
        await self.pause(part, seconds)

    async def cut_tcp(self) -> None:
        cut = ["ss", "-K", "dst", "127.0.0.1", "dport", "=", f":{14561 + OFFSET}"]
        subprocess.run(cut, check=True, capture_output=True)

    async def fill_disk(self) -> None:
        for pid in (*nodes(self.folder).values(), self.process.pid):
            resource.prlimit(pid, resource.RLIMIT_FSIZE, (20_000, 20_000))

    def end(self) -> RunRecord:
        """Wait for its end; its record."""
        try:
            self.out, self.err = self.process.communicate(timeout=150.0)
        finally:
            self.process.kill()
        return load(self.folder / "run")


@dataclass
class VirtualHarmed:
    """A live range in virtual time."""

    flight: VirtualFlight
    hit_s: float = 0.0
    ended_by: SkyrangeError | None = None

    @classmethod
    def start(cls, folder: Path, seconds: float, on_death: str) -> VirtualHarmed:
        system = VirtualSystem(network=VirtualNetwork(jitter_s=JITTER_S), start_s=START_S)
        return cls(prepared(SCENARIO.format(seconds=seconds, on_death=on_death), folder, system=system))

    async def until(self, time_s: float) -> None:
        await self.flight.reach(time_s)

    async def kill(self, *parts: str) -> None:
        for part in parts:
            process = self.flight.process(part)
            assert process is not None
            process.kill()

    async def pause(self, part: str, seconds: float = 5.0) -> None:
        process = self.flight.process(part)
        assert process is not None
        process.pause()
        await asyncio.sleep(seconds)
        process.resume()

    async def hold_up(self, part: str, seconds: float = 4.0) -> None:
        await self.flight.until(lambda: self.flight.process(part), 20.0, f"a start of {part}")
        await self.pause(part, seconds)

    async def cut_tcp(self) -> None:
        self.flight.system.network.cut_connections(14561)

    async def fill_disk(self) -> None:
        raise NotImplementedError("the disk is the system's")


def story(record: Any, vehicle: str, since_s: float) -> tuple[str, str, str]:
    """What the ground station noted of an aircraft, what its autopilot did, and how its mission ended."""

    def lately(table: str) -> list[dict[str, Any]]:
        rows = record.table(table).to_pylist()
        return [row for row in rows if row["about"] == vehicle and row["time_ns"] >= since_s * NS_PER_S]

    said = [SAID[row["kind"]] for row in lately("decisions") if row["kind"] in SAID]
    while "link restored" in said:  # whether it ever counted as lost depends on how long a start takes
        said.remove("link restored")
        said.remove("link lost")
    did = []
    for row in lately("events"):
        data = json.loads(row["data"])
        if row["kind"] == "event.mode":
            did.append(f"{data['mode']} ({data['reason'].replace('_', ' ')})")
        elif row["kind"] in DONE:
            did.append(DONE[row["kind"]])
    outcome = record.outcomes[vehicle]
    ended = outcome["state"] + (f": {outcome['reason']}" if outcome["reason"] else "")
    return ", ".join(said) or "nothing", ", ".join(did) or "nothing", ended


def gap_s(record: Any, sender: str) -> float:
    """The longest time in flight in which a ground station sent nothing."""
    table = record.table("frames", ["link", "sender", "sent_ns"]).to_pylist()
    sent = sorted(row["sent_ns"] for row in table if row["sender"] == sender and row["link"].startswith("gcs:"))
    return float(max(later - earlier for earlier, later in itertools.pairwise(sent)) / NS_PER_S)


@dataclass(frozen=True)
class LiveFault:
    """Something done to a range that flies, and what the table says of it."""

    name: str
    what: str
    do: Callable[[Harmed], Awaitable[None]]
    seconds: float = 40.0
    on_death: str = "restart"
    code: int = 0
    """With which `skyrange live` ends."""
    told: Sequence[str] = ("blue/b1", "blue/b2")
    differs: dict[str, str] = field(default_factory=dict)
    """Where it was done to each aircraft in another way."""

    def rows(self, record: Any, harmed: Harmed) -> list[Row]:
        return [
            Row(self.differs.get(vehicle, self.what), vehicle, *story(record, vehicle, harmed.hit_s))
            for vehicle in self.told
        ]


async def _kill_station(harmed: Harmed) -> None:
    await harmed.kill("blue.gcs")
    await harmed.hold_up("blue.gcs.2")


async def _kill_others(harmed: Harmed) -> None:
    await harmed.kill("blue-b1.companion", "blue-b2.proxy", "approval")
    await harmed.hold_up("blue-b1.companion.2")


async def _kill_others_for_good(harmed: Harmed) -> None:
    await harmed.kill("blue-b1.companion", "blue-b2.proxy", "approval")


async def _kill_world(harmed: Harmed) -> None:
    await harmed.kill("world")


async def _pause_station(harmed: Harmed) -> None:
    await harmed.pause("blue.gcs")


async def _pause_world(harmed: Harmed) -> None:
    await harmed.pause("world")


async def _cut_tcp(harmed: Harmed) -> None:
    for number in range(5):
        await harmed.cut_tcp()
        await harmed.until(harmed.hit_s + 1.0 + number)


async def _fill_disk(harmed: Harmed) -> None:
    await harmed.fill_disk()


FAULTS = (
    LiveFault("station", "ground station killed, and started anew", _kill_station),
    LiveFault(
        "others", "", _kill_others,
        differs={
            "blue/b1": "companion killed (and the approval), and started anew",
            "blue/b2": "proxy killed (and the approval), and started anew",
        },
    ),
    LiveFault(
        "others for good", "", _kill_others_for_good, on_death="continue",
        differs={
            "blue/b1": "companion killed (and the approval), `continue`",
            "blue/b2": "proxy killed (and the approval), `continue`",
        },
    ),
    LiveFault("world", "world killed", _kill_world, code=3),
    LiveFault("station paused", "ground station paused for 5 s", _pause_station),
    LiveFault("world paused", "world with all autopilots paused for 5 s", _pause_world),
    LiveFault("link", "TCP of the link log:blue/b2 cut, five times", _cut_tcp),
    LiveFault("disk", "no room on the disk", _fill_disk, on_death="stop", code=3),
)  # fmt: skip
HEAD = Row(
    "what was done 5 s after take-off", "aircraft", "its ground station notes", "its autopilot changes to", "mission"
)


def harm(fault: LiveFault, folder: Path) -> tuple[RealHarmed, RunRecord]:
    """Inject it into a range of real processes; the range and its record."""
    harmed = RealHarmed.start(folder, fault.seconds, fault.on_death)
    try:
        harmed.aloft()
        asyncio.run(_inject(fault, harmed))
        record = harmed.end()
    finally:
        harmed.process.kill()
    assert harmed.process.returncode == fault.code, harmed.err
    until(lambda: not nodes(folder), 10.0, "no process left")
    return harmed, record


def harm_virtual(fault: LiveFault, folder: Path) -> tuple[VirtualHarmed, RunRecord]:
    """Inject it into a range in virtual time; the range and its record."""
    harmed = VirtualHarmed.start(folder, fault.seconds, fault.on_death)

    async def meddle(flight: VirtualFlight) -> None:
        await flight.decided("world", "events", "event.takeoff", 2)
        await flight.reach(flight.range.now_s + ALOFT_S)
        harmed.hit_s = flight.range.now_s
        await fault.do(harmed)

    try:
        record = fly_virtual(harmed.flight, meddle)
    except ComponentError as error:
        harmed.ended_by, record = error, load(harmed.flight.folder)
    code = harmed.ended_by.exit_code if harmed.ended_by is not None else 0
    assert code == fault.code, harmed.ended_by
    assert not any(process.running for starts in harmed.flight.system.processes.values() for process in starts)
    return harmed, record


async def _inject(fault: LiveFault, harmed: Harmed) -> None:
    await fault.do(harmed)


def table(rows: Sequence[Row]) -> str:
    """As Markdown."""
    lines = ["| " + " | ".join(row) + " |" for row in (HEAD, *rows)]
    return "\n".join([lines[0], "|" + "---|" * len(HEAD), *lines[1:]])


def rows_of(page: str) -> list[Row]:
    """What `table` wrote."""
    lines = [line for line in page.splitlines() if line.startswith("| ")]
    found = [Row(*(cell.strip() for cell in line.strip("| ").split(" | "))) for line in lines if line.count(" | ") == 4]
    return [row for row in found if row != HEAD]


def main(page: Path) -> None:
    rows = []
    for fault in FAULTS:
        folder = Path(tempfile.mkdtemp(prefix="faults-"))
        harmed, record = harm(fault, folder)
        rows += fault.rows(record, harmed)
        print(*rows[-2:], sep="\n", flush=True)
        shutil.rmtree(folder)
    text = page.read_text()
    made = re.sub(
        r"(<!-- faults -->\n).*?(<!-- end -->)", lambda at: f"{at[1]}{table(rows)}\n{at[2]}", text, flags=re.S
    )
    page.write_text(made)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
