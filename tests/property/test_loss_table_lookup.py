"""Loss tables for any positions and any bytes: reciprocal, within the table's values, and never another exception."""

from __future__ import annotations

import math
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyrange.core.errors import InputError
from skyrange.radio.propagation.loss_table import (
    NO_TABLE,
    LossGrid,
    LossTable,
    free_space_of,
    loss_table,
    table_loss_db,
)
from skyrange.radio.propagation.loss_table_file import decode_loss_table, encode_loss_table
from skyrange.radio.propagation.path_loss import free_space_db, wavelength_m
from tests.unit.test_loss_table import content

GRID = LossGrid(-50.0, -50.0, 20.0, 6, 6, (2.0, 30.0, 60.0))
WAVE = float(wavelength_m(2437.0))
WHOLE = encode_loss_table(content())

table_loss_db(NO_TABLE, 0.0, 0.0, 2.0, 9.0, 0.0, 2.0, 9.0, WAVE)  # compiled outside of the tests' deadline

Place = tuple[float, float, float]
across = st.floats(-80.0, 80.0)
position = st.tuples(across, across, st.floats(0.0, 70.0))


def _table(seed: int, places: int) -> LossTable:
    chance = np.random.default_rng(seed)
    at = np.column_stack((chance.uniform(-60, 60, (places, 2)), chance.choice([2.0, 30.0], places)))
    excess = chance.uniform(-5.0, 40.0, (places, *GRID.shape))
    excess[chance.random(excess.shape) < 0.2] = np.nan
    losses = np.stack([free_space_of(place, GRID, 2437.0) for place in at]) + excess
    return loss_table(at, losses.astype(np.float32), GRID, 2437.0, 25.0, 15.0)


TABLES = [_table(seed, places) for seed, places in ((1, 1), (2, 5), (3, 40))]


@given(st.sampled_from(TABLES), position, position)
def test_both_directions_have_one_loss_within_the_values_of_the_table(table: LossTable, a: Place, b: Place) -> None:
    away = math.dist(a, b)
    there = float(table_loss_db(table, *a, *b, away, WAVE))
    back = float(table_loss_db(table, *b, *a, away, WAVE))
    assert there == back or (math.isnan(there) and math.isnan(back))
    if not math.isnan(there):
        excess = there - float(free_space_db(away, WAVE))
        assert -5.001 <= excess <= 40.001
        near = [((table.places[:, :2] - end[:2]) ** 2).sum(axis=1).min() <= 25.0**2 for end in (a, b)]
        assert any(near)


@given(st.sampled_from(TABLES), position, position)
def test_the_nearest_place_is_found(table: LossTable, a: Place, b: Place) -> None:
    from skyrange.radio.propagation.loss_table import nearest_place

    index, away = nearest_place(table, *a)
    ways = table.places - a
    within = (np.hypot(ways[:, 0], ways[:, 1]) <= 25.0) & (np.abs(ways[:, 2]) <= 15.0)
    if not within.any():
        assert index == -1
    else:
        assert away == pytest.approx((ways[within] ** 2).sum(axis=1).min())


@given(st.lists(st.tuples(st.integers(0, len(WHOLE) - 1), st.integers(0, 255)), min_size=1, max_size=8))
def test_damaged_bytes_are_refused_or_read(changes: list[tuple[int, int]]) -> None:
    data = bytearray(WHOLE)
    for at, value in changes:
        data[at] = value
    with suppress(InputError):
        decode_loss_table(bytes(data)).table  # noqa: B018


@given(st.binary(max_size=300))
def test_any_bytes_are_refused(data: bytes) -> None:
    with pytest.raises(InputError):
        decode_loss_table(b"PAR1" + data + b"PAR1")
