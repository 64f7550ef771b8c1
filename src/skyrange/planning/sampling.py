"""Routes by sampling: BIT* of the Open Motion Planning Library (OMPL), in three dimensions, with the exact clearance.

BIT* (Gammell, Srinivasa & Barfoot, Batch Informed Trees, ICRA 2015) finds a first way soon, and cheaper ones while it
goes on; it cannot tell that there is none. A number of iterations bounds it, never the machine's clock, and a seed
fixes its chance, so that equal questions have equal answers.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

from skyrange.city.city import City
from skyrange.core import elementary_python
from skyrange.core.errors import InputError
from skyrange.core.extras import describe_install
from skyrange.planning.limits import AROUND_M, Costs, Limits, NoRouteError, Place

Point3 = tuple[float, float, float]
"""East, north and up in metres."""


_INFORMED: Final = 0.95
"""How much of the least cost BIT* is told. It draws places by trial and error from those that may lie on a cheaper way;
were it told all, and the way nearly straight, hardly any place would, and the draw would not come to an end."""
_SHORT_M: Final = 100.0
"""Of a leg that is shorter BIT* is told less, for the same reason."""


@dataclass(frozen=True, slots=True)
class Sampling:
    """How BIT* searches."""

    iterations: int
    seed: int
    """Non-negative."""


def load_ompl(who: str = "ompl") -> Any:
    """The package `ompl`. Raises `InputError` if it is not installed."""
    try:
        import ompl.base
        import ompl.geometric
        import ompl.util
    except ImportError as error:
        expected = "an installed package ompl"
        raise InputError.one(who, "planner", "ompl", expected, describe_install("planning")) from error
    return ompl


def sample_leg(
    city: City, from_place: Place, to_place: Place, limits: Limits, sampling: Sampling, name: str
) -> list[Point3]:
    """The points of a way from place to place. Raises `NoRouteError`."""
    ends = [(*place, limits.alt_m) for place in (from_place, to_place)]
    for end, what in zip(ends, ("begins", "ends"), strict=True):
        building = city.first_obstruction([end], limits.clearance_m)
        if building is not None:
            raise NoRouteError(
                f"{name} {what} at ({end[0]:g}, {end[1]:g}) m, nearer than {limits.clearance_m:g} m to a building "
                f"{building.height_m:.0f} m high"
            )
    if ends[0] == ends[1] or city.is_clear(ends, limits.clearance_m):
        return ends
    points = _search(city, ends, limits, sampling)
    if not points:
        building = city.first_obstruction(ends, limits.clearance_m)
        who = f"{building.name or building.id}, {building.height_m:g} m high, is in the way" if building else "no way"
        raise NoRouteError(
            f"{name}: {who}, and {sampling.iterations} iterations found no way below {limits.ceiling_m:g} m; allow "
            "more iterations, or a higher ceiling_m"
        )
    return _shorten(city, points, limits)


def _search(city: City, ends: list[Point3], limits: Limits, sampling: Sampling) -> list[Point3]:
    """The way that BIT* has found; empty without any."""
    ompl = load_ompl()
    base = ompl.base
    ompl.util.setLogLevel(ompl.util.LogLevel.LOG_NONE)
    ompl.util.RNG.setSeed(sampling.seed % (2**32 - 1) + 1)  # 0 is not a seed; what is made from here on follows from it

    share = _INFORMED * min(elementary_python.distance(*ends) / _SHORT_M, 1.0)

    class Clear(base.MotionValidator):  # type: ignore[misc, name-defined]
        """Straight flights that keep the clearance."""

        def checkMotion(self, start: Any, end: Any) -> bool:  # noqa: N802 - the name that OMPL calls
            return city.is_clear([_point(start), _point(end)], limits.clearance_m)

    class Price(base.OptimizationObjective):  # type: ignore[misc, name-defined]
        """The costs of straight flights."""

        def stateCost(self, state: Any) -> Any:  # noqa: N802
            return base.Cost(0.0)

        def motionCost(self, start: Any, end: Any) -> Any:  # noqa: N802
            return base.Cost(limits.costs.of(_point(start), _point(end)))

        def motionCostHeuristic(self, start: Any, end: Any) -> Any:  # noqa: N802
            return base.Cost(share * limits.costs.least(_point(start), _point(end)))

    space = base.RealVectorStateSpace(3)
    bounds = base.RealVectorBounds(3)
    for axis in range(3):
        spare_m = AROUND_M if axis < 2 else 0.0
        bounds.setLow(axis, min(end[axis] for end in ends) - spare_m)
        bounds.setHigh(axis, max(end[axis] for end in ends) + spare_m if axis < 2 else limits.ceiling_m)
    space.setBounds(bounds)
    about = base.SpaceInformation(space)
    about.setStateValidityChecker(lambda state: city.is_clear([_point(state)], limits.clearance_m))
    motions = Clear(about)
    about.setMotionValidator(motions)
    about.setup()
    problem = base.ProblemDefinition(about)
    start, goal = (_state(space, end) for end in ends)
    problem.setStartAndGoalStates(start, goal)
    price = Price(about)
    problem.setOptimizationObjective(price)
    planner = ompl.geometric.BITstar(about)
    planner.setProblemDefinition(problem)
    planner.setup()
    checks = 0

    def is_over() -> bool:
        nonlocal checks
        checks += 1
        return checks > sampling.iterations

    planner.solve(base.PlannerTerminationCondition(is_over))
    path = problem.getSolutionPath()
    if path is None:
        return []
    return [_point(path.getState(number)) for number in range(path.getStateCount())]


def _state(space: Any, point: Point3) -> Any:
    state = space.allocState()
    for axis in range(3):
        state[axis] = point[axis]
    return state


def _point(state: Any) -> Point3:
    return state[0], state[1], state[2]


def _shorten(city: City, points: list[Point3], limits: Limits) -> list[Point3]:
    """The points left when shortcuts that are clear and cost no more are taken, from each point the longest."""
    kept = [points[0]]
    at = 0
    while at < len(points) - 1:
        reached = len(points) - 1
        while reached > at + 1 and not (
            _price(limits.costs, [points[at], points[reached]]) <= _price(limits.costs, points[at : reached + 1])
            and city.is_clear([points[at], points[reached]], limits.clearance_m)
        ):
            reached -= 1
        kept.append(points[reached])
        at = reached
    return kept


def _price(costs: Costs, points: list[Point3]) -> float:
    return elementary_python.add_up(costs.of(start, end) for start, end in pairwise(points))
