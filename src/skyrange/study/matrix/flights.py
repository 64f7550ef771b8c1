"""Flights of a matrix: the arms of each cell with each seed, measured where they were flown."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Literal

from typing_extensions import TypedDict

from skyrange.assembly.batches import count_together
from skyrange.assembly.build import build
from skyrange.core.errors import InputError, Problem
from skyrange.core.files import atomic_write, expand_user
from skyrange.core.typed_json import check_type
from skyrange.record import RunRecord
from skyrange.runtime.run import free_folder
from skyrange.scenario.model.scenario import Scenario
from skyrange.statistics.exact_intervals import load_special
from skyrange.study.execution.executors import Executor
from skyrange.study.execution.plan import PlannedBlock, PlannedRun, RunPlan, digest_plan
from skyrange.study.execution.plan_run import (
    OnPlanProgress,
    choose_executor,
    forget_failures,
    require_success,
    run_plan,
)
from skyrange.study.execution.store import BLOCKS, RunStore, claim_store
from skyrange.study.execution.store import MANIFEST as PLAN
from skyrange.study.matrix.cells import BY_SEED, Cell, join_seeds, measure_cell
from skyrange.study.matrix.model import UNDEFENDED, Column, Matrix, Row, locate_scenarios
from skyrange.study.matrix.verdicts import Verdicts, judge_cells
from skyrange.study.pairing import compare_arms, work_of
from skyrange.study.plan_size import MAX_RUNS, check_size
from skyrange.twins.arms import NOMINAL, Arm, acting_attacks, claiming_attacks, plan_arms, scenario_of

FORMAT: Final = "skyrange.matrix/3"
MANIFEST: Final = "matrix.json"
CELLS: Final = "cells"
_SENSORS: Final = ("gnss", "baro", "compass", "imu", "gyro", "accel")

_ROUND_SEEDS: Final = 32
"""Seeds of all cells that are flown before the next ones, so that a matrix that was interrupted has all cells."""

Keep = Literal["results", "first", "everything"]
"""What is kept of the runs of a cell: nothing but its measures; those of its first seed, as a pair with its report;
or those of all seeds, each as a pair with its report."""


@dataclass(frozen=True, slots=True)
class CellFlights:
    """What is flown of one cell, or of one candidate of an adversary in it, with each seed."""

    row: Row
    column: Column | None
    scenario: Scenario
    name: str
    """Of its folder among those of the row."""
    honest: bool = field(kw_only=True)
    candidate: str = ""
    muted: Mapping[str, Sequence[str]] = field(default_factory=dict)
    """Of an undefended cell: the defences of other cells that fly in it muted, ids by column."""
    waits_for: str = ""
    """The cell of the same row that has runs that this one can take over."""

    @property
    def column_id(self) -> str:
        """The id of its column."""
        return UNDEFENDED if self.column is None else self.column.id

    def list_arms(self) -> list[Arm]:
        """The arms that are flown: of a candidate the attacked one and its baseline alone."""
        attacks = acting_attacks(self.scenario)
        selection: Literal["baseline", "sham"] = "baseline" if self.candidate else "sham"
        return plan_arms(attacks, selection, honest=self.honest)

    def seeds(self, count: int) -> range:
        """The first seeds from that of the scenario on."""
        return range(self.scenario.seed, self.scenario.seed + count)

    def block_name(self, seed: int) -> str:
        """The name of the block of a seed."""
        return f"{self.row.id}/{self.name}/seed-{seed}"

    def empty_cell(self) -> Cell:
        """The cell without measures."""
        fault, assumed = not self.scenario.attacks, rests_on_assumption(self.scenario)
        return Cell(self.row.id, self.column_id, fault=fault, assumed=assumed, candidate=self.candidate)

    def find_quiet(self, runs: Mapping[str, RunRecord]) -> dict[str, list[str]]:
        """By column, the arms in which its defences, present and muted, would have done nothing."""
        if not self.muted:
            return {}
        withheld = {arm: set(run.manifest.get("withheld", ())) for arm, run in runs.items()}
        return {
            column: [arm for arm, withheld_ids in withheld.items() if withheld_ids.isdisjoint(ids)]
            for column, ids in self.muted.items()
        }


def rests_on_assumption(scenario: Scenario) -> bool:
    """Whether an attack acts on a sensor whose reaction is assumed, by what its kind says of realism."""
    return any(
        note.startswith("assumed")
        for attack in scenario.attacks
        if any(part in _SENSORS for part in attack.plugin.surface)
        for note in attack.plugin.realism.values()
    )


@dataclass(frozen=True)
class MatrixPlan(RunPlan):
    """The runs of a matrix: a block for each cell or candidate with each seed.

    A block is measured where it was flown: `cell` has its measures, `runs` the folders of its arms, and `quiet` of an
    undefended one the arms in which the defences of a column would have done nothing. Where these are all arms, the
    block of that column is not flown: its measures are those of the undefended one.
    """

    matrix: Matrix
    cells: Sequence[CellFlights]
    keep: Keep = "first"

    kind = "matrix"

    @property
    def name(self) -> str:
        """The name of the matrix."""
        return self.matrix.name

    @cached_property
    def together(self) -> int:
        """See `RunPlan`: by the cell of which most fly together."""
        return max((count_together(cell.scenario) for cell in self.cells), default=1)

    @property
    def blocks(self) -> Sequence[PlannedBlock]:
        """Cell by cell, seed by seed."""
        return self._blocks

    @cached_property
    def _blocks(self) -> list[PlannedBlock]:
        return list(self._list_blocks())

    @cached_property
    def _of(self) -> dict[str, tuple[CellFlights, int]]:
        """The cell and the seed of each block, by name."""
        return {cell.block_name(seed): (cell, seed) for cell in self.cells for seed in cell.seeds(self.matrix.seeds)}

    @cached_property
    def _awaited(self) -> set[str]:
        return {block.waits_for for block in self.blocks}

    def _list_blocks(self) -> Iterator[PlannedBlock]:
        for cell in self.cells:
            arms = cell.list_arms()
            work = work_of(cell.scenario) * len(arms)
            alike = f"{cell.row.id}/{cell.name}"
            for number, seed in enumerate(cell.seeds(self.matrix.seeds)):
                name = cell.block_name(seed)
                waits_for = f"{cell.row.id}/{cell.waits_for}/seed-{seed}" if cell.waits_for else ""
                folders = tuple(f"{CELLS}/{name}/{arm.name}" for arm in arms)
                yield PlannedBlock(name, folders, work, waits_for, number // _ROUND_SEEDS, alike)

    def digest(self) -> str:
        """See `RunPlan.digest`."""
        return digest_plan(self.kind, self.tell(), [cell.scenario for cell in self.cells])

    def tell(self) -> dict[str, Any]:
        """The matrix, whose scenario files are absolute, and what is kept of its runs."""
        return {"matrix": locate_scenarios(self.matrix).model_dump(mode="json"), "keep": self.keep}

    def plan_runs(self, block: PlannedBlock, store: RunStore) -> list[PlannedRun]:
        """A run for each arm, of which some may be those of the block that it waited for."""
        cell, seed = self._of[block.name]
        known = self._known_runs(cell, block, store)
        return [
            PlannedRun(
                folder,
                scenario_of(cell.scenario, arm, seed),
                in_memory=not self._keeps(cell, seed),
                same_as=known.get(arm.name),
            )
            for folder, arm in zip(block.folders, cell.list_arms(), strict=True)
        ]

    def _known_runs(self, cell: CellFlights, block: PlannedBlock, store: RunStore) -> dict[str, Path]:
        """The runs of the block that it waited for, by arm, that its own would be equal to."""
        data = _read_block(store, block.waits_for) if block.waits_for else None
        if data is None:
            return {}
        same = [NOMINAL] if cell.candidate else data["quiet"].get(cell.column_id, ())
        return {arm: store.path / data["runs"][arm] for arm in same if arm in data["runs"]}

    def settle(self, block: PlannedBlock, store: RunStore) -> dict[str, Any] | None:
        """The measures of the undefended block, if the column's defences would have done nothing in any of its runs."""
        cell, _ = self._of[block.name]
        data = _read_block(store, block.waits_for)
        if data is None or cell.candidate or len(data["quiet"].get(cell.column_id, ())) < len(block.folders):
            return None
        return {**data, "cell": replace(data["cell"], column=cell.column_id).data(), "quiet": {}}

    def measure(
        self, block: PlannedBlock, records: Mapping[str, RunRecord], errors: Mapping[str, str], store: RunStore
    ) -> dict[str, Any] | None:
        """The measures of the block; `None` if a run failed."""
        if errors:
            return None
        cell, seed = self._of[block.name]
        runs = {arm.name: records[folder] for arm, folder in zip(cell.list_arms(), block.folders, strict=True)}
        detectors = [table.id for table in cell.scenario.defences if not table.muted]
        empty = replace(cell.empty_cell(), folder=_folder_of(block) if self._keeps(cell, seed) else "")
        measured = measure_cell(runs, empty, cell.row.measure, detectors)
        folders = dict(zip(runs, block.folders, strict=True))
        return {"cell": measured.data(), "runs": folders, "quiet": cell.find_quiet(runs)}

    def reduce(self, block: PlannedBlock, records: Mapping[str, RunRecord], root: Path) -> int:
        """Compare the runs that are kept, and delete those that are not and for which no other block waits."""
        cell, seed = self._of[block.name]
        if len(records) < len(block.folders):
            return 0
        if self._keeps(cell, seed):
            compare_arms(root / _folder_of(block), cell.scenario, cell.list_arms(), seed)
        elif block.name not in self._awaited:
            self.release(block, root)
        return 0

    def release(self, block: PlannedBlock, root: Path) -> None:
        """Delete the runs of a block that is not kept."""
        if not self._keeps(*self._of[block.name]):
            shutil.rmtree(root / _folder_of(block), ignore_errors=True)

    def _keeps(self, cell: CellFlights, seed: int) -> bool:
        return self.keep == "everything" or (self.keep == "first" and seed == cell.scenario.seed)

    def read_cells(self, store: RunStore) -> dict[tuple[str, str], Cell]:
        """The cells of all finished blocks, by row and column, with their candidates. Raises `InputError` for damaged
        ones.
        """
        cells: dict[tuple[str, str], Cell] = {}
        aircraft: dict[str, int] = {}
        for cell in self.cells:
            blocks = [_read_block(store, cell.block_name(seed)) for seed in cell.seeds(self.matrix.seeds)]
            seed_data = [data for data in blocks if data is not None]  # all, because none has a failed run
            joined = join_seeds([data["cell"] for data in seed_data])
            if not cell.candidate and len(joined.nominal) != len(seed_data):
                where, value = f"{BLOCKS}: {cell.row.id}/{cell.name}", f"nominal runs of {len(joined.nominal)} seeds"
                hint = "Delete its blocks and resume."
                raise InputError.one(str(store.path), where, value, f"those of {len(seed_data)}", hint)
            for run in joined.nominal:
                if len(run.complete) != aircraft.setdefault(cell.row.id, len(run.complete)):
                    where, value = f"{BLOCKS}: {cell.row.id}", f"{len(run.complete)} aircraft in a block"
                    expected = f"{aircraft[cell.row.id]}, as in others of the row"
                    raise InputError.one(str(store.path), where, value, expected, "Delete the block and resume.")
            arms, key = len(cell.list_arms()), (cell.row.id, cell.column_id)
            if cell.candidate:
                cells[key] = replace(cells[key], adaptive=(*cells[key].adaptive, joined))
                continue
            if cell.column is None:
                idle = tuple(
                    column
                    for column in cell.muted
                    if all(len(seed["quiet"].get(column, ())) == arms for seed in seed_data)
                )
                cells[key] = replace(joined, idle=idle)
            else:
                is_idle = cell.column_id in cells[cell.row.id, UNDEFENDED].idle
                cells[key] = replace(joined, failed=[]) if is_idle else joined
        return cells


class _StoredBlock(TypedDict):
    """What `MatrixPlan.measure` makes of a block."""

    cell: Cell
    runs: dict[str, str]
    quiet: dict[str, list[str]]


def _read_block(store: RunStore, name: str) -> _StoredBlock | None:
    """What a block measured; `None` if a run failed. Raises `InputError` for a damaged file."""
    result, data = store.read(name, _StoredBlock)
    if data is None:
        if not result.failed:
            where = f"{BLOCKS}/{name}.json: data"
            raise InputError.one(str(store.path), where, "nothing", "the measures of a block", "Delete it and resume.")
        return None
    cell: Cell = data["cell"]
    lengths = {name: len(getattr(cell, name)) for name in BY_SEED if name != "failed"}
    if max(lengths.values()) > 1 or not lengths["effects"] == lengths["alarms_s"] == lengths["watched_s"] == 1:
        where = f"{BLOCKS}/{name}.json: data.cell"
        raise InputError.one(str(store.path), where, repr(lengths), "the measures of one seed", "Delete it and resume.")
    counts = {len(values) for run in cell.nominal for values in (run.landed_s, run.energy_j, run.complete)}
    if len(counts) > 1:
        value, where = f"measures of {sorted(counts)} aircraft", f"{BLOCKS}/{name}.json: data.cell.nominal"
        raise InputError.one(str(store.path), where, value, "each measure of all aircraft", "Delete it and resume.")
    return {"cell": replace(cell, adaptive=(), idle=()), "runs": data["runs"], "quiet": data["quiet"]}


def _folder_of(block: PlannedBlock) -> str:
    return f"{CELLS}/{block.name}"


@dataclass(frozen=True)
class MatrixResult:
    """A flown matrix."""

    path: Path
    matrix: Matrix
    cells: dict[tuple[str, str], Cell]
    """By row and column; the undefended column is `UNDEFENDED`."""

    @cached_property
    def verdicts(self) -> Verdicts:
        """Which defence is shown to stop which attack."""
        return judge_cells(self.cells)

    @property
    def failed_missions(self) -> list[str]:
        """Cells with missions that failed in nominal and sham runs: in how many runs, and what was in the first."""
        return [
            f"{row} with {column}: {cell.failed[0]}" + (f"; and in {more} more runs" if more else "")
            for (row, column), cell in self.cells.items()
            if cell.failed
            for more in (len(cell.failed) - 1,)
        ]

    def cell(self, row: str, column: str = UNDEFENDED) -> Cell:
        """The cell of a row and a column."""
        return self.cells[row, column]


def fly_matrix(
    matrix: Matrix,
    out: str | Path | None = None,
    *,
    jobs: int | None = None,
    keep: Keep = "first",
    executor: Executor | None = None,
    on_progress: OnPlanProgress | None = None,
    other_rows: Sequence[Row] = (),
    max_runs: int = MAX_RUNS,
) -> MatrixResult:
    """Fly every cell of a matrix into `out`, by default the first free folder `runs/NAME`, `runs/NAME-2` …

    A folder in which the same matrix was begun is gone on with. One of `jobs` is flown in this process; `executor`
    flies them elsewhere. A defence that cannot be declared in a row's scenario leaves its cell unflown, with the
    reason. `other_rows` of the same file are not flown: a column that can be declared in one of them is not wrong.
    Raises `InputError` before anything is written for a scenario that is wrong without defences, for a column that can
    be declared in no row, for a folder of something else, and without SciPy; `ShortfallError` after Ctrl-C, with the
    blocks flown so far in the folder; `ComponentError` if a run failed, when all else has been flown. More runs than
    `max_runs` raise `InputError`.
    """
    jobs = jobs if jobs is not None else os.cpu_count() or 1
    if jobs < 1:
        raise InputError.one("matrix", "jobs", jobs, "1 or more")
    variants = sum(len(variant.candidates) for row in matrix.rows for variant in row.adaptive)
    cells = len(matrix.rows) * (len(matrix.columns) + 1) + variants * len(matrix.columns)
    check_size("matrix", {"cells": cells, "seeds": matrix.seeds, "arms": 2}, max_runs, "Say --max-runs N.")
    load_special()  # the limits of rates need it, when all has been flown
    refusals: dict[tuple[str, str], Sequence[Problem]] = {}
    plan = MatrixPlan(matrix, list(_plan(matrix, refusals)), keep)
    _check_columns(matrix, refusals, other_rows)
    folder = expand_user(out) if out is not None else free_folder(matrix.name)
    return _fly_plan(plan, refusals, folder, executor if executor is not None else choose_executor(jobs), on_progress)


def _fly_plan(
    plan: MatrixPlan,
    refusals: Mapping[tuple[str, str], Sequence[Problem]],
    folder: Path,
    executor: Executor,
    on_progress: OnPlanProgress | None,
) -> MatrixResult:
    """Fly what of a plan is not flown; `refusals` says why cells are not in it."""
    store = claim_store(plan, folder)
    forget_failures(store)
    require_success(plan, run_plan(plan, store, executor, on_progress))
    _remove_empty(store.path / CELLS)
    refused = {
        (row, column): Cell(row, column, refused="; ".join(map(str, problems)))
        for (row, column), problems in refusals.items()
    }
    result = MatrixResult(store.path, plan.matrix, refused | plan.read_cells(store))
    with atomic_write(store.path / MANIFEST) as file:
        file.write(f"{json.dumps(describe(result), indent=1)}\n".encode())
    return result


def _remove_empty(folder: Path) -> None:
    """Remove the folders of rows and columns of which nothing is kept; not before all is flown, because workers make
    folders in them.
    """
    for path in (*folder.glob("*/*"), *folder.glob("*"), folder):
        with suppress(OSError):  # something is in it
            path.rmdir()


def plan_matrix(matrix: Matrix, keep: Keep) -> MatrixPlan:
    """The plan of a matrix, without the cells that cannot be flown. Raises as `fly_matrix`."""
    return MatrixPlan(matrix, list(_plan(matrix, {})), keep)


def resume_matrix(store: RunStore, executor: Executor, on_progress: OnPlanProgress | None = None) -> MatrixResult:
    """Go on with the matrix in a folder: `skyrange resume`. Raises the errors of `fly_matrix`."""
    load_special()
    matrix, keep = read_told(store)
    refusals: dict[tuple[str, str], Sequence[Problem]] = {}  # its columns were checked when it was begun
    plan = MatrixPlan(matrix, list(_plan(matrix, refusals)), keep)
    return _fly_plan(plan, refusals, store.path, executor, on_progress)


class _Told(TypedDict):
    """What `MatrixPlan.tell` says."""

    matrix: Matrix
    keep: Keep


def read_told(store: RunStore) -> tuple[Matrix, Keep]:
    """The matrix in a folder, and what is kept of its runs. Raises `InputError` for a damaged plan."""
    told: _Told = check_type(store.told, _Told, str(store.path), f"{PLAN}: told")
    return told["matrix"], told["keep"]


def describe(result: MatrixResult) -> dict[str, Any]:
    """A matrix as JSON data."""
    cells = [cell.data() for cell in result.cells.values()]
    verdicts = [
        {"row": row, "column": column, "adaptive": adaptive, **verdict._asdict(), "stops": verdict.stops}
        for (row, column, adaptive), verdict in result.verdicts.of.items()
    ]
    matrix = result.matrix.model_dump(mode="json")
    return {"format": FORMAT, "matrix": matrix, "cells": cells, "verdicts": verdicts}


def _plan(matrix: Matrix, refusals: dict[tuple[str, str], Sequence[Problem]]) -> Iterator[CellFlights]:
    """The flights of every cell; why a cell cannot be flown is put into `refusals`, by row and column."""
    for row in matrix.rows:
        scenario = row.load()
        build(scenario)  # errors of the scenario itself come before those of defences in it
        honest = bool(claiming_attacks(scenario))
        defended: dict[str, Scenario] = {}
        for column in matrix.columns:
            try:
                defended[column.id] = _defended(row, column)
            except InputError as error:
                refusals[row.id, column.id] = error.problems
        columns = [column for column in matrix.columns if column.id in defended]
        muted = [column for column in columns if column.can_idle]
        tables = tuple(table for column in muted for table in column.tables(muted=True))
        watched = scenario.model_copy(update={"defences": (*scenario.defences, *tables)})
        ids = {column.id: [table.id for table in column.tables()] for column in muted}
        if Scenario.cross_check(watched):  # two columns have ids in common
            watched, ids = scenario, {}
        yield CellFlights(row, None, watched, UNDEFENDED, honest=honest, muted=ids)
        for column in columns:
            cell = defended[column.id]
            waits_for = UNDEFENDED if column.id in ids else ""
            yield CellFlights(row, column, cell, column.id, honest=honest, waits_for=waits_for)
            candidates = [
                (variant.about, changes)
                for variant in row.adaptive
                if set(variant.knows) & set(column.kinds)
                for changes in variant.candidates
            ]
            for number, (about, changes) in enumerate(candidates, start=1):
                name = f"{column.id}-adaptive-{number}"
                description = f"{about}: {', '.join(changes)}"
                changed = _defended(row, column, changes)
                waits_for = column.id if _differ_in_muted(cell, changed) else ""
                yield CellFlights(row, column, changed, name, honest=False, candidate=description, waits_for=waits_for)


def _differ_in_muted(scenario: Scenario, changed: Scenario) -> bool:
    """Whether two scenarios differ in attacks and faults alone, and the counterfactuals of these are muted.

    Then their nominal runs are the same, and are their baselines.
    """
    bare = [compared.model_copy(update={"attacks": (), "faults": ()}) for compared in (scenario, changed)]
    states = [*acting_attacks(scenario).values(), *acting_attacks(changed).values()]
    return bare[0] == bare[1] and "sham" not in states


def _check_columns(
    matrix: Matrix, refusals: Mapping[tuple[str, str], Sequence[Problem]], other_rows: Sequence[Row]
) -> None:
    """Raise `InputError` for a column that cannot be declared in the scenario of any row, nor in that of one of
    `other_rows`: it is wrong by itself.

    Its problems are those in the first row.
    """
    problems: list[Problem] = []
    for column in matrix.columns:
        refused = all((row.id, column.id) in refusals for row in matrix.rows)
        if refused and not any(_can_declare(row, column) for row in other_rows):
            first = matrix.rows[0].id
            problems += [
                replace(
                    problem,
                    where=f"columns.{column.id}, in the scenario of rows.{first}, as in every row: {problem.where}",
                )
                for problem in refusals[first, column.id]
            ]
    if problems:
        raise InputError(f"matrix {matrix.name}", problems)


def _can_declare(row: Row, column: Column) -> bool:
    try:
        _defended(row, column)
    except InputError:
        return False
    return True


def _defended(row: Row, column: Column, changes: tuple[str, ...] = ()) -> Scenario:
    """A row's scenario with a column's defences, after those that it declares; `InputError` where they cannot be."""
    scenario = row.load((*column.changes, *changes))
    defended = scenario.model_copy(update={"defences": (*scenario.defences, *column.tables())})
    problems = Scenario.cross_check(defended)
    if problems:
        raise InputError(f"scenario {scenario.name}", problems)
    build(defended)
    return defended
