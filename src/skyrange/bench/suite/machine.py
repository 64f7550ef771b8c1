"""The machine of benchmarks: its description, and from outside the processes of a case on it.

All processes that this one starts during a case belong to it, and those that they start: their memory over time and
processor time are observed, and what else runs meanwhile. They are waited for before the observation ends, so their
processor time and context switches are those of the children of this process.
"""

from __future__ import annotations

import os
import platform
import resource
import threading
import time
from importlib.metadata import version
from multiprocessing import resource_tracker
from pathlib import Path
from types import TracebackType
from typing import Final

from skyrange.bench.live import busy_s
from skyrange.bench.suite.results import Load, Machine, Memory
from skyrange.bench.yardstick import yardstick_us
from skyrange.core.errors import InputError
from skyrange.core.files import MIB, read_input

_CPUINFO = Path("/proc/cpuinfo")


def describe_machine() -> Machine:
    """The machine that this process runs on."""
    processor, flags = _processor()
    return Machine(
        processor=processor,
        cores=len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1,
        memory_mb=_memory_mb(),
        virtual="hypervisor" in flags if flags else None,
        system=f"{platform.system()} {platform.release()} {platform.machine()}",
        python=f"{platform.python_implementation()} {platform.python_version()}",
        numpy=version("numpy"),
        numba=version("numba"),
        llvmlite=version("llvmlite"),
    )


def _processor() -> tuple[str, frozenset[str]]:
    """Model of the processor, and its flags where the system lists them."""
    facts: dict[str, str] = {}
    try:
        text = read_input(_CPUINFO, "bench all", max_bytes=MIB).decode(errors="replace")
        for line in text.splitlines():
            key, _, value = line.partition(":")
            facts.setdefault(key.strip(), value.strip())
    except InputError:
        pass  # another system
    return facts.get("model name") or platform.processor() or platform.machine(), frozenset(
        facts.get("flags", "").split()
    )


def _memory_mb() -> float | None:
    try:
        return round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e6)
    except (ValueError, OSError):
        return None


INTERVAL_S: Final = 0.25
"""Seconds between two samples of the memory."""
MAX_VALUES: Final = 120
"""Values of a series that are kept; of a longer case, each is the largest of several samples."""


class Observation:
    """A context in which one case runs; `load` and `memory` are there after it."""

    load: Load
    memory: Memory

    def __enter__(self) -> Observation:
        resource_tracker.ensure_running()  # a process of its own, which would start with the first case
        self._foreign = frozenset(list_descendants(os.getpid()))
        self._samples: list[float] = []
        self._processes = 0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._sample, name="memory of a benchmark", daemon=True)
        self._yardstick_us = yardstick_us()
        self._loadavg = os.getloadavg()[0]
        self._before = resource.getrusage(resource.RUSAGE_CHILDREN)
        self._own_s, self._busy_s, self._began = time.process_time(), busy_s(), time.perf_counter()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        wall_s = time.perf_counter() - self._began
        busy, own_s = busy_s(), time.process_time() - self._own_s
        after, before = resource.getrusage(resource.RUSAGE_CHILDREN), self._before
        self._ended.set()
        self._thread.join()
        loadavg = os.getloadavg()[0]
        cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        elsewhere = None
        if busy is not None and self._busy_s is not None:
            elsewhere = round(max(busy - self._busy_s - cpu_s - own_s, 0.0) / wall_s, 2)
        self.load = Load(
            wall_s=round(wall_s, 2),
            cpu_s=round(cpu_s, 2),
            involuntary_switches=after.ru_nivcsw - before.ru_nivcsw,
            loadavg_before=round(self._loadavg, 2),
            loadavg_after=round(loadavg, 2),
            elsewhere_cores=elsewhere,
            yardstick_before_us=round(self._yardstick_us, 2),
            yardstick_after_us=round(yardstick_us(), 2),
        )
        self.memory = make_series(self._samples, self._processes)

    def _sample(self) -> None:
        parent = os.getpid()
        while not self._ended.wait(INTERVAL_S):
            pids = [pid for pid in list_descendants(parent) if pid not in self._foreign]
            self._processes = max(self._processes, len(pids))
            if pids:
                self._samples.append(sum(map(resident_mb, pids)))


def list_descendants(pid: int) -> list[int]:
    """The children of a process, theirs and so on, without it; empty where the system does not list them (Linux)."""
    pids: list[int] = []
    waiting = [pid]
    while waiting:
        try:
            listed = [path.read_text() for path in Path(f"/proc/{waiting.pop()}/task").glob("*/children")]
        except OSError:  # it, or a thread of it, has ended
            continue
        children = [int(child) for text in listed for child in text.split()]
        pids += children
        waiting += children
    return pids


def resident_mb(pid: int) -> float:
    """Resident memory of a process in MB; 0 if it has ended."""
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    except (OSError, IndexError):
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def make_series(samples_mb: list[float], processes: int) -> Memory:
    """The memory of a case from its samples: at most `MAX_VALUES` values, each the largest of as many samples."""
    per_value = max(-(-len(samples_mb) // MAX_VALUES), 1)
    kept = [round(max(samples_mb[at : at + per_value]), 1) for at in range(0, len(samples_mb), per_value)]
    return Memory(
        every_s=INTERVAL_S * per_value,
        resident_mb=tuple(kept),
        peak_mb=round(max(samples_mb), 1) if samples_mb else None,
        processes=processes,
    )
