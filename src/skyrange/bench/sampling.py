"""Profile of a run: samples of the running stack on a CPU-time clock, attributed to parts.

A statistical profile costs next to nothing and so does not distort what it measures, unlike a trace of
each call. A sample belongs to the innermost skyrange module on the stack; time inside a compiled
kernel or a library counts for the module that called it.
"""

from __future__ import annotations

import signal
from collections import Counter
from types import FrameType, TracebackType

INTERVAL_S = 0.005

PARTS = ("physics", "control", "MAVLink", "ground stations", "air", "kernel", "recording", "detectors", "other")

_PACKAGES = {
    "world": "physics",
    "city": "physics",
    "vehicle": "control",
    "codec": "MAVLink",
    "gcs": "ground stations",
    "utm": "ground stations",
    "radio": "air",
    "remoteid": "air",
    "detect": "detectors",
    "kernel": "kernel",
    "contracts": "kernel",
    "core": "kernel",
    "record": "recording",
}
_MODULES = {
    "skyrange.vehicle.companion": "air",
    "skyrange.vehicle.avoidance": "air",
    "skyrange.vehicle.builtin.telemetry": "MAVLink",
    "skyrange.vehicle.builtin.mission_protocol": "MAVLink",
    "skyrange.vehicle.builtin.commands": "MAVLink",
}


def _part_of(module: str) -> str | None:
    names = module.split(".")
    for depth in (4, 3):
        part = _MODULES.get(".".join(names[:depth]))
        if part is not None:
            return part
    return _PACKAGES.get(names[1])


class Sampler:
    """A context that samples this thread's stack every `INTERVAL_S` of CPU time (POSIX, main thread)."""

    def __init__(self) -> None:
        self.samples: Counter[str] = Counter()

    def __enter__(self) -> Sampler:
        self._before = signal.signal(signal.SIGPROF, self._sample)
        signal.setitimer(signal.ITIMER_PROF, INTERVAL_S, INTERVAL_S)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, self._before)

    def _sample(self, number: int, frame: FrameType | None) -> None:
        while frame is not None:
            module = frame.f_globals.get("__name__", "")
            if module.startswith("skyrange."):
                part = _part_of(module)
                if part is not None:
                    self.samples[part] += 1
                    return
            frame = frame.f_back
        self.samples["other"] += 1

    def shares(self) -> dict[str, float]:
        """The share of each part, 0 to 1; all 0 without samples."""
        total = sum(self.samples.values()) or 1
        return {part: round(self.samples[part] / total, 4) for part in PARTS}
