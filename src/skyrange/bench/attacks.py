"""Benchmark of attacks on links: what an on-path tap on every `gcs` link costs, and what a flood of one link costs.

Each case flies the fleet of `bench.fleet` at light load in a process of its own: without an attack, with a tap that
reads every frame, with one that delays every frame, and with a flood of one aircraft's link.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from skyrange.bench.fleet import WARM_UP_S, fleet_scenario
from skyrange.bench.isolation import run_in_process
from skyrange.bench.yardstick import yardstick_us
from skyrange.core.time import from_seconds
from skyrange.record import RunRecord, load
from skyrange.runtime.run import Run
from skyrange.scenario.model.attacks import AttackTable

FLOOD_HZ: Final = 10_000.0
CASES: Final[Mapping[str, tuple[str, Mapping[str, Any]] | None]] = {
    "none": None,
    "tap that reads": ("link.eavesdrop", {"links": ["gcs:*"]}),
    "tap that delays": ("link.delay", {"links": ["gcs:*"], "delay_s": 0.005}),
    "flood of one link": ("link.flood", {"links": ["gcs:op1/o1"], "message": "PING", "rate_hz": FLOOD_HZ}),
}
"""By name: kind and parameters of the attack, which acts from the end of the warm-up on."""


def measure(vehicles: int, seconds: float) -> list[dict[str, Any]]:
    """A row for each case: `vehicles` aircraft for `seconds` simulated seconds after the warm-up.

    `real_time_factor` is simulated over CPU seconds while flying, with recording; `speed` is that relative to the case
    without an attack; `frames_per_s` are frames per simulated second over all hops, and `us_per_frame` is the CPU time
    of a frame; `extra_us_per_frame` that of each frame which the case has more than the first one.
    """
    rows = [run_in_process(f"bench with {name}", _flown, name, vehicles, seconds) for name in CASES]
    first = rows[0]
    for row in rows:
        more = (row["frames_per_s"] - first["frames_per_s"]) * seconds
        row["speed"] = round(row["real_time_factor"] / first["real_time_factor"], 3)
        row["extra_us_per_frame"] = round((row["cpu_s"] - first["cpu_s"]) / more * 1e6, 2) if more > seconds else None
    return rows


def _flown(name: str, vehicles: int, seconds: float) -> dict[str, Any]:
    case = CASES[name]
    scenario = fleet_scenario(vehicles, seconds)
    if case is not None:
        attack = AttackTable(id="bench", kind=case[0], start_s=WARM_UP_S, params=dict(case[1]))
        scenario = scenario.model_copy(update={"attacks": (attack,)})
    with tempfile.TemporaryDirectory() as folder:
        run = Run.start(scenario, Path(folder) / "run")
        run.advance(WARM_UP_S)
        cpu = time.process_time()
        run.advance(WARM_UP_S + seconds)
        cpu_s = time.process_time() - cpu
        yard_us = yardstick_us()
        run.finish()
        frames = _count_frames(load(Path(folder) / "run"))
    return {
        "case": name,
        "vehicles": vehicles,
        "seconds": seconds,
        "real_time_factor": round(seconds / cpu_s, 2),
        "cpu_s": round(cpu_s, 3),
        "frames_per_s": round(frames / seconds, 1),
        "us_per_frame": round(cpu_s / frames * 1e6, 2),
        "yardstick_us": round(yard_us, 2),
    }


def _count_frames(record: RunRecord) -> int:
    """Frames that were sent after the warm-up, over all hops."""
    since = from_seconds(WARM_UP_S)
    return sum(int((batch.column(0).to_numpy() >= since).sum()) for batch in record.batches("frames", ["sent_ns"]))
