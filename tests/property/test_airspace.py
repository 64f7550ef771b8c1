"""Does the airspace find the overlaps that a comparison of all pairs finds, and are the delays it leads to the
least?"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace

import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from skyrange.core.time import NS_PER_S, Time
from skyrange.core.volumes import Volume4D
from skyrange.utm.airspace.cell_grid import CELL_DEG
from skyrange.utm.airspace.claimed_airspace import Airspace, Query
from skyrange.utm.alternatives import Limits, find_alternatives
from tests.tiers import examples

pytestmark = pytest.mark.rotating

CORNERS = st.builds(lambda a, b: (40.0 + a * CELL_DEG, -74.0 + b * CELL_DEG), st.integers(0, 12), st.integers(0, 12))
"""Corners of cells, and so edges that touch."""


@st.composite
def volumes(draw: st.DrawFn) -> Volume4D:
    ring = tuple(draw(st.lists(CORNERS, min_size=3, max_size=5)))
    if draw(st.integers(0, 9)) == 0:  # one that is in no cell
        ring = ((-40.0, -74.0), (60.0, -74.0), (60.0, 100.0))
    lower, start = draw(st.integers(0, 6)) * 10.0, draw(st.integers(0, 40)) * 10 * NS_PER_S
    return Volume4D(
        ring,
        lower,
        lower + draw(st.integers(1, 4)) * 10.0,
        start,
        start + draw(st.integers(1, 12)) * 10 * NS_PER_S,
    )


CLAIMS = st.lists(volumes(), min_size=1, max_size=4)


def outline(volume: Volume4D) -> shapely.Geometry:
    polygon = shapely.Polygon([(lng, lat) for lat, lng in volume.outline])
    return polygon if polygon.is_valid else polygon.convex_hull


def overlap(one: Volume4D, other: Volume4D) -> bool:
    return (
        one.start_ns < other.end_ns
        and other.start_ns < one.end_ns
        and one.lower_m < other.upper_m
        and other.lower_m < one.upper_m
        and bool(outline(one).intersects(outline(other)))
    )


def find_least_delay(claim: Sequence[Volume4D], others: Sequence[Volume4D], most_s: int) -> Time | None:
    """The first whole second that is free, by trying one after the other."""
    near = [  # those that a delay may bring together
        (one, other)
        for one in claim
        for other in others
        if overlap(replace(one, start_ns=0, end_ns=1), replace(other, start_ns=0, end_ns=1))
    ]
    for delay_s in range(most_s + 1):
        delay_ns = delay_s * NS_PER_S
        if not any(a.start_ns + delay_ns < b.end_ns and b.start_ns < a.end_ns + delay_ns for a, b in near):
            return delay_ns
    return None


class Claims(RuleBasedStateMachine):
    """Intents come, change and go, in the airspace and in a dictionary."""

    @initialize()
    def begin(self) -> None:
        self.airspace = Airspace()
        self.known: dict[str, tuple[list[Volume4D], int]] = {}

    @rule(name=st.sampled_from("abcdefgh"), claim=CLAIMS, rank=st.integers(0, 2))
    def put(self, name: str, claim: list[Volume4D], rank: int) -> None:
        self.airspace.put(name, claim, rank)
        self.known[name] = (claim, rank)

    @rule(name=st.sampled_from("abcdefgh"))
    def remove(self, name: str) -> None:
        self.airspace.remove(name)
        self.known.pop(name, None)

    @rule(claim=CLAIMS, ignored=st.sampled_from(["", "a"]))
    def find(self, claim: list[Volume4D], ignored: str) -> None:
        found = self.airspace.find_overlaps(claim, ignored)
        assert found == copy.deepcopy(self.airspace).find_overlaps(claim, ignored)
        expected = {
            (place, name)
            for place, volume in enumerate(claim)
            for name, (others, _) in self.known.items()
            for other in others
            if name != ignored and overlap(volume, other)
        }
        assert found == sorted(expected)

    @rule(
        claims=st.lists(CLAIMS, min_size=1, max_size=3),
        most_s=st.sampled_from([0, 40, 300]),
        ignored=st.sampled_from(["", "a"]),
        lowest_rank=st.integers(0, 3),
    )
    def find_delays(self, claims: list[list[Volume4D]], most_s: int, ignored: str, lowest_rank: int) -> None:
        there = [
            other
            for name, (others, rank) in self.known.items()
            for other in others
            if name != ignored and rank >= lowest_rank
        ]
        queries = [Query(claim, most_s * NS_PER_S) for claim in claims]
        found = self.airspace.find_least_delays(queries, ignored, lowest_rank)
        assert found == [find_least_delay(claim, there, most_s) for claim in claims]

    @invariant()
    def knows_the_same(self) -> None:
        if hasattr(self, "known"):
            assert len(self.airspace) == len(self.known)
            assert all(name in self.airspace for name in self.known)


Claims.TestCase.settings = settings(stateful_step_count=30, deadline=None)
TestClaims = Claims.TestCase


def airspace_of(others: Sequence[Sequence[Volume4D]]) -> Airspace:
    airspace = Airspace()
    for number, claim in enumerate(others):
        airspace.put(f"{number}", claim)
    return airspace


@given(claim=CLAIMS, others=st.lists(CLAIMS, max_size=6), count=st.sampled_from([1, 1, 1, 2, 3]))
@settings(deadline=None, max_examples=examples(2_000))
def test_alternatives_are_free_within_their_limits_and_the_cheapest_comes_first(
    claim: list[Volume4D], others: list[list[Volume4D]], count: int
) -> None:
    airspace = airspace_of(others)
    limits = Limits(300.0, (15.0, 30.0), (25.0, -25.0), 90.0, count)
    offered = find_alternatives(claim, airspace.find_least_delays, limits)
    assert len(offered) <= limits.count
    ground_m = min(one.lower_m for one in claim)
    for one in offered:
        assert not airspace.find_overlaps(one.volumes)
        assert one.delay_ns <= 300 * NS_PER_S
        if one.climb_m:
            assert max(volume.upper_m for volume in one.volumes) - ground_m <= limits.ceiling_m
        if not (one.climb_m or one.east_m or one.north_m):
            assert list(one.volumes) == [
                replace(volume, start_ns=volume.start_ns + one.delay_ns, end_ns=volume.end_ns + one.delay_ns)
                for volume in claim
            ]
    mere = [one.delay_ns for one in offered if not (one.climb_m or one.east_m or one.north_m)]
    later_ns = find_least_delay(claim, [volume for other in others for volume in other], 300)
    assert mere == ([] if later_ns is None else [later_ns]), "which every operator can fly"
    if not airspace.find_overlaps(claim):
        assert offered[0].delay_ns == 0
        assert offered[0].volumes == tuple(claim)
