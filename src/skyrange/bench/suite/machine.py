"""Description of this machine: processor, cores, memory, system, and the versions that results depend on."""

from __future__ import annotations

import os
import platform
from importlib.metadata import version
from pathlib import Path

from skyrange.bench.suite.results import Machine
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
    found: dict[str, str] = {}
    try:
        text = read_input(_CPUINFO, "bench all", max_bytes=MIB).decode(errors="replace")
        for line in text.splitlines():
            key, _, value = line.partition(":")
            found.setdefault(key.strip(), value.strip())
    except InputError:
        pass  # another system
    return found.get("model name") or platform.processor() or platform.machine(), frozenset(
        found.get("flags", "").split()
    )


def _memory_mb() -> float | None:
    try:
        return round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e6)
    except (ValueError, OSError):
        return None
