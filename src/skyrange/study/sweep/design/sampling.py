"""Points of a design: combinations of the values of factors, and what is drawn for each seed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from statistics import NormalDist
from typing import Any, Final

from skyrange.core.chance import Chance
from skyrange.core.errors import InputError
from skyrange.core.ids import hash64
from skyrange.scenario.overrides import set_key
from skyrange.study.sweep.design.factors import Factor
from skyrange.study.sweep.design.model import Study

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
            yield [chance.uniform4(_POINTS, hash64(one.name), point)[0] for one in study.factors]
    else:
        try:
            from scipy.stats import qmc
        except ImportError as error:
            hint = "Install scipy: pip install 'skyrange[study]'."
            raise InputError.one("study", "sampling", study.sampling, "grid or random without scipy", hint) from error
        kind = qmc.LatinHypercube if study.sampling == "latin-hypercube" else qmc.Sobol
        yield from kind(dimensions, rng=study.first_seed).random(count).tolist()
