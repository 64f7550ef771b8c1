"""Run of a study: its plan, an estimate from a trial, a budget of disk, its results, and what went wrong."""

from __future__ import annotations

import shutil
import tempfile
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, NamedTuple

from skyrange.assembly.batches import count_together, explain_alone, is_shared
from skyrange.core.errors import InputError
from skyrange.core.files import expand_user
from skyrange.record import RunRecord
from skyrange.record.spool import table_files
from skyrange.runtime.cores.division import available_cpus
from skyrange.runtime.warm_up import warm_up
from skyrange.scenario.model.scenario import Scenario
from skyrange.study.design.blocks import Block, check_blocks, list_blocks, scenario_in
from skyrange.study.design.model import RESULTS, Study, StudyArm, change_study, read_study
from skyrange.study.execution.executors import Executor, LocalPool
from skyrange.study.execution.flight import WINDOWS_FILE
from skyrange.study.execution.plan import PlannedBlock, PlannedRun, RunPlan
from skyrange.study.execution.plan_run import OnPlanProgress, run_plan
from skyrange.study.execution.storage import BlockStorage
from skyrange.study.execution.store import BLOCKS, MANIFEST, RunStore, create_store
from skyrange.study.execution.worker import fly_group
from skyrange.study.feature_windows import WINDOWS, CollectedWindows
from skyrange.study.folder import KEPT, KIND, RUNS, StudyFolder, digest_of, open_folder, require_same
from skyrange.study.measurement import RUNS as RUN_ROWS
from skyrange.study.measurement import Rows, measure_block
from skyrange.study.results import write_results

TRIAL_BLOCKS: Final = 16
"""Blocks of a trial, of a study whose runs fly together."""


@dataclass(frozen=True)
class StudyPlan(RunPlan):
    """The runs of a study: its arms at each point with each seed."""

    study: Study
    design: Sequence[Block]

    kind = KIND
    resume = "skyrange study resume"

    @property
    def name(self) -> str:
        """The name of the study."""
        return self.study.name

    @property
    def run_limit_s(self) -> float:
        """See `Study`."""
        return float(self.study.run_limit_s)

    @property
    def max_disk_mb(self) -> float | None:
        """See `Study`."""
        return self.study.max_disk_mb

    @cached_property
    def _by_name(self) -> dict[str, Block]:
        return {block.name: block for block in self.design}

    @property
    def blocks(self) -> Sequence[PlannedBlock]:
        """One for each point and seed; all count as the same work."""
        return self._blocks

    @property
    def in_order(self) -> bool:
        """Whether blocks are flown in order of the design; where runs fly together, some seeds of each point are."""
        return self.together == 1

    @cached_property
    def _example(self) -> Scenario | None:
        """The scenario of the first block, if it is one."""
        first = _scenario_or_error(self.study, self.study.arms[-1], self.design[0]) if self.design else None
        return None if isinstance(first, InputError) else first

    @property
    def together(self) -> int:
        """See `RunPlan`: by the scenario of the first block."""
        return 1 if self._example is None else count_together(self._example)

    @property
    def alone_reason(self) -> str:
        """Why runs fly alone, though they could be flown in a batch if this were otherwise; "" where they are not."""
        if self._example is None or len(self.design) * len(self.study.arms) < 2:
            return ""
        drawn = [draw.name for draw in self.study.draws if is_shared(draw.key)]
        if drawn and self.together > 1:
            return f"{', '.join(drawn)} varies from seed to seed, and only the arms of a seed share it"
        return explain_alone(self._example)

    @cached_property
    def _blocks(self) -> list[PlannedBlock]:
        """Blocks are alike that differ in nothing of what runs of a batch share (`assembly.batches`)."""
        arms = [arm.id for arm in self.study.arms]
        apart = [factor.name for factor in self.study.varying if is_shared(factor.key)]
        blocks_together = max(self.together // len(arms), 1)
        planned: list[PlannedBlock] = []
        count: Counter[str] = Counter()
        for block in self.design:
            folders = tuple(f"{RUNS}/{block.name}/{arm}" for arm in arms)
            alike = repr([block.values[name] for name in apart])
            planned.append(PlannedBlock(block.name, folders, round=count[alike] // blocks_together, alike=alike))
            count[alike] += 1
        return planned

    def digest(self) -> str:
        """See `RunPlan.digest`."""
        return digest_of(self.study)

    def tell(self) -> dict[str, Any]:
        """The study as data."""
        return self.study.model_dump(mode="json")

    def plan_runs(self, block: PlannedBlock, store: RunStore) -> list[PlannedRun]:
        """A run for each arm."""
        study, design_block = self.study, self._by_name[block.name]
        scenarios = [_scenario_or_error(study, arm, design_block) for arm in study.arms]
        learned = study.learned
        windows = CollectedWindows(learned.window_s, learned.links, learned.side) if learned is not None else None
        return [
            PlannedRun(folder, scenario, windows=windows, in_memory=study.keep == RESULTS and learned is None)
            for folder, scenario in zip(block.folders, scenarios, strict=True)
        ]

    def measure(
        self, block: PlannedBlock, records: Mapping[str, RunRecord], errors: Mapping[str, str], store: RunStore
    ) -> Rows:
        """The rows of the block in all tables of results."""
        arms = {folder: arm.id for folder, arm in zip(block.folders, self.study.arms, strict=True)}
        records_by_arm = {arms[folder]: record for folder, record in records.items()}
        return measure_block(
            self.study,
            self._by_name[block.name],
            records_by_arm,
            {arms[folder]: error for folder, error in errors.items()},
        )

    def reduce(self, block: PlannedBlock, records: Mapping[str, RunRecord], root: Path) -> int:
        """Delete what is not kept of the runs that did not fail; returns the bytes that stay."""
        study = self.study
        tables = () if isinstance(study.keep, str) else study.keep
        if study.learned is not None:
            for folder, record in records.items():
                target = root / KEPT / WINDOWS / block.name
                target.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(record.path / WINDOWS_FILE, target / f"{Path(folder).name}.parquet")
        if study.keep == RESULTS or tables:
            for folder, record in records.items():
                for table in tables:
                    _keep_table(record.path, table, root / KEPT / table / block.name / Path(folder).name)
                shutil.rmtree(record.path, ignore_errors=not record.path.exists())  # flown in memory
            _remove_empty(root / RUNS / block.name)
        kept = [root / RUNS / block.name, *(root / KEPT / table / block.name for table in (WINDOWS, *tables))]
        return sum(_size(folder) for folder in kept)


def _scenario_or_error(study: Study, arm: StudyArm, block: Block) -> Scenario | InputError:
    """The scenario of a run, or what is wrong with what was drawn for it: only the corners are checked before."""
    try:
        return scenario_in(study, arm, block)
    except InputError as error:
        return error


def _keep_table(run: Path, table: str, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for number, path in enumerate(table_files((run / f"{table}.parquet").absolute())):
        path.replace(folder / f"part-{number:04d}.parquet")


def _remove_empty(folder: Path) -> None:
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()


def _size(folder: Path) -> int:
    files: Iterable[Path] = folder.rglob("*") if folder.is_dir() else ()
    return sum(path.stat().st_size for path in files if path.is_file())


def create_folder(study: Study, path: Path) -> StudyFolder:
    """Make the folder of a study. Raises `InputError` if it is not new or empty."""
    plan = StudyPlan(study, list_blocks(study))
    return StudyFolder(create_store(plan, path), study, list(plan.design))


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
    """Check the scenarios of a study and fly its first block in a temporary folder: of runs that fly together the first
    `TRIAL_BLOCKS` of that point.

    Raises `InputError` with everything that is wrong.
    """
    check_blocks(study, blocks)
    trial = blocks[0]
    scenarios = [scenario_in(study, arm, trial) for arm in study.arms]
    warm_up(scenarios[-1])
    with tempfile.TemporaryDirectory() as scratch:
        plan = StudyPlan(study, blocks)
        first = plan.blocks[0]
        alike = [block for block in plan.blocks if (block.alike, block.round) == (first.alike, first.round)]
        group = alike[: TRIAL_BLOCKS if plan.together > 1 else 1]
        results = fly_group(plan, Path(scratch), group)
        rows_bytes = sum((Path(scratch) / BLOCKS / f"{block.name}.json").stat().st_size for block in group)
    wall_s = sum(result.wall_s for result in results) / len(group)
    disk_bytes = (sum(result.disk_bytes for result in results) + rows_bytes) / len(group)
    seconds = sum(len(list(scenario.fleet)) * float(scenario.duration_s) for scenario in scenarios)
    return Estimate(
        points=len({block.point for block in blocks}),
        blocks=len(blocks),
        runs=len(blocks) * len(study.arms),
        aircraft_hours=seconds / 3600.0 * len(blocks),
        wall_s=wall_s * len(blocks) / min(jobs, len(blocks)),
        disk_mb=disk_bytes * len(blocks) / 1e6,
        jobs=jobs,
        failed=tuple(error for result in results for error in result.errors),
    )


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
    alone_reason: str = ""
    """Why runs flew alone; "" where they flew in batches."""


def run_study(
    study: Study | str | Path,
    out: str | Path | None = None,
    *,
    changes: Iterable[str] = (),
    executor: Executor | None = None,
    on_progress: OnPlanProgress | None = None,
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
        folder.store.require_version()
    else:
        check_blocks(chosen, list_blocks(chosen))
        folder = create_folder(chosen, path)
    return run_blocks(
        folder, executor if executor is not None else LocalPool(len(available_cpus())), on_progress, storage
    )


def run_blocks(
    folder: StudyFolder,
    executor: Executor,
    on_progress: OnPlanProgress | None = None,
    storage: BlockStorage | None = None,
) -> StudyResult:
    """Fly the blocks of a study that are not finished, and write its results.

    With `storage` blocks are flown in temporary folders of their machines, and come here through it; those that are in
    it already are fetched.

    Raises `ShortfallError` after Ctrl-C, or when the budget of disk is used up: what is finished is in the results.
    Raises `DiskFullError` when nothing more can be written.
    """
    plan = StudyPlan(folder.study, folder.blocks)
    try:
        result = run_plan(plan, folder.store, executor, on_progress, storage)
    except BaseException:
        with suppress(OSError):  # the disk may be full, which the error says
            write_results(folder)
        raise
    write_results(folder)
    failed = list_failures(folder)
    return StudyResult(
        folder, result.finished, result.flown, failed, result.wall_s, result.busy_share, plan.alone_reason
    )


def list_failures(folder: StudyFolder) -> list[tuple[str, str]]:
    """The blocks with failed runs, and the first error of each, in order of the design."""
    results = (folder.store.read(block.name)[0] for block in folder.finished())
    return [(result.name, result.errors[0]) for result in results if result.failed]


def list_failed_missions(folder: StudyFolder) -> list[str]:
    """Missions that failed in arms in which no attack or fault acts, with the block."""
    rows = (folder.read_rows(block)[RUN_ROWS] for block in folder.finished())
    return [
        f"block {row['block']}, {row['failed_missions']}"
        for block_rows in rows
        for row in block_rows
        if row.get("failed_missions")
    ]
