"""Probe (h): SIGKILL at ten moments; what was recorded until a wall second before is there, and every reader works."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from skyrange.metrics.exact_difference import diff
from skyrange.metrics.summary import summary
from skyrange.record import load
from skyrange.report import write_report

# The child runs paced, so that wall time and simulated time go together, and says each step when it is done.
CHILD = """
import sys
from pathlib import Path
from skyrange.runtime.run import Run
from skyrange.scenario.shipped import load
run = Run.start(load("squares", ["duration_s=60"]), Path(sys.argv[1]))
def tell(now, end):
    print(now, flush=True)
run.execute(speed=8.0, on_progress=tell)
print("done", flush=True)
"""
SPEED = 8.0
MOMENTS = [0, 1, 30, 80, 130, 200, 260, 330, 420, 500]
"""After how many reported steps the child is killed; 500 steps of 80 ms are 40 simulated seconds."""


@pytest.mark.realtime
@pytest.mark.parametrize("moment", MOMENTS)
def test_a_killed_run_keeps_what_it_had(moment: int, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    child = subprocess.Popen([sys.executable, "-c", CHILD, str(folder)], stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    reached = 0
    if moment == 0:  # before the first step: as soon as there is a manifest
        deadline = time.monotonic() + 60
        while not (folder / "manifest.json").exists() and time.monotonic() < deadline:
            time.sleep(0.002)
    for _ in range(moment):
        line = child.stdout.readline()
        assert line.strip().isdigit(), line
        reached = int(line)
    os.kill(child.pid, signal.SIGKILL)
    child.wait()

    record = load(folder)
    assert json.loads((folder / "manifest.json").read_text())["status"] == "running"
    assert record.status == "killed or still running"
    # One wall second is SPEED simulated ones; a step more may have been under way.
    kept_ns = max((int(t) for t in record.table("truth").column("time_ns").to_pylist()), default=-1)
    assert kept_ns >= reached - (SPEED + 1.0) * 1e9
    if kept_ns > 0:
        frames = record.table("frames")
        payloads = set(record.table("payloads").column("payload_id").to_pylist())
        assert set(frames.column("payload_id").to_pylist()) <= payloads
    facts = summary(record)
    assert facts["status"] == "killed or still running"
    assert len(facts["vehicles"]) == 5
    assert diff(record, record).same
    report = write_report(record, tmp_path / "report.html")
    assert "<svg" in report.read_text() or "<canvas" in report.read_text()
