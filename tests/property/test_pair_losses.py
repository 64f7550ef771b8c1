"""Are the powers of all pairs those of each pair, in order, whatever the index and whoever is absent?

Does a floor change nothing but which signals there are, and do both tracers of lines agree?
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.city.buildings import Building
from skyrange.city.city import City
from skyrange.contracts.medium import RadioTable
from skyrange.core.chance import Chance
from skyrange.core.ids import hash64
from skyrange.radio.builtin.state import ANTENNAS
from skyrange.radio.control_link.propagation import Propagation
from skyrange.radio.propagation.link_budget import (
    NO_SIGNAL,
    IndexedRadios,
    MediumParams,
    append_received_powers,
    index_positions,
    received_power_dbm,
)
from skyrange.radio.propagation.loss_table import NO_TABLE
from skyrange.radio.propagation.obstruction import Obstacles, has_line_of_sight, obstacle_index, trace_line
from tests.property.test_loss_table_lookup import TABLES
from tests.tiers import examples

_BOXES = [(x, y, x + 45.0, y + 40.0) for x in range(-300, 300, 70) for y in range(-300, 300, 60)]
TOWN_CITY = City([Building(str(k), 12.0 + 9.0 * (k % 5), shapely.box(*b)) for k, b in enumerate(_BOXES)], "test")
TOWN = obstacle_index(TOWN_CITY.walls())
OPEN = obstacle_index()


@settings(max_examples=examples(60), deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(2, 40),
    spread_m=st.sampled_from([5.0, 300.0, 1500.0]),
    buckets=st.sampled_from([1, 2, 64]),
    horizon_m=st.sampled_from([150.0, 500.0, 3000.0]),
    floor_dbm=st.sampled_from([-110.0, -92.0, -70.0]),
    randomness=st.booleans(),
    town=st.booleans(),
)
@pytest.mark.rotating
def test_powers_of_all_pairs_are_those_of_each_pair(
    seed: int, n: int, spread_m: float, buckets: int, horizon_m: float, floor_dbm: float, randomness: bool, town: bool
) -> None:
    """Exactly the radios that `received_power_dbm` gives a signal, ascending, to the bit; one absent radio in ten."""
    rng = np.random.default_rng(seed)
    obstacles: Obstacles = TOWN if town else OPEN
    pos = rng.uniform([-spread_m, -spread_m, 0.0], [spread_m, spread_m, 60.0], (n, 3))
    pos[rng.random(n) < 0.1, rng.integers(3)] = math.nan
    vel = rng.normal(0.0, 8.0, (n, 3))
    antenna = np.stack((rng.integers(0, 2, n).astype(np.float64), rng.uniform(-3.0, 9.0, n)), axis=1)
    who = np.array([hash64(f"radio{k}") for k in range(n)], dtype=np.uint64)
    params = MediumParams(np.uint64(seed), horizon_m, randomness, 0.0, 0.0, False, False, NO_TABLE)
    head, follow = np.empty(buckets, dtype=np.int64), np.empty(n, dtype=np.int64)
    index_positions(head, follow, pos)
    senders = rng.permutation(n)[: max(1, n // 2)].astype(np.int64)
    powers = rng.uniform(0.0, 25.0, len(senders))
    time_ns, centre = 1_234_567_890, 2437.0
    best_dbi = float(antenna[:, 1].max()) + 2.15  # a dipole's gain at most
    rows, dbm, start = np.empty(len(senders) * n, dtype=np.int64), np.empty(len(senders) * n), [0]
    for sender, power in zip(senders.tolist(), powers.tolist(), strict=True):
        start.append(
            append_received_powers(
                params, obstacles, IndexedRadios(who, antenna, best_dbi, pos, vel, head, follow), sender, power, centre,
                time_ns, floor_dbm, rows, dbm, start[-1],
            )
        )  # fmt: skip
    for k, sender in enumerate(senders.tolist()):
        expected = []
        for i in range(n):
            if i == sender:
                continue
            one = received_power_dbm(
                params, obstacles, who, antenna, pos, vel, sender, i, float(powers[k]), centre, time_ns, floor_dbm
            )
            if one != NO_SIGNAL:
                expected.append((i, one))
        part = slice(start[k], start[k + 1])
        assert list(zip(rows[part].tolist(), dbm[part].tolist(), strict=True)) == expected


@settings(max_examples=examples(200), deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    spread_m=st.sampled_from([30.0, 300.0]),
    floor_dbm=st.floats(-120.0, -40.0),
    randomness=st.booleans(),
    town=st.booleans(),
)
def test_a_floor_only_leaves_out_what_is_below_it(
    seed: int, spread_m: float, floor_dbm: float, randomness: bool, town: bool
) -> None:
    """The power with a floor is the power without one, to the bit, or no signal if that is below the floor."""
    rng = np.random.default_rng(seed)
    obstacles: Obstacles = TOWN if town else OPEN
    pos = rng.uniform([-spread_m, -spread_m, 0.5], [spread_m, spread_m, 60.0], (12, 3))
    vel, antenna = rng.normal(0.0, 8.0, (12, 3)), np.zeros((12, 2))
    who = rng.integers(0, 2**63, 12).astype(np.uint64)
    params = MediumParams(np.uint64(seed), 3000.0, randomness, 0.0, 0.0, False, False, NO_TABLE)
    for i in range(1, 12):
        some = (params, obstacles, who, antenna, pos, vel, 0, i, 15.0, 2437.0, 5_000_000)
        power = received_power_dbm(*some, -600.0)
        assert received_power_dbm(*some, floor_dbm) == (power if power >= floor_dbm else NO_SIGNAL)


@settings(max_examples=examples(200), deadline=None)
@given(seed=st.integers(0, 2**32 - 1), height_m=st.sampled_from([2.0, 30.0, 60.0]))
def test_sight_is_lost_where_a_traced_line_is_blocked(seed: int, height_m: float) -> None:
    """`has_line_of_sight` against `trace_line`, with both ends anywhere, inside buildings too."""
    rng = np.random.default_rng(seed)
    for _ in range(20):
        a, b = rng.uniform([-350.0, -350.0, 0.0], [350.0, 350.0, height_m], (2, 3)).tolist()
        ends: tuple[Any, ...] = (*a, *b, 0.123, math.inf)
        met = trace_line(TOWN, *ends)
        assert has_line_of_sight(TOWN, *ends[:6]) == (met.blocking == 0)


def test_a_sender_reaches_some_and_not_others() -> None:
    """A free-space budget of 100 dB at 2437 MHz reaches 979 m (P.525): the radio at 900 m is listed, at 1100 m not."""
    pos = np.array([[0.0, 0.0, 100.0], [0.0, 1100.0, 100.0], [900.0, 0.0, 100.0]])
    params = MediumParams(np.uint64(1), 5000.0, False, 0.0, 0.0, False, False, NO_TABLE)
    head, follow = np.empty(8, dtype=np.int64), np.empty(3, dtype=np.int64)
    index_positions(head, follow, pos)
    who = np.arange(3, dtype=np.uint64)
    rows, dbm = np.empty(3, dtype=np.int64), np.empty(3)
    radios = IndexedRadios(who, np.zeros((3, 2)), 0.0, pos, np.zeros((3, 3)), head, follow)
    count = append_received_powers(params, OPEN, radios, 0, 10.0, 2437.0, 0, -90.0, rows, dbm, 0)
    assert rows[:count].tolist() == [2]
    assert dbm[0] == pytest.approx(10.0 - (32.4 + 20.0 * math.log10(2437.0) + 20.0 * math.log10(0.9)), abs=0.06)


@settings(max_examples=examples(60), deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    spread_m=st.sampled_from([5.0, 300.0, 1500.0]),
    randomness=st.booleans(),
    tabled=st.booleans(),
)
def test_the_gain_of_a_path_is_the_same_both_ways(seed: int, spread_m: float, randomness: bool, tabled: bool) -> None:
    """Reciprocity, also of shadowing and fading, in the open and between buildings; to rounding."""
    rng = np.random.default_rng(seed)
    n = 12
    table = TABLES[-1] if tabled else NO_TABLE
    names = [f"radio{k}" for k in range(n)]
    antennas = [(str(rng.choice(ANTENNAS)), float(rng.uniform(-3.0, 9.0))) for _ in names]
    path = Propagation(names, antennas, Chance(seed), TOWN_CITY, randomness=randomness, table=table)
    pos = rng.uniform([-spread_m, -spread_m, 0.0], [spread_m, spread_m, 60.0], (n, 3))
    vel = rng.normal(0.0, 8.0, (n, 3))
    one, other = (ends.astype(np.int64) for ends in np.triu_indices(n, 1))
    there = path.gains_db(RadioTable(0, pos, vel), one, other, 2437.0, 1_234_567_890)
    back = path.gains_db(RadioTable(0, pos, vel), other, one, 2437.0, 1_234_567_890)
    assert there == pytest.approx(back, abs=1e-6)
