"""Flights of a matrix: a pair for each cell, several at a time, measured where it was flown."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass, field, replace
from functools import cached_property
from heapq import heappop, heappush
from pathlib import Path
from time import monotonic
from typing import Any, Final

from skyrange.assembly.build import build
from skyrange.core.errors import InputError, Problem, ShortfallError, SkyrangeError
from skyrange.core.files import atomic_write, expand_user
from skyrange.io.processes.program import end_with_parent
from skyrange.record.folder import make_new_folder
from skyrange.runtime.run import free_folder
from skyrange.scenario.model.scenario import Scenario
from skyrange.statistics.exact_intervals import load_special
from skyrange.study.matrix.cells import Cell, measure_cell
from skyrange.study.matrix.model import UNDEFENDED, Column, Matrix, Row
from skyrange.study.matrix.verdicts import Verdicts, judge_cells
from skyrange.study.pairing import pair
from skyrange.twins.arms import NOMINAL, Selection, acting_attacks, claiming_attacks
from skyrange.twins.pair_folder import Pair, folder_of

FORMAT: Final = "skyrange.matrix/2"
MANIFEST: Final = "matrix.json"
CELLS: Final = "cells"
_SENSORS: Final = ("gnss", "baro", "compass", "imu", "gyro", "accel")

OnCell = Callable[[int, int, float | None], None]
"""Callback for progress: cells flown, cells in all, and the seconds that are left if they are known."""


@dataclass(frozen=True, slots=True)
class Task:
    """One cell to be flown, or one candidate of an adversary in it."""

    row: Row
    column: Column | None
    scenario: Scenario
    folder: Path
    name: str
    """The folder's path within the matrix."""
    seeds: int
    honest: bool = field(kw_only=True)
    candidate: str = ""
    muted: Mapping[str, Sequence[str]] = field(default_factory=dict)
    """Of an undefended cell: the defences of other cells that fly in it muted, ids by column."""
    waits_for: str | None = None
    """The column of the same row whose cell has runs that this one can take over, and is flown before."""

    @property
    def work(self) -> float:
        """How long its flights may take compared with others: aircraft-seconds."""
        arms = 4 if self.honest else 2
        aircraft = sum(1 for _ in self.scenario.fleet)
        return aircraft * self.scenario.duration_s * self.seeds * arms

    def fly(self, known: Mapping[tuple[str, int], Path]) -> Cell:
        """Fly it as a pair in this process, and measure it; `known` are runs that need not be flown (`pair`).

        An undefended cell says which columns are `idle` in it: their defences, present and muted, would have done
        nothing in any of its runs, so in each cell of its row and one of these columns the runs would be the same.
        """
        lies = "sham" in acting_attacks(self.scenario).values()
        arms: Selection = "baseline" if self.candidate else "sham" if lies else "nominal"
        flown = pair(
            self.scenario,
            self.folder,
            arms=arms,
            seeds=self.seeds,
            jobs=1,
            honest=self.honest,
            run_reports=False,
            known=known,
        )
        quiet = self._quiet_runs(flown)
        every = len(flown.arms) * len(flown.seeds)
        detectors = [table.id for table in self.scenario.defences if not table.muted]
        cell = Cell(
            self.row.id,
            self.column.id if self.column is not None else UNDEFENDED,
            fault=not self.scenario.attacks,
            assumed=rests_on_assumption(self.scenario),
            folder=self.name,
            candidate=self.candidate,
            idle=tuple(column for column, runs in quiet.items() if len(runs) == every),
            quiet=quiet,
        )
        return measure_cell(flown, cell, self.row.measure, detectors)

    def _quiet_runs(self, flown: Pair) -> dict[str, list[tuple[str, int]]]:
        quiet: dict[str, list[tuple[str, int]]] = {column: [] for column in self.muted}
        for arm in flown.arms:
            for seed in flown.seeds:
                withheld = flown.run(arm, seed).manifest.get("withheld", ()) if self.muted else ()
                for column, ids in self.muted.items():
                    if set(ids).isdisjoint(withheld):
                        quiet[column].append((arm, seed))
        return quiet

    def runs(self, of: Cell, root: Path) -> dict[tuple[str, int], Path]:
        """The runs of the cell that it waited for, by arm and seed, that its own would be equal to."""
        if self.candidate:
            same: Sequence[tuple[str, int]] = [(NOMINAL, seed) for seed in self._numbers]
        else:
            same = of.quiet.get(self.column.id, ()) if self.column is not None else ()
        return {(arm, seed): root / of.folder / folder_of(arm, seed, self._numbers) for arm, seed in same}

    @property
    def _numbers(self) -> list[int]:
        return [self.scenario.seed + k for k in range(self.seeds)]


def rests_on_assumption(scenario: Scenario) -> bool:
    """Whether an attack acts on a sensor whose reaction is assumed, by what its kind says of realism."""
    return any(
        one.startswith("assumed")
        for attack in scenario.attacks
        if any(part in _SENSORS for part in attack.plugin.surface)
        for one in attack.plugin.realism.values()
    )


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
        """Missions that failed in nominal and sham runs, with the row and the column."""
        return [f"{row} with {column}: {line}" for (row, column), cell in self.cells.items() for line in cell.failed]

    def cell(self, row: str, column: str = UNDEFENDED) -> Cell:
        """The cell of a row and a column."""
        return self.cells[row, column]


def fly_matrix(
    matrix: Matrix, out: str | Path | None = None, *, jobs: int | None = None, on_cell: OnCell | None = None
) -> MatrixResult:
    """Fly every cell of a matrix into `out`, by default the first free folder `runs/NAME`, `runs/NAME-2` …

    A defence that cannot be declared in a row's scenario leaves its cell unflown, with the reason. Raises `InputError`
    before anything is written for a scenario that is wrong without defences, and without SciPy; `ShortfallError` after
    Ctrl-C, with the cells flown so far in the folder; the error of a cell that failed.
    """
    jobs = jobs if jobs is not None else os.cpu_count() or 1
    if jobs < 1:
        raise InputError.one("matrix", "jobs", jobs, "1 or more")
    load_special()  # the limits of rates need it, when all has been flown
    root = expand_user(out) if out is not None else free_folder(matrix.name)
    cells: dict[tuple[str, str], Cell] = {}
    refusals: dict[tuple[str, str], Sequence[Problem]] = {}
    tasks = list(_plan(matrix, root, refusals))
    _check_columns(matrix, refusals)
    for (row, column), problems in refusals.items():
        cells[row, column] = Cell(row, column, refused="; ".join(str(problem) for problem in problems))
    make_new_folder(root)
    for task, cell in zip(tasks, _fly_all(tasks, root, jobs, on_cell), strict=True):
        column = task.column.id if task.column is not None else UNDEFENDED
        if task.candidate:
            known = cells[task.row.id, column]
            cells[task.row.id, column] = replace(known, adaptive=(*known.adaptive, cell))
        else:
            cells[task.row.id, column] = replace(cell, column=column)
    result = MatrixResult(root, matrix, cells)
    with atomic_write(root / MANIFEST) as file:
        file.write(f"{json.dumps(describe(result), indent=1)}\n".encode())
    return result


def describe(result: MatrixResult) -> dict[str, Any]:
    """A matrix as JSON data."""
    cells = [cell.data() for cell in result.cells.values()]
    verdicts = [
        {"row": row, "column": column, "adaptive": adaptive, **found._asdict(), "stops": found.stops}
        for (row, column, adaptive), found in result.verdicts.of.items()
    ]
    matrix = result.matrix.model_dump(mode="json")
    return {"format": FORMAT, "matrix": matrix, "cells": cells, "verdicts": verdicts}


def _plan(matrix: Matrix, root: Path, refusals: dict[tuple[str, str], Sequence[Problem]]) -> Iterator[Task]:
    """Every flight of a matrix; why a cell cannot be flown is put into `refusals`, by row and column."""
    for row in matrix.rows:
        scenario = row.load()
        build(scenario)  # errors of the scenario itself come before those of defences in it
        folder = root / CELLS / row.id / UNDEFENDED
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
        yield Task(row, None, watched, folder, _name(folder, root), matrix.seeds, honest=honest, muted=ids)
        for column in columns:
            folder = root / CELLS / row.id / column.id
            cell = defended[column.id]
            waits_for = UNDEFENDED if column.id in ids else None
            yield Task(row, column, cell, folder, _name(folder, root), matrix.seeds, honest=honest, waits_for=waits_for)
            candidates = [
                (variant.about, changes)
                for variant in row.adaptive
                if set(variant.knows) & set(column.kinds)
                for changes in variant.candidates
            ]
            for number, (about, changes) in enumerate(candidates, start=1):
                each = folder.with_name(f"{column.id}-adaptive-{number}")
                what = f"{about}: {', '.join(changes)}"
                changed = _defended(row, column, changes)
                waits_for = column.id if _differ_in_muted(cell, changed) else None
                yield Task(
                    row, column, changed, each, _name(each, root), matrix.seeds, what, honest=False, waits_for=waits_for
                )


def _differ_in_muted(scenario: Scenario, changed: Scenario) -> bool:
    """Whether two scenarios differ in attacks and faults alone, and the counterfactuals of these are muted.

    Then their nominal runs are the same, and are their baselines.
    """
    bare = [one.model_copy(update={"attacks": (), "faults": ()}) for one in (scenario, changed)]
    states = [*acting_attacks(scenario).values(), *acting_attacks(changed).values()]
    return bare[0] == bare[1] and "sham" not in states


def _check_columns(matrix: Matrix, refusals: Mapping[tuple[str, str], Sequence[Problem]]) -> None:
    """Raise `InputError` for a column that cannot be declared in the scenario of any row: it is wrong by itself.

    Its problems are those in the first row.
    """
    problems: list[Problem] = []
    for column in matrix.columns:
        if all((row.id, column.id) in refusals for row in matrix.rows):
            first = matrix.rows[0].id
            problems += [
                replace(
                    one, where=f"columns.{column.id}, in the scenario of rows.{first}, as in every row: {one.where}"
                )
                for one in refusals[first, column.id]
            ]
    if problems:
        raise InputError(f"matrix {matrix.name}", problems)


def _defended(row: Row, column: Column, changes: tuple[str, ...] = ()) -> Scenario:
    """A row's scenario with a column's defences, after those that it declares; `InputError` where they cannot be."""
    scenario = row.load((*column.changes, *changes))
    defended = scenario.model_copy(update={"defences": (*scenario.defences, *column.tables())})
    problems = Scenario.cross_check(defended)
    if problems:
        raise InputError(f"scenario {scenario.name}", problems)
    build(defended)
    return defended


def _name(folder: Path, root: Path) -> str:
    return folder.relative_to(root).as_posix()


def _fly_all(tasks: list[Task], root: Path, jobs: int, on_cell: OnCell | None) -> list[Cell]:
    """The cells of all tasks, flown `jobs` at a time in processes that are forked where the system can, so that they
    know all plugins.
    """
    queue = _Queue(tasks, root, on_cell)
    if jobs == 1 or len(tasks) == 1:
        while (number := queue.take()) is not None:
            queue.complete(number, tasks[number].fly(queue.known_runs(number)))
        return queue.cells()
    forks = "fork" in multiprocessing.get_all_start_methods()
    context = multiprocessing.get_context("fork" if forks else "spawn")
    with ProcessPoolExecutor(jobs, mp_context=context, initializer=_begin_process, initargs=(os.getpid(),)) as pool:
        flying: dict[Future[Cell], int] = {}
        try:
            while True:
                while len(flying) < jobs and (number := queue.take()) is not None:
                    flying[pool.submit(tasks[number].fly, queue.known_runs(number))] = number
                if not flying:
                    return queue.cells()
                ended, _ = wait(flying, return_when=FIRST_COMPLETED)
                for future in ended:
                    queue.complete(flying.pop(future), future.result())
        except KeyboardInterrupt:
            pool.shutdown(wait=True, cancel_futures=True)
            raise ShortfallError(f"interrupted; {queue.progress} cells are in {root}", root) from None
        except SkyrangeError:
            pool.shutdown(wait=True, cancel_futures=True)
            raise


class _Queue:
    """Tasks in the order in which they are to be flown, with what is known of them, and their progress.

    Undefended cells come first, because they tell which others need no flight; then those with the most work, so that
    the last ones are short. A column that may be idle waits for the undefended cell of its row, a candidate of an
    adversary for its cell, if they may have runs in common.
    """

    def __init__(self, tasks: Sequence[Task], root: Path, on_cell: OnCell | None) -> None:
        self._tasks = tasks
        self._root = root
        self._on_cell = on_cell
        self._done: dict[int, Cell] = {}
        self._ready: list[tuple[bool, float, int]] = []
        self._held: dict[tuple[str, str], list[int]] = {}
        """Tasks that wait for the cell of a row and a column."""
        self._cells: dict[tuple[str, str], Cell] = {}
        """Cells by row and column, without candidates."""
        self._began = monotonic()
        self._flown = 0.0
        for number, task in enumerate(tasks):
            if task.waits_for is not None:
                self._held.setdefault((task.row.id, task.waits_for), []).append(number)
            else:
                self._add(number)
        self._tell()

    def _add(self, number: int) -> None:
        task = self._tasks[number]
        heappush(self._ready, (task.column is not None, -task.work, number))

    def take(self) -> int | None:
        """The next task to be flown; `None` if none is ready."""
        return heappop(self._ready)[2] if self._ready else None

    def complete(self, number: int, cell: Cell) -> None:
        """Take the cell of a task that was flown."""
        self._flown += self._tasks[number].work
        self._settle(number, cell)
        self._tell()

    def _settle(self, number: int, cell: Cell) -> None:
        """Take the cell of a task, and release those that wait for it; idle ones are settled by it."""
        task = self._tasks[number]
        self._done[number] = cell
        if task.candidate:
            return
        own = UNDEFENDED if task.column is None else task.column.id
        self._cells[task.row.id, own] = cell
        for held in self._held.pop((task.row.id, own), ()):
            waiting = self._tasks[held]
            if not waiting.candidate and waiting.column is not None and waiting.column.id in cell.idle:
                self._settle(held, cell.idle_cell(waiting.column.id))
            else:
                self._add(held)

    def known_runs(self, number: int) -> dict[tuple[str, int], Path]:
        """Runs that a task need not fly."""
        task = self._tasks[number]
        if task.waits_for is None:
            return {}
        return task.runs(self._cells[task.row.id, task.waits_for], self._root)

    def cells(self) -> list[Cell]:
        """The cells of all tasks, in their order."""
        return [self._done[number] for number in range(len(self._tasks))]

    @property
    def progress(self) -> str:
        """How many cells are done, of how many."""
        return f"{len(self._done)} of {len(self._tasks)}"

    def _tell(self) -> None:
        if self._on_cell is not None:
            left = sum(task.work for number, task in enumerate(self._tasks) if number not in self._done)
            left_s = (monotonic() - self._began) / self._flown * left if self._flown else None
            self._on_cell(len(self._done), len(self._tasks), left_s)


def _begin_process(parent: int) -> None:
    """A process ends with its parent, and Ctrl-C reaches the parent alone, which lets cells that fly come to their
    end.
    """
    end_with_parent(parent)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
