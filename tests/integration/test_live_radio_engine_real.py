"""Radio engines of live ranges of real processes: killed and replaced, and ended with their range."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from skyrange.core.time import NS_PER_S
from skyrange.radio.external.ns3 import VARIABLE
from tests.integration.live_programs import live, nodes, until
from tests.integration.radio_program import SCENARIO, write_program
from tests.ports import OFFSET
from tests.radio_engines import needs_ns3

pytestmark = pytest.mark.realtime


def children(pid: int) -> list[int]:
    """The process ids of the children of a process (proc_pid_stat(5), field 4)."""
    found = []
    for entry in Path("/proc").iterdir():
        try:
            fields = (entry / "stat").read_text().rpartition(")")[2].split() if entry.name.isdigit() else []
        except OSError:
            continue
        if fields and int(fields[1]) == pid and fields[0] != "Z":
            found.append(int(entry.name))
    return found


@needs_ns3
def test_ns3_that_is_killed_is_started_again(tmp_path: Path) -> None:
    scenario = SCENARIO.format(seconds=20, on_death="restart")
    with live(tmp_path, scenario, OFFSET, "--group", "one") as flight:
        flight.flying()
        world = nodes(tmp_path)["world"]
        (engine,) = children(world)
        os.kill(engine, signal.SIGKILL)
        until(lambda: children(world) not in ([], [engine]), 10.0, "another engine", flight.program)
        (second,) = children(world)
        summary, record = flight.landed()
    told = summary["live"]["programs"]["radio engine ns3"]
    assert (told["state"], len(told["ended"])) == ("ready", 1)
    assert "signal SIGKILL" in told["ended"][0]
    kinds = [row["kind"] for row in record.table("events").to_pylist() if row["about"] == "radio engine ns3"]
    assert kinds == ["event.engine_dead", "event.engine_ready"]
    assert max(record.table("receptions", ["time_ns"]).column("time_ns").to_pylist()) > 18 * NS_PER_S
    assert not Path(f"/proc/{second}").exists()


def test_an_engine_ends_with_its_range(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Even one that is stopped, and whose world is killed."""
    monkeypatch.setenv(VARIABLE, str(write_program(tmp_path)))
    scenario = SCENARIO.format(seconds=60, on_death="restart")
    with live(tmp_path, scenario, OFFSET, "--group", "one") as flight:
        flight.flying()
        (engine,) = children(nodes(tmp_path)["world"])
        os.kill(engine, signal.SIGSTOP)
        flight.kill("world")
        until(lambda: not Path(f"/proc/{engine}").exists(), 10.0, "the end of the engine")
        assert flight.program.wait(60.0) == 3
    assert "world: signal SIGKILL" in flight.said
