"""Estimate of a study before it starts: runs, time and disk, from one block that is flown as a trial."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import NamedTuple

from skyrange.runtime.warm_up import warm_up
from skyrange.study.sweep.block_files import BLOCKS
from skyrange.study.sweep.design.blocks import Block, check_blocks, scenario_in
from skyrange.study.sweep.design.model import Study
from skyrange.study.sweep.execution.worker import fly_block


class Estimate(NamedTuple):
    """What a study will take on this machine."""

    points: int
    blocks: int
    runs: int
    aircraft_hours: float
    """Simulated hours of all aircraft in all runs."""
    wall_s: float
    """With `jobs` workers, if all blocks take as long as the trial."""
    disk_mb: float
    """Of what is kept."""
    jobs: int
    failed: tuple[str, ...]
    """Errors of the trial."""


def estimate_study(study: Study, blocks: list[Block], jobs: int) -> Estimate:
    """Check the scenarios of a study and fly its first block in a temporary folder.

    Raises `InputError` with everything that is wrong.
    """
    check_blocks(study, blocks)
    trial = blocks[0]
    scenarios = [scenario_in(study, arm, trial) for arm in study.arms]
    warm_up(scenarios[-1])
    with tempfile.TemporaryDirectory() as scratch:
        (Path(scratch) / BLOCKS).mkdir()
        result = fly_block(study, trial, Path(scratch))
        rows_bytes = (Path(scratch) / BLOCKS / f"{trial.name}.json").stat().st_size
    seconds = sum(len(list(one.fleet)) * float(one.duration_s) for one in scenarios)
    return Estimate(
        points=len({block.point for block in blocks}),
        blocks=len(blocks),
        runs=len(blocks) * len(study.arms),
        aircraft_hours=seconds / 3600.0 * len(blocks),
        wall_s=result.wall_s * len(blocks) / min(jobs, len(blocks)),
        disk_mb=(result.disk_bytes + rows_bytes) * len(blocks) / 1e6,
        jobs=jobs,
        failed=result.errors,
    )
