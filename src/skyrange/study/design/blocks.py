"""Blocks of a study: points of its design, what is drawn for each seed, and the scenarios of all arms."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from statistics import NormalDist
from typing import Any, Final

from skyrange.assembly.build import build
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError, Problem
from skyrange.core.extras import describe_install
from skyrange.core.ids import hash64
from skyrange.scenario.model.defences import DefenceTable
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.overrides import set_key
from skyrange.scenario.shipped import load as load_scenario
from skyrange.study.design.factors import BUILDINGS, GRID, SCENARIO, WHOLE_KEYS, Factor, is_city_file
from skyrange.study.design.model import Study, StudyArm
from skyrange.study.feature_windows import COLLECTOR, check_collector
from skyrange.study.plan_size import check_size
from skyrange.twins.arms import ATTACKED, NOMINAL, SHAM, Arm, acting_attacks, scenario_of

Point = dict[str, Any]
"""Values, or the names of values, by name of the factor."""

_POINTS: Final = "study.points"
_DRAWS: Final = "study.draws"


def list_points(study: Study) -> list[Point]:
    """The points of a design, in order. They depend on the study's file alone, not on the number of workers.

    Latin hypercubes and Sobol's sequence are those of `scipy.stats.qmc`, scrambled (Owen 1998) with the first seed.
    """
    names = [factor.name for factor in study.factors]
    if study.sampling == "grid":
        levels = [_levels(factor) for factor in study.factors]
        return [dict(zip(names, chosen, strict=True)) for chosen in product(*levels)]
    assert study.points is not None
    rows = _unit_points(study, study.points, len(names))
    return [{factor.name: value_at(factor, u) for factor, u in zip(study.factors, row, strict=True)} for row in rows]


def draw_values(study: Study, point: int, seed: int) -> Point:
    """What is drawn for one seed of one point: by addressed chance, so that it depends on nothing else."""
    chance = Chance(seed)
    return {
        factor.name: value_at(factor, chance.uniform4(_DRAWS, hash64(factor.name), point)[0]) for factor in study.draws
    }


def value_at(factor: Factor, u: float) -> Any:
    """The value of a factor, or its name, at a share u of its distribution, 0 <= u < 1."""
    if factor.levels:
        return factor.levels[min(int(u * len(factor.levels)), len(factor.levels) - 1)]
    assert factor.low is not None
    assert factor.high is not None
    low, high = float(factor.low), float(factor.high)
    if factor.mean is not None and factor.deviation is not None:
        normal = NormalDist(float(factor.mean), float(factor.deviation))
        first, last = normal.cdf(low), normal.cdf(high)
        share = min(max(first + u * (last - first), 1e-15), 1.0 - 1e-15)
        value = min(max(normal.inv_cdf(share), low), high)
    elif factor.log:
        value = low * (high / low) ** u
    else:
        value = low + u * (high - low)
    return round(value) if factor.whole else value


def change_of(factor: Factor, level: Any) -> str:
    """The change of the scenario that sets a factor to one of its values, or to what a name stands for, as `--set` has
    it.
    """
    return set_key(factor.key, factor.value_of(level))


def _levels(factor: Factor) -> Sequence[Any]:
    if factor.levels:
        return factor.levels
    assert factor.steps is not None
    last = factor.steps - 1
    levels = [value_at(factor, step / last) for step in range(factor.steps)]
    return list(dict.fromkeys(levels))


def _unit_points(study: Study, count: int, dimensions: int) -> Iterator[list[float]]:
    """Points of the unit cube."""
    if not dimensions:
        yield from ([] for _ in range(count))
    elif study.sampling == "random":
        chance = Chance(study.first_seed)
        for point in range(count):
            yield [chance.uniform4(_POINTS, hash64(factor.name), point)[0] for factor in study.factors]
    else:
        try:
            from scipy.stats import qmc
        except ImportError as error:
            expected = "grid or random without scipy"
            hint = describe_install("study")
            raise InputError.one("study", "sampling", study.sampling, expected, hint) from error
        kind = qmc.LatinHypercube if study.sampling == "latin-hypercube" else qmc.Sobol
        yield from kind(dimensions, rng=study.first_seed).random(count).tolist()


@dataclass(frozen=True, slots=True)
class Block:
    """One point with one seed; its runs share all chance."""

    name: str
    """Name of its folder, such as p0003-s7."""
    point: int
    seed: int
    values: Point
    """Values of the factors, then of the draws."""


def list_blocks(study: Study) -> list[Block]:
    """All blocks of a study, in order: seed by seed, so that a part of the study has all points.

    Raises `InputError` for a study of more runs than its `max_runs`.
    """
    check_study_size(study)
    points = list_points(study)
    width = max(4, len(str(len(points) - 1)))
    return [
        Block(f"p{number:0{width}d}-s{seed}", number, seed, {**values, **draw_values(study, number, seed)})
        for round_ in range(study.seeds)
        for number, values in enumerate(points)
        for seed in (study.first_seed + (round_ if study.shared_seeds else round_ * len(points) + number),)
    ]


def check_study_size(study: Study) -> None:
    """Raise `InputError` for a study of more runs than its `max_runs`."""
    points = study.points
    if study.sampling == "grid":
        points = math.prod(len(_levels(factor)) for factor in study.factors)
    sizes = {"points": points or 1, "seeds": study.seeds, "arms": len(study.arms)}
    check_size(f"study {study.name}", sizes, study.max_runs, "Set max_runs in its file, or --set max_runs=N.")


def scenario_in(study: Study, arm: StudyArm, block: Block) -> Scenario:
    """The scenario of one run. Raises `InputError` with the problems of the scenario as changed."""
    whole_values = {
        factor.key: factor.value_of(block.values[factor.name]) for factor in study.varying if factor.key in WHOLE_KEYS
    }
    town = whole_values.get(BUILDINGS, "")
    changes = [*_set_grid(town), *study.changes]
    changes += [
        change_of(factor, block.values[factor.name]) for factor in study.varying if factor.key not in WHOLE_KEYS
    ]
    changes += arm.changes
    changes += ["record.csv=false", *([f"record.level={study.level}"] if study.level is not None else [])]
    base = load_scenario(
        whole_values.get(SCENARIO, study.scenario),
        changes,
        seed=block.seed,
        buildings=town if isinstance(town, str) and is_city_file(town) else None,
    )
    more = tuple(_defences(arm))
    if more or study.detectors:
        base = base.model_copy(
            update={"defences": (*base.defences, *more), "detectors": (*base.detectors, *study.detectors)}
        )
        problems = Scenario.cross_check(base)
        if problems:
            raise InputError(f"scenario {base.name}, arm {arm.id}", problems)
    acting = frozenset(acting_attacks(base))
    state = {"muted": Arm(NOMINAL), "active": Arm(ATTACKED, acting), "sham": Arm(SHAM)}[arm.attacks]
    scenario = scenario_of(base, state, block.seed)
    if arm.faults is None:
        return scenario
    faults = tuple(fault.model_copy(update={"muted": arm.faults == "muted" or fault.muted}) for fault in base.faults)
    return scenario.model_copy(update={"faults": faults})


def city_of(study: Study, block: Block) -> str | None:
    """The name of the city that a factor chooses; None without such a factor."""
    return next((str(block.values[factor.name]) for factor in study.varying if factor.key == BUILDINGS), None)


def check_blocks(study: Study, blocks: list[Block]) -> None:
    """Raise `InputError` with the problems of the scenarios of all arms at the corners of the design.

    A key that does not exist is found in the first block, a value outside its limits in that of its least and greatest.
    """
    problems: list[Problem] = []
    for block in _corners(study, blocks):
        for arm in study.arms:
            try:
                _check_scenario(study, scenario_in(study, arm, block))
            except InputError as error:
                known = {(problem.where, problem.value) for problem in problems}
                problems += [problem for problem in error.problems if (problem.where, problem.value) not in known]
    if problems:
        raise InputError(f"study {study.name}", problems)


def _check_scenario(study: Study, scenario: Scenario) -> None:
    """Raise `InputError` for a scenario that cannot be built, or that does not fit the learned detectors."""
    built = build(scenario)
    try:
        if study.learned is not None:
            used_ids = {COLLECTOR, *study.learned.names}
            problems = [
                Problem(f"detectors.{place}.id", detector.id, "an id that no learned detector has")
                for place, detector in enumerate(scenario.detectors)
                if detector.id in used_ids
            ]
            if problems:
                raise InputError(f"scenario {scenario.name}", problems)
            ends = [(spec.name, spec.a, spec.b) for spec in built.wiring.links]
            check_collector(study.learned.links, study.learned.side, ends)
    finally:
        built.close()


def is_numeric(blocks: Sequence[Block], factor: str) -> bool:
    """Whether all values of a factor are numbers."""
    values = [block.values[factor] for block in blocks]
    return all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in values)


def _set_grid(town: Any) -> Iterator[str]:
    """The change of the scenario that chooses its generated downtown, if there is one."""
    if isinstance(town, dict):
        yield set_key("city", {"grid": town})
    elif town.startswith(GRID):
        yield set_key("city.grid.seed", int(town.removeprefix(GRID)))


def _corners(study: Study, blocks: list[Block]) -> Iterator[Block]:
    corners = {blocks[0].name: blocks[0]}
    for factor in study.varying:
        if is_numeric(blocks, factor.name):
            ordered = sorted(blocks, key=lambda block: block.values[factor.name])
            corners.update({block.name: block for block in (ordered[0], ordered[-1])})
        else:
            first: dict[str, Block] = {}
            for block in blocks:
                first.setdefault(repr(block.values[factor.name]), block)
            corners.update({block.name: block for block in first.values()})
    yield from corners.values()


def _defences(arm: StudyArm) -> Iterator[DefenceTable]:
    for number, part in enumerate(arm.defences, start=1):
        id_ = arm.id if len(arm.defences) == 1 else f"{arm.id}-{number}"
        yield DefenceTable(id=id_, kind=part.kind, params=part.params, cost=part.cost)
