from __future__ import annotations

import pytest

from skyrange.assembly.placement.clear_placing import APART_M, RISE_M, Airspace, find_clear_shift
from skyrange.gcs.plan.paths import Point


def flight(east_m: float, north_m: float, up_m: float, *to: tuple[float, float]) -> list[Point]:
    """Up, along, down."""
    corners = [(east_m, north_m), *to]
    return [Point(east_m, north_m, 0.0), *(Point(e, n, up_m) for e, n in corners), Point(*corners[-1], 0.0)]


def meets(path: list[Point], *others: list[Point]) -> bool:
    taken = Airspace()
    for other in others:
        taken.add(other)
    return taken.neighbours_of(path).conflict(0.0, 0.0)


EASTWARDS = flight(-50, 0, 20, (50, 0))


@pytest.mark.parametrize(
    ("up_m", "expected"), [(20, True), (20 + RISE_M - 0.1, True), (20 + RISE_M + 0.1, False), (5, False)]
)
def test_paths_cross_if_they_are_apart_in_height(up_m: float, expected: bool) -> None:
    northwards = flight(0, -50, up_m, (0, 50))
    assert meets(northwards, EASTWARDS) is expected
    assert meets(EASTWARDS, northwards) is expected


@pytest.mark.parametrize(("north_m", "expected"), [(APART_M - 0.1, True), (APART_M + 0.1, False)])
def test_nobody_climbs_through_a_path(north_m: float, expected: bool) -> None:
    up = [Point(0, north_m, 0), Point(0, north_m, 60), Point(0, north_m, 0)]
    assert meets(up, EASTWARDS) is expected
    assert meets(EASTWARDS, up) is expected
    below = [Point(0, north_m, 0), Point(0, north_m, 20 - RISE_M - 0.1), Point(0, north_m, 0)]
    assert meets(below, EASTWARDS) is False


def test_two_that_climb_at_one_place_meet() -> None:
    up = [Point(0, 0, 0), Point(0, 0, 60)]
    assert meets(up, up)
    assert meets([Point(9.9, 0, 0), Point(9.9, 0, 10)], up)
    assert not meets([Point(10.1, 0, 0), Point(10.1, 0, 10)], up)
    assert not meets(up)


def test_a_shift_ends_where_heights_or_distances_allow() -> None:
    taken = Airspace()
    taken.add(EASTWARDS)
    assert find_clear_shift(None, flight(0, -50, 30, (0, 50)), taken) == (0.0, 0.0)
    shift = find_clear_shift(None, flight(0, -50, 24, (0, 50)), taken)
    assert shift is not None
    assert not meets(
        [Point(p.east_m + shift[0], p.north_m + shift[1], p.up_m) for p in flight(0, -50, 24, (0, 50))], EASTWARDS
    )
