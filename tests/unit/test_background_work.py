"""Work beside the simulation and at the end of a process: the recorder's thread, and the collector of garbage."""

from __future__ import annotations

import os
import subprocess
import sys
import threading

import pytest

from skyrange.record.write.files.part_writer import Background

AT_END = """
import atexit, gc
atexit.register(lambda: print(gc.get_freeze_count() > 0))
from skyrange.runtime.memory import collect_less
collect_less()
collect_less()
"""


@pytest.mark.skipif(sys.platform != "linux", reason="threads have priorities of their own on Linux alone")
def test_the_recorders_thread_gives_way_to_the_simulation() -> None:
    found: list[int] = []
    background = Background()
    background.submit(lambda: found.append(os.getpriority(os.PRIO_PROCESS, threading.get_native_id())))
    background.wait()
    background.stop()
    own = os.getpriority(os.PRIO_PROCESS, 0)
    assert found[0] > own or own == 19
    assert os.getpriority(os.PRIO_PROCESS, threading.get_native_id()) == own


def test_nothing_is_collected_at_the_end_of_a_command() -> None:
    done = subprocess.run([sys.executable, "-c", AT_END], check=True, capture_output=True, text=True)
    assert done.stdout.strip() == "True"
