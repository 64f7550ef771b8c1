"""Is the rest of a plan free of what was closed, whatever that is, and no later than the way around all of it?"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from skyrange.city.buildings import Building
from skyrange.city.city import City
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S
from skyrange.core.volumes import Volume4D
from skyrange.gcs.plan import rerouting
from skyrange.gcs.plan.paths import Point
from skyrange.gcs.plan.plans import path
from skyrange.gcs.plan.rerouting import MAX_HOLD_S, reroute, rest_legs
from skyrange.gcs.plan.volumes import Margins, leg_volumes
from skyrange.planning.limits import NoRouteError
from skyrange.planning.routes import find_route
from skyrange.utm.airspace.claimed_airspace import Airspace

ORIGIN = Origin(40.778, -73.955)
TO_ELLIPSOID_M = ORIGIN.ellipsoid_of(ORIGIN.alt_msl_m)
MARGINS = Margins(horizontal_m=6.0, late_s=8.0, drift=0.1)
HERE = Point(0.0, 0.0, 30.0)
PLAN = path(ORIGIN, (0.0, 0.0, 0.0), [(0, 0, 30), (0, 150, 30), (120, 150, 30)], kind="guided", end="land")
TOWER = City([Building("tower", 200.0, shapely.box(-60, 60, -20, 100))], "a tower")
NOW = 100 * NS_PER_S


@st.composite
def closures(draw: st.DrawFn) -> Volume4D:
    """A box near the way, for some seconds from about now on."""
    east, north = draw(st.integers(-60, 120)), draw(st.integers(15, 170))
    wide, deep = draw(st.integers(5, 80)), draw(st.integers(5, 60))
    corners = ((east, north), (east + wide, north), (east + wide, north + deep), (east, north + deep))
    lower, start_s = draw(st.integers(0, 40)), draw(st.integers(-60, 90))
    return Volume4D(
        tuple(ORIGIN.geodetic_of(*corner) for corner in corners),
        lower + TO_ELLIPSOID_M,
        lower + draw(st.integers(5, 300)) + TO_ELLIPSOID_M,
        NOW + start_s * NS_PER_S,
        NOW + (start_s + draw(st.sampled_from([20, 60, 120, 3_600]))) * NS_PER_S,
    )


def is_free(volumes: Sequence[Volume4D], closed: Sequence[Volume4D]) -> bool:
    airspace = Airspace()
    for number, one in enumerate(closed):
        airspace.put(str(number), [one])
    return not airspace.find_overlaps(volumes)


@given(closed=st.lists(closures(), min_size=1, max_size=4))
@settings(deadline=None)
def test_the_rest_of_a_plan_is_free_and_ends_where_it_should(closed: list[Volume4D]) -> None:
    try:
        rest = reroute(PLAN, 1, HERE, closed, now=NOW, city=TOWER, margins=MARGINS)
    except NoRouteError:
        assume(False)
    claimed = leg_volumes(ORIGIN, rest_legs(rest, HERE), NOW, MARGINS)
    assert is_free(claimed, closed)
    assert rest.targets_enu_m[-1][:2] == (120.0, 150.0)
    assert Point(0.0, 150.0, rest.targets_enu_m[-1].up_m)[:2] in [point[:2] for point in rest.targets_enu_m]
    assert 0.0 <= rest.hold_s <= MAX_HOLD_S
    assert (rest.hold_s > 0.0) == (rest.targets_enu_m[0] == HERE)
    assert TOWER.is_clear([HERE, *rest.targets_enu_m], 4.9)


@given(closed=closures())
@settings(deadline=None)
def test_one_closed_volume_is_waited_for_only_if_that_is_quicker_than_around_it(closed: Volume4D) -> None:
    def duration_s(closed: Volume4D) -> float:
        rest = reroute(PLAN, 1, HERE, [closed], now=NOW, city=TOWER, margins=MARGINS)
        return sum(leg.duration_s for leg in rest_legs(rest, HERE))

    for_ever = Volume4D(closed.outline, closed.lower_m, closed.upper_m, NOW - 60 * NS_PER_S, NOW + 7_200 * NS_PER_S)
    try:
        longest_s = duration_s(for_ever)
    except NoRouteError:
        assume(False)
    assert duration_s(closed) <= longest_s + 1e-6


def test_hundreds_of_closed_volumes_are_soon_avoided(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each way meets other ones: in the end all are avoided at once."""
    planned = 0
    find = find_route

    def count(*arguments: Any) -> Any:
        nonlocal planned
        planned += 1
        return find(*arguments)

    monkeypatch.setattr(rerouting, "find_route", count)
    closed = []
    for number in range(200):
        east = -100.0 + number
        ring = tuple(ORIGIN.geodetic_of(*corner) for corner in ((east, 60), (east + 1, 60), (east + 1, 70), (east, 70)))
        closed.append(Volume4D(ring, TO_ELLIPSOID_M, TO_ELLIPSOID_M + 300, NOW, NOW + 7_200 * NS_PER_S))
    rest = reroute(PLAN, 1, HERE, closed, now=NOW, city=None, margins=MARGINS)
    assert is_free(leg_volumes(ORIGIN, rest_legs(rest, HERE), NOW, MARGINS), closed)
    assert planned <= 6
