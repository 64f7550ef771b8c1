"""Speed of batches of runs: many short runs of one scenario, alone and together in one kernel."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from skyrange.core.errors import ComponentError
from skyrange.record import load
from skyrange.runtime.batch import BatchedFlight, RunBatch
from skyrange.runtime.warm_up import warm_up
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.toml_files import load_text
from skyrange.study.runs import fly

SIZES: Final = (1, 4, 16, 64, 128, 256)
"""Runs of a batch; 1 is a run alone, recorded in a folder."""
_ALONE: Final = 4
"""Runs that are flown alone, and compared with those of the first batch."""

SCENARIOS: Final = {
    "nominal": "",
    "gnss": """
[[attacks]]
id = "pull"
kind = "gnss.drift"
start_s = 20
params = { vehicles = ["blue/b1"], rate_mps = [0.5, 0, 0] }
""",
    "taps": """
[[attacks]]
id = "delay"
kind = "link.delay"
start_s = 20
params = { links = ["gcs:blue/b1"], delay_s = 0.2 }
""",
    "radio": """
[radio]

[[attacks]]
id = "ghost"
kind = "remote_id.spoof"
start_s = 20
params = { at = [2, 120, 30], transmitter_m = [30, 120, 2] }
""",
}
"""What acts on the one aircraft."""
_TEXT: Final = """
name = "batch"
origin = [40.778, -73.955]
record = { level = "study" }

[[operators]]
id = "blue"
  [[operators.vehicles]]
  id = "b1"
  plan = { path = { points = [[0, 0], [0, 340]], alt_m = 30 }, speed_mps = 5, end = "land" }
"""


def measure(kind: str, sizes: Sequence[int], seconds: float) -> Iterator[dict[str, Any]]:
    """Fly one aircraft for so many simulated seconds, alone and in batches of `sizes`; a row for each.

    Rows have the processor time of a run, in seconds, and how many times as many runs a second of it flies as alone.
    Raises `ComponentError` if a run of a batch has other digests than alone.
    """
    avoids = "[radio]" in SCENARIOS[kind]
    text = _TEXT.replace('id = "blue"', 'id = "blue"\navoidance = "geometric"') if avoids else _TEXT
    scenario = load_text(text + SCENARIOS[kind]).model_copy(update={"duration_s": seconds})
    warm_up(scenario)
    with tempfile.TemporaryDirectory(prefix="skyrange-bench-") as scratch:
        root = Path(scratch)
        fly(scenario, root / "first", report=False)
        began = time.process_time()
        folders = [root / str(seed) for seed in range(1, _ALONE + 1)]
        for seed, folder in enumerate(folders, start=1):
            fly(_with_seed(scenario, seed), folder, report=False)
        alone_s = (time.process_time() - began) / _ALONE
        digests = [load(folder).manifest["digests"] for folder in folders]
        for size in sizes:
            if size == 1:
                yield _row(kind, size, alone_s, alone_s, 0.0)
                continue
            flights = [
                BatchedFlight(_with_seed(scenario, seed), root / "none", in_memory=True) for seed in range(1, size + 1)
            ]
            began = time.process_time()
            batch = RunBatch.start(flights)
            built_s = time.process_time() - began
            batch.execute()
            cpu_s = (time.process_time() - began) / size
            for record, alone in zip(batch.records(), digests, strict=False):
                if record.manifest["digests"] != alone:
                    raise ComponentError("bench", f"a run in a batch of {size} is not what it is alone")
            yield _row(kind, size, cpu_s, alone_s, built_s / size)


def _with_seed(scenario: Scenario, seed: int) -> Scenario:
    return scenario.model_copy(update={"seed": seed})


def _row(kind: str, size: int, cpu_s: float, alone_s: float, built_s: float) -> dict[str, Any]:
    return {
        "scenario": kind,
        "runs": size,
        "cpu_s_per_run": round(cpu_s, 5),
        "setup_s_per_run": round(built_s, 5),
        "factor": round(alone_s / cpu_s, 2),
    }
