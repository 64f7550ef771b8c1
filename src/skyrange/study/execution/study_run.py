"""Run of a study: estimate from a trial, blocks on an executor, progress, a budget of disk, and what went wrong."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Final, NamedTuple

from skyrange.core.errors import ShortfallError
from skyrange.core.files import expand_user
from skyrange.runtime.cores.division import available_cpus
from skyrange.runtime.interrupt import Interruptible
from skyrange.runtime.warm_up import warm_up
from skyrange.study.design.blocks import Block, check_blocks, list_blocks, scenario_in
from skyrange.study.design.model import Study, change_study, read_study
from skyrange.study.execution.executors import Executor, LocalPool, WorkerFailure
from skyrange.study.execution.storage import BlockStorage, fly_to_storage
from skyrange.study.execution.worker import fly_block, note_failure
from skyrange.study.folder import (
    BLOCKS,
    MANIFEST,
    BlockResult,
    StudyFolder,
    create_folder,
    digest_of,
    open_folder,
    read_block,
    require_same,
    require_version,
)
from skyrange.study.measurement import RUNS
from skyrange.study.results import write_results


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


OnBlock = Callable[[int, int, float | None], None]
"""Callback for progress: blocks finished, blocks in all, and the seconds that are left if they are known."""

_MB: Final = 1e6


@dataclass(frozen=True)
class StudyResult:
    """What a study has flown."""

    folder: StudyFolder
    finished: int
    """Blocks that are finished, with those of earlier sessions."""
    flown: int
    """Blocks that this session flew."""
    failed: Sequence[tuple[str, str]]
    """Blocks with failed runs, of all sessions, and the first error of each."""
    wall_s: float
    """Of this session."""
    busy_share: float
    """The share of the workers' time in which they flew blocks."""


def run_study(
    study: Study | str | Path,
    out: str | Path | None = None,
    *,
    changes: Iterable[str] = (),
    executor: Executor | None = None,
    on_block: OnBlock | None = None,
    storage: BlockStorage | None = None,
) -> StudyResult:
    """Run a study, or go on with one: `skyrange study run` in Python.

    `study` is a `Study`, the name of a shipped one, or a TOML file; `changes` are those of `--set`, each path=value;
    `out` defaults to `studies/NAME`. Without `executor` it uses all CPUs of this machine. Raises `InputError` before
    anything flies, and the errors of `run_blocks`.
    """
    chosen = change_study(study, changes) if isinstance(study, Study) else read_study(study, changes)
    path = expand_user(out) if out is not None else Path("studies") / chosen.name
    if (path / MANIFEST).is_file():
        folder = open_folder(path)
        require_same(folder, chosen)
        require_version(folder)
    else:
        check_blocks(chosen, list_blocks(chosen))
        folder = create_folder(chosen, path)
    return run_blocks(folder, executor if executor is not None else LocalPool(len(available_cpus())), on_block, storage)


def run_blocks(
    folder: StudyFolder, executor: Executor, on_block: OnBlock | None = None, storage: BlockStorage | None = None
) -> StudyResult:
    """Fly the blocks of a study that are not finished, and write its results.

    With `storage` blocks are flown in temporary folders of their machines, and come here through it; those that are in
    it already are fetched.

    Raises `ShortfallError` after Ctrl-C, or when the budget of disk is used up: what is finished is in the results.
    Raises `DiskFullError` when nothing more can be written.
    """
    study, total = folder.study, len(folder.blocks)
    if storage is not None:
        _fetch_blocks(folder, storage)
    done = {block.name for block in folder.finished()}
    due = [block for block in folder.blocks if block.name not in done]
    began = monotonic()
    busy_s, flown = 0.0, 0
    used_bytes = 0
    if study.max_disk_mb is not None:
        used_bytes = sum(read_block(path)[0].disk_bytes for path in (folder.path / BLOCKS).glob("*.json"))
    fly = partial(_fly, study, folder.path.absolute())  # a worker of a cluster has another working directory
    if storage is not None:
        fly = partial(fly_to_storage, study, storage.url)
    reason = ""
    with folder.lock(), Interruptible() as interrupt:
        if due:
            warm_up(scenario_in(study, study.arms[-1], due[0]))  # loaded once, before workers are forked
        began = monotonic()
        if on_block is not None:
            on_block(len(done), total, None)

        def stop() -> bool:
            nonlocal reason
            if interrupt.requested:
                reason = "interrupted"
            elif study.max_disk_mb is not None and used_bytes > study.max_disk_mb * _MB:
                reason = f"the runs take more than max_disk_mb, {study.max_disk_mb:g}"
            return bool(reason)

        limit_s = float(study.run_limit_s) * len(study.arms)
        try:
            for block, outcome in executor.run(due, fly, limit_s, stop):
                if storage is not None and not isinstance(outcome, WorkerFailure):
                    storage.fetch(block.name, folder.path)
                result = _settle(folder, block, outcome)
                done.add(result.name)
                flown += 1
                busy_s += result.wall_s
                used_bytes += result.disk_bytes
                if on_block is not None:
                    left_s = (monotonic() - began) / flown * (len(due) - flown)
                    on_block(len(done), total, left_s)
        except BaseException:
            with suppress(OSError):  # the disk may be full, which the error says
                write_results(folder)
            raise
        write_results(folder)
    wall_s = monotonic() - began
    if reason and len(done) < total:
        more = f"skyrange study resume {folder.path}"
        raise ShortfallError(f"{reason}; {len(done)} of {total} blocks are finished; to go on: {more}", folder.path)
    share = busy_s / (wall_s * executor.jobs) if flown else 1.0
    return StudyResult(folder, len(done), flown, list_failures(folder), wall_s, share)


def list_failures(folder: StudyFolder) -> list[tuple[str, str]]:
    """The blocks with failed runs, and the first error of each."""
    results = (read_block(folder.path / BLOCKS / f"{block.name}.json")[0] for block in folder.finished())
    return [(result.name, result.errors[0]) for result in results if result.failed]


def list_failed_missions(folder: StudyFolder) -> list[str]:
    """Missions that failed in arms in which no attack or fault acts, with the block."""
    rows = (read_block(folder.path / BLOCKS / f"{block.name}.json")[1][RUNS] for block in folder.finished())
    return [
        f"block {row['block']}, {row['failed_missions']}" for own in rows for row in own if row.get("failed_missions")
    ]


def forget_failures(folder: StudyFolder, storage: BlockStorage | None = None) -> None:
    """Count the blocks with failed runs as not finished, here and in the storage, so that they are flown again."""
    with folder.lock():
        for name, _ in list_failures(folder):
            if storage is not None:
                storage.remove(name)
            (folder.path / BLOCKS / f"{name}.json").unlink()


def _fly(study: Study, root: Path, block: Block) -> BlockResult:
    return fly_block(study, block, root)


def _fetch_blocks(folder: StudyFolder, storage: BlockStorage) -> None:
    """Fetch the blocks that are in the storage and not here: those that ended after this side did."""
    with folder.lock():
        storage.claim(digest_of(folder.study))
        there = storage.list_blocks() - {block.name for block in folder.finished()}
        for block in folder.blocks:
            if block.name in there:
                storage.fetch(block.name, folder.path)


def _settle(folder: StudyFolder, block: Block, outcome: BlockResult | WorkerFailure) -> BlockResult:
    if isinstance(outcome, WorkerFailure):
        return note_failure(folder.study, block, folder.path, str(outcome))
    return outcome
