"""Runs of a study, a comparison or a matrix that a viewer shows: those that were kept, or else flown again."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

from skyrange.core.errors import InputError, nearest
from skyrange.record import RunRecord, load
from skyrange.record.manifest import MANIFEST
from skyrange.record.schema import FULL
from skyrange.runtime.run import OnProgress
from skyrange.scenario.model.scenario import Scenario
from skyrange.study.execution.plan import PlannedRun, RunPlan
from skyrange.study.execution.store import RunStore, open_store, require_plan
from skyrange.study.folder import open_folder
from skyrange.study.matrix.flights import plan_matrix, read_told
from skyrange.study.matrix.model import UNDEFENDED
from skyrange.study.measurement import RUNS
from skyrange.study.runs import fly
from skyrange.study.study_run import StudyPlan
from skyrange.study.variants import UNCHANGED, open_plan
from skyrange.twins.arms import ATTACKED, NOMINAL

_NAMES_SHOWN: Final = 12


@dataclass(frozen=True)
class ShownRun:
    """One run that is shown."""

    arm: str
    folder: Path
    """Where it is, if it was kept."""
    planned: PlannedRun
    fingerprint: str
    """What its fingerprint was; "" where the folder does not tell."""

    @property
    def kept(self) -> RunRecord | None:
        """Its record, if that was kept with truth."""
        if not os.path.isfile(self.folder / MANIFEST):
            return None
        record = load(self.folder)
        return record if record.keeps("truth") else None

    def fly(self, folder: Path, on_progress: OnProgress | None = None) -> RunRecord:
        """Fly it again into a folder, with a whole record. Raises the errors of `fly`."""
        if isinstance(self.planned.scenario, InputError):
            raise self.planned.scenario
        return fly(_with_whole_record(self.planned.scenario), folder, on_progress=on_progress, report=False)


@dataclass(frozen=True)
class ShownRuns:
    """Runs that are shown together, the one that is compared first."""

    store: RunStore
    name: str
    """Of the point, the variant or the cell."""
    seed: int
    runs: Sequence[ShownRun]
    others: int
    """How many others there are to choose from."""


@dataclass(frozen=True)
class _Choice:
    """What can be shown."""

    name: str
    seed: int
    make: Callable[[], Sequence[ShownRun]]
    alias: str = ""


def choose_runs(folder: Path, name: str | None, seed: int | None) -> ShownRuns:
    """The runs of a folder that are shown: of a point of a study (`p0003`, or a block, `p0003-s7`), of a variant of a
    comparison, or of a cell of a matrix (`ROW/COLUMN`), with a seed; by default of the first.

    Raises `InputError` for a folder of something else, for an input file that has changed since, and for what is not
    in it.
    """
    store = open_store(folder)
    choices = list(_list_choices(store, name))
    named = [choice for choice in choices if name in (None, choice.name, choice.alias)]
    if not named:
        known = list(dict.fromkeys(choice.name for choice in choices))
        more = f" … {len(known) - _NAMES_SHOWN} more" if len(known) > _NAMES_SHOWN else ""
        expected = f"one of {', '.join(known[:_NAMES_SHOWN])}{more}"
        raise InputError.one(str(folder), "--run", str(name), expected, nearest(str(name), known))
    chosen = next((choice for choice in named if seed in (None, choice.seed)), None)
    if chosen is None:
        seeds = ", ".join(str(choice.seed) for choice in named[:_NAMES_SHOWN])
        raise InputError.one(str(folder), "--seed", str(seed), f"one of {seeds}")
    return ShownRuns(store, chosen.name, chosen.seed, chosen.make(), len(choices) - 1)


def _list_choices(store: RunStore, name: str | None) -> Iterator[_Choice]:
    kinds: dict[str, Callable[[RunStore], Iterator[_Choice]]] = {
        "study": _of_study,
        "compare": _of_comparison,
        "matrix": partial(_of_matrix, name=name),
    }
    if store.kind not in kinds:
        hint = "Go on with it first: skyrange resume FOLDER."
        raise InputError.one(str(store.path), "plan.json: kind", store.kind, f"one of {', '.join(kinds)}", hint)
    yield from kinds[store.kind](store)


def _of_study(store: RunStore) -> Iterator[_Choice]:
    folder = open_folder(store.path)
    study = folder.study
    plan = StudyPlan(study, folder.blocks)
    require_plan(store, plan)
    against = study.against
    arms = [arm.id for arm in study.arms]
    shown = [*[arm for arm in arms if arm != against][-1:], against]
    for number, block in enumerate(folder.blocks):

        def make(number: int = number, name: str = block.name) -> Sequence[ShownRun]:
            rows = folder.read_rows(folder.blocks[number])[RUNS] if name in store.finished() else ()
            told = {row["arm"]: str(row.get("fingerprint", "")) for row in rows}
            return _make_runs(store, plan, number, shown, arms, told)

        yield _Choice(block.name.partition("-")[0], block.seed, make, block.name)


def _of_comparison(store: RunStore) -> Iterator[_Choice]:
    plan = open_plan(store)
    require_plan(store, plan)
    places = {flight: number for number, flight in enumerate(plan.flights.values())}
    for variant, seed in places:
        if variant != UNCHANGED:

            def make(variant: str = variant, seed: int = seed) -> Sequence[ShownRun]:
                return [
                    run
                    for arm in (variant, UNCHANGED)
                    for run in _make_runs(store, plan, places[arm, seed], [arm], [arm], {})
                ]

            yield _Choice(variant, seed, make)


def _of_matrix(store: RunStore, name: str | None) -> Iterator[_Choice]:
    matrix, keep = read_told(store)
    columns = [UNDEFENDED, *(column.id for column in matrix.columns)]
    for row in matrix.rows:
        first = row.load().seed if name is None or name.startswith(f"{row.id}/") else 0
        for column in columns:
            cell = f"{row.id}/{column}"
            for number in range(matrix.seeds):

                def make(row_id: str = row.id, column: str = column, number: int = number) -> Sequence[ShownRun]:
                    chosen = [row for row in matrix.rows if row.id == row_id]
                    plan = plan_matrix(matrix.model_copy(update={"rows": tuple(chosen)}), "first")
                    blocks = [block.name for block in plan.blocks]
                    found = next(cell for cell in plan.cells if cell.column_id == column and not cell.candidate)
                    place = blocks.index(found.block_name(found.scenario.seed + number))
                    arms = [arm.name for arm in found.list_arms()]
                    twin = NOMINAL if NOMINAL in arms else next(arm for arm in arms if arm != ATTACKED)
                    runs = _make_runs(store, plan, place, [ATTACKED, twin], arms, {})
                    if any(run.kept is None for run in runs):
                        require_plan(store, plan_matrix(matrix, keep))
                    return runs

                yield _Choice(cell, first + number, make)


def _make_runs(  # noqa: PLR0917
    store: RunStore,
    plan: RunPlan,
    number: int,
    shown: Sequence[str],
    arms: Sequence[str],
    told: dict[str, str],
) -> list[ShownRun]:
    """The runs of some arms of a block, which is given by its place."""
    block = plan.blocks[number]
    planned = dict(zip(arms, plan.plan_runs(block, store), strict=True))
    return [
        ShownRun(arm, store.path / planned[arm].folder, planned[arm], told.get(arm, "")) for arm in dict.fromkeys(shown)
    ]


def _with_whole_record(scenario: Scenario) -> Scenario:
    record: dict[str, Any] = {"level": FULL}
    if not scenario.record.truth_hz:
        record["truth_hz"] = type(scenario.record).model_fields["truth_hz"].default
    return scenario.model_copy(update={"record": scenario.record.model_copy(update=record)})
