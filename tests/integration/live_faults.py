"""What becomes of a live range that is harmed in mid-flight? Each fault on a real range; the table of the docs.

`python -m tests.integration.live_faults docs/explanation/live-faults.md` flies all, for some ten minutes, and puts the
table into the page.
"""

from __future__ import annotations

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
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from skyrange.core.time import NS_PER_S
from skyrange.record import load
from tests.integration.live_programs import until
from tests.integration.test_live_range import MAIN, nodes
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
"""So long after both took off faults are done: they are on their way out."""
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


@dataclass
class Harmed:
    """A live range in a folder of its own."""

    folder: Path
    process: subprocess.Popen[str]
    out: str = ""
    err: str = ""
    hit_s: float = 0.0

    @classmethod
    def start(cls, folder: Path, seconds: float, on_death: str) -> Harmed:
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

    def until(self, time_s: float) -> None:
        """Wait for the range's time."""
        until(lambda: self.now_s() >= time_s or self.process.poll() is not None, 300.0, f"{time_s:g} s of flight")
        assert self.process.poll() is None, self.process.communicate()
        self.hit_s = self.hit_s or time_s

    def aloft(self) -> None:
        """Wait until both have been in the air for a while."""

        def taken_off() -> bool:
            part = self.part("world")
            if self.process.poll() is not None:
                return True
            kinds = load(part).table("events", ["kind"]).column("kind").to_pylist() if self.now_s() > 0 else []
            return kinds.count("event.takeoff") == 2

        until(taken_off, 300.0, "both aloft")
        self.until(self.now_s() + ALOFT_S)

    def part(self, node: str) -> Path:
        return self.folder / "run" / ".parts" / node

    def pid(self, node: str) -> int:
        return nodes(self.folder)[node]

    def kill(self, *names: str) -> None:
        for name in names:
            os.kill(self.pid(name), signal.SIGKILL)

    def pause(self, name: str, seconds: float = 5.0) -> None:
        pid = self.pid(name)
        os.kill(pid, signal.SIGSTOP)
        time.sleep(seconds)
        os.kill(pid, signal.SIGCONT)

    def hold_up(self, name: str, seconds: float = 4.0) -> None:
        """Have a process that is being started take so much longer, at least: b1's failsafe does not wait for it."""
        until(lambda: name in nodes(self.folder), 20.0, f"a start of {name}")
        self.pause(name, seconds)

    def end(self) -> Any:
        """Wait for its end; its record."""
        try:
            self.out, self.err = self.process.communicate(timeout=150.0)
        finally:
            self.process.kill()
        return load(self.folder / "run")


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
    return max(later - earlier for earlier, later in itertools.pairwise(sent)) / NS_PER_S


@dataclass(frozen=True)
class Fault:
    """Something done to a range that flies, and what the table says of it."""

    name: str
    what: str
    do: Callable[[Harmed], None]
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


def _station_killed(harmed: Harmed) -> None:
    harmed.kill("blue.gcs")
    harmed.hold_up("blue.gcs.2")


def _others_killed(harmed: Harmed) -> None:
    harmed.kill("blue-b1.companion", "blue-b2.proxy", "approval")
    harmed.hold_up("blue-b1.companion.2")


def _others_killed_for_good(harmed: Harmed) -> None:
    harmed.kill("blue-b1.companion", "blue-b2.proxy", "approval")


def _world_killed(harmed: Harmed) -> None:
    harmed.kill("world")


def _station_paused(harmed: Harmed) -> None:
    harmed.pause("blue.gcs")


def _world_paused(harmed: Harmed) -> None:
    harmed.pause("world")


def _tcp_cut(harmed: Harmed) -> None:
    for number in range(5):
        cut = ["ss", "-K", "dst", "127.0.0.1", "dport", "=", f":{14561 + OFFSET}"]
        subprocess.run(cut, check=True, capture_output=True)
        harmed.until(harmed.hit_s + 1.0 + number)


def _disk_full(harmed: Harmed) -> None:
    for pid in (*nodes(harmed.folder).values(), harmed.process.pid):
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (20_000, 20_000))


FAULTS = (
    Fault("station", "ground station killed, and started anew", _station_killed),
    Fault(
        "others", "", _others_killed,
        differs={
            "blue/b1": "companion killed (and the approval), and started anew",
            "blue/b2": "proxy killed (and the approval), and started anew",
        },
    ),
    Fault(
        "others for good", "", _others_killed_for_good, on_death="continue",
        differs={
            "blue/b1": "companion killed (and the approval), `continue`",
            "blue/b2": "proxy killed (and the approval), `continue`",
        },
    ),
    Fault("world", "world killed", _world_killed, code=3),
    Fault("station paused", "ground station paused for 5 s", _station_paused),
    Fault("world paused", "world with all autopilots paused for 5 s", _world_paused),
    Fault("link", "TCP of the link log:blue/b2 cut, five times", _tcp_cut),
    Fault("disk", "no room on the disk", _disk_full, on_death="stop", code=3),
)  # fmt: skip
HEAD = Row(
    "what was done 5 s after take-off", "aircraft", "its ground station notes", "its autopilot changes to", "mission"
)


def harm(fault: Fault, folder: Path) -> tuple[Harmed, Any]:
    """Do it; the range and its record."""
    harmed = Harmed.start(folder, fault.seconds, fault.on_death)
    try:
        harmed.aloft()
        fault.do(harmed)
        record = harmed.end()
    finally:
        harmed.process.kill()
    assert harmed.process.returncode == fault.code, harmed.err
    until(lambda: not nodes(folder), 10.0, "no process left")
    return harmed, record


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
