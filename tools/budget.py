"""Budget of processor time for `make test` and `make test-all`, scaled by the speed of the machine.

`python -m tools.budget --minutes 16 check test-fast` makes the targets one after the other and prints what each took of
the processor, with all processes that it started. The budget holds at the yardstick of the reference machine and with
compiled kernels; kernels that have to be compiled first may take `COLD_MINUTES` more. Over budget, it names the dearest
tests and exits with 1; else its exit code is the worst of the targets.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from tests.processor_time import REFERENCE_US

TIMES = Path(".pytest_cache/processor-times")
"""Where the targets that call pytest write the processor time of each test."""
KERNELS = "kernels"
"""The target that compiles what is missing."""
COLD_S = 10.0
"""Kernels that take longer had to be compiled, not only looked for."""
COLD_MINUTES = 3.0
DEAREST = 10


@dataclass(frozen=True)
class Step:
    """A target that was made: its exit code and its processor time."""

    target: str
    code: int
    cpu_s: float


@dataclass(frozen=True)
class Times:
    """What the tests of all targets took: seconds by test, seconds of compilation, and the yardsticks meanwhile."""

    tests: Mapping[str, float]
    compiled_s: float
    yardsticks_us: Sequence[float]

    @classmethod
    def read(cls, folder: Path, since_s: float) -> Times:
        """Read the files of a folder that are not older than `since_s`."""
        found = [
            json.loads(path.read_text()) for path in sorted(folder.glob("*.json")) if path.stat().st_mtime >= since_s
        ]
        phases = {name: list(phases.values()) for one in found for name, phases in one["tests"].items()}
        return cls(
            {name: sum(phase.get("total", 0.0) for phase in some) for name, some in phases.items()},
            sum(phase.get("compiled", 0.0) for some in phases.values() for phase in some),
            [one for part in found for one in part["yardsticks_us"]],
        )


def judge(steps: Sequence[Step], times: Times, minutes: float, *, cold: bool) -> tuple[list[str], bool]:
    """What to print at the end, and whether the steps kept the budget of `minutes` at the reference's yardstick."""
    yardstick_us = statistics.median(times.yardsticks_us) if times.yardsticks_us else REFERENCE_US
    spent_s = sum(step.cpu_s for step in steps)
    allowed_s = 60.0 * (minutes + COLD_MINUTES * cold) * yardstick_us / REFERENCE_US
    lines = [f"{step.target}: {step.cpu_s / 60:.1f} CPU-minutes" for step in steps]
    lines.append(
        f"in all: {spent_s / 60:.1f} CPU-minutes of {allowed_s / 60:.1f}, at a yardstick of {yardstick_us:.1f} µs"
        f" ({minutes:g}{f' and {COLD_MINUTES:g} to compile kernels' if cold else ''} at {REFERENCE_US:g} µs)"
    )
    if spent_s <= allowed_s:
        return lines, True
    lines.append("over budget; make tests shorter, share their flights, or mark them slow. The dearest:")
    dearest = sorted(times.tests.items(), key=lambda one: -one[1])[:DEAREST]
    return [*lines, *(f"  {spent:6.1f} s {name}" for name, spent in dearest)], False


def main(
    *,
    targets: Annotated[list[str], typer.Argument(help="Targets of the Makefile, in order.")],
    minutes: Annotated[float, typer.Option(help="Minutes of processor time at the reference's yardstick.")],
    keep_going: Annotated[bool, typer.Option(help="Make the other targets when one has failed.")] = False,
) -> None:
    """Make targets within a budget of processor time."""
    began_s = time.time()
    steps = list(_make(targets, keep_going=keep_going))
    times = Times.read(TIMES, began_s)
    compiled_s = times.compiled_s + sum(step.cpu_s for step in steps if step.target == KERNELS)
    lines, kept = judge(steps, times, minutes, cold=compiled_s > COLD_S)
    print("\n".join(lines))
    raise typer.Exit(max([step.code for step in steps] + [0 if kept else 1]))


def _make(targets: Sequence[str], *, keep_going: bool) -> Iterator[Step]:
    for target in targets:
        before = os.times()
        code = subprocess.run(["make", "--no-print-directory", target], check=False).returncode  # noqa: S607
        after = os.times()
        used = (after.children_user - before.children_user) + (after.children_system - before.children_system)
        yield Step(target, code, used)
        if code and not keep_going:
            return


if __name__ == "__main__":
    typer.run(main)
