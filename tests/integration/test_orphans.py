"""Does a command that is killed leave no process of its runs behind?"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import time
from pathlib import Path

import pytest

from skyrange.cli.app import app


def children_of(pid: int) -> set[int]:
    found = set()
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        found |= {int(word) for word in task.read_text().split()}
    return found


def is_running(pid: int) -> bool:
    try:
        return "\nState:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return False


@pytest.mark.skipif(sys.platform != "linux", reason="processes end with their parent on Linux alone")
@pytest.mark.parametrize(
    "command",
    [["pair", "gnss.drift", "--jobs", "2"], ["matrix", "--row", "gnss-drift", "--column", "firewall", "--jobs", "2"]],
)
@pytest.mark.rotating
def test_the_processes_of_a_killed_command_end(command: list[str], tmp_path: Path) -> None:
    process = multiprocessing.get_context("fork").Process(
        target=app, args=([*command, "--jobs", "2", "--out", str(tmp_path / "out")],), kwargs={"standalone_mode": False}
    )
    process.start()
    assert process.pid is not None
    deadline = time.monotonic() + 120.0
    children: set[int] = set()
    while time.monotonic() < deadline and len(children) < 2 and process.is_alive():
        children |= children_of(process.pid)
        time.sleep(0.02)
    os.kill(process.pid, signal.SIGKILL)
    process.join()
    assert len(children) >= 2
    deadline = time.monotonic() + 20.0
    while time.monotonic() < deadline and any(map(is_running, children)):
        time.sleep(0.05)
    assert not [pid for pid in children if is_running(pid)]
