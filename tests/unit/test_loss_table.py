"""Loss tables: the file's form and its refusals, and the look-up at points whose answer is known."""

from __future__ import annotations

import io
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from skyrange.core.errors import InputError
from skyrange.radio.propagation.link_budget import tabled_loss_db
from skyrange.radio.propagation.loss_table import (
    NO_TABLE,
    LossGrid,
    free_space_of,
    loss_table,
    nearest_place,
    table_loss_db,
)
from skyrange.radio.propagation.loss_table_file import (
    GridHeader,
    LossTableFile,
    LossTableHeader,
    decode_loss_table,
    encode_loss_table,
    read_loss_table,
    write_loss_table,
)
from skyrange.radio.propagation.path_loss import free_space_db, open_ground_db, wavelength_m

GRID = LossGrid(-20.0, -10.0, 10.0, 5, 3, (2.0, 30.0))
WAVE = float(wavelength_m(2437.0))
PLACES = np.array([(-20.0, 0.0, 2.0), (20.0, 0.0, 2.0)])


def content(seed: int = 1) -> LossTableFile:
    chance = np.random.default_rng(seed)
    losses = chance.uniform(60.0, 120.0, (len(PLACES), *GRID.shape)).astype(np.float32)
    losses[0, 1, 2, 4] = np.nan
    header = LossTableHeader(
        skyrange="0",
        tracer={"name": "chance", "seed": seed},
        buildings="0" * 64,
        frequency_mhz=2437.0,
        reach_m=15.0,
        reach_up_m=5.0,
        grid=GridHeader(**GRID._asdict()),
    )
    return LossTableFile(header, PLACES, losses)


def loss(table: object, a: tuple[float, float, float], b: tuple[float, float, float]) -> float:
    return float(table_loss_db(table, *a, *b, math.dist(a, b), WAVE))  # type: ignore[arg-type]


def test_a_file_holds_what_was_written(tmp_path: Path) -> None:
    one = content()
    write_loss_table(tmp_path / "t.parquet", one)
    other = read_loss_table(tmp_path / "t.parquet")
    assert other.header == one.header
    np.testing.assert_array_equal(other.places_enu_m, one.places_enu_m)
    np.testing.assert_array_equal(other.loss_db, one.loss_db)


def test_equal_maps_are_equal_bytes() -> None:
    assert encode_loss_table(content()) == encode_loss_table(content())
    assert encode_loss_table(content()) != encode_loss_table(content(2))


@pytest.mark.parametrize("cut", [0, 1, 100, -1, -9])
def test_a_truncated_file_is_refused(cut: int) -> None:
    with pytest.raises(InputError, match=r"undamaged loss table|another Parquet file"):
        decode_loss_table(encode_loss_table(content())[:cut])


def rewritten(**changes: object) -> bytes:
    """The bytes of a file whose header has other values."""
    table = pq.read_table(pa.BufferReader(encode_loss_table(content())))
    told = json.loads(table.schema.metadata[b"skyrange.loss_table"])
    sink = io.BytesIO()
    pq.write_table(table.replace_schema_metadata({"skyrange.loss_table": json.dumps(told | changes)}), sink)
    return sink.getvalue()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"version": 2}, "version 2 — expected a loss table of version 1"),
        ({"version": None}, "version None"),
        ({"buildings": "x"}, "buildings"),
        ({"reach_m": -1.0}, "reach_m"),
        ({"more": 1}, "more"),
        ({"grid": {**GridHeader(**GRID._asdict()).model_dump(), "columns": 6}}, "rows of other lengths"),
        ({"grid": {**GridHeader(**GRID._asdict()).model_dump(), "columns": 99_999, "rows": 99_999}}, "places"),
        ({"grid": {**GridHeader(**GRID._asdict()).model_dump(), "heights_m": [3.0, 3.0]}}, "heights must ascend"),
    ],
)
def test_a_header_that_cannot_be_is_refused(changes: dict[str, object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        decode_loss_table(rewritten(**changes))


def test_other_parquet_files_and_numbers_out_of_range_are_refused(tmp_path: Path) -> None:
    pq.write_table(pa.table({"a": [1]}), tmp_path / "other.parquet")
    with pytest.raises(InputError, match="another Parquet file"):
        read_loss_table(tmp_path / "other.parquet")
    with pytest.raises(InputError, match="no such file"):
        read_loss_table(tmp_path / "none.parquet")
    for value in (np.inf, 1e9):
        bad = content()
        bad.loss_db[0, 0, 0, 0] = value
        with pytest.raises(InputError, match="out of range"):
            decode_loss_table(encode_loss_table(bad))
    for value in (np.nan, 1e300, 1.1e6):
        bad = replace(content(), places_enu_m=np.array([(value, 0.0, 2.0), (20.0, 0.0, 2.0)]))
        with pytest.raises(InputError, match="out of range"):
            decode_loss_table(encode_loss_table(bad))


def test_places_far_apart_are_found_too() -> None:
    far = replace(content(), places_enu_m=np.array([(-20.0, 0.0, 2.0), (9e5, 9e5, 2.0)])).table
    assert far.bin_columns * far.bin_rows < 50_000
    assert math.isfinite(loss(far, (-20.0, 0.0, 2.0), (0.0, 0.0, 10.0)))
    assert nearest_place(far, 9e5, 9e5 + 14.0, 2.0)[0] == 1
    assert nearest_place(far, 9e5, 9e5 + 16.0, 2.0)[0] == -1


def test_losses_on_grid_points_are_those_of_the_file() -> None:
    one = content()
    table = one.table
    points = GRID.points_enu_m
    seen = 0
    for t, place in enumerate(PLACES):
        for index in np.ndindex(*GRID.shape):
            b = tuple(points[index].tolist())
            own = np.abs(np.array(b)[:2] - PLACES[:, :2]).sum(axis=1).min() == 0.0 and b[2] == 2.0
            if math.isnan(one.loss_db[(t, *index)]) or own:  # both ends are places: the mean of both directions
                continue
            assert loss(table, tuple(place), b) == pytest.approx(float(one.loss_db[(t, *index)]), abs=1e-4)
            seen += 1
    assert seen > 50


def test_between_points_the_excess_over_free_space_is_interpolated() -> None:
    losses = np.stack([free_space_of(place, GRID, 2437.0) for place in PLACES])
    losses += GRID.points_enu_m[..., 0] * 0.1 + GRID.points_enu_m[..., 1] * 0.2 + GRID.points_enu_m[..., 2] * 0.3
    table = loss_table(PLACES, losses.astype(np.float32), GRID, 2437.0, 5.0, 5.0)
    a, b = (-20.0, 0.0, 2.0), (3.0, -4.0, 9.0)
    excess = loss(table, a, b) - float(free_space_db(math.dist(a, b), WAVE))
    assert excess == pytest.approx(0.3 - 0.8 + 2.7, abs=1e-4)


def test_outside_there_is_no_loss() -> None:
    table = content().table
    inside = (0.0, 0.0, 10.0)
    assert math.isfinite(loss(table, (-20.0, 0.0, 2.0), inside))
    assert math.isfinite(loss(table, (-20.0, 14.9, 2.0), inside))
    assert math.isnan(loss(table, (-20.0, 15.1, 2.0), inside))
    assert math.isnan(loss(table, (-20.0, 0.0, 7.1), inside))
    assert math.isnan(loss(table, (-20.0, 0.0, 2.0), (0.0, 0.0, 30.1)))
    assert math.isnan(loss(table, (-20.0, 0.0, 2.0), (0.0, 15.1, 10.0)))
    assert math.isfinite(loss(table, (-20.0, 0.0, 2.0), (0.0, 14.9, 0.0)))
    assert math.isnan(loss(NO_TABLE, (-20.0, 0.0, 2.0), inside))
    assert math.isnan(loss(table, (math.nan, 0.0, 2.0), inside))


def test_points_without_a_value_need_half_of_the_weight_around_them() -> None:
    table = content().table
    place = (-20.0, 0.0, 2.0)
    assert math.isnan(loss(table, place, (20.0, 10.0, 30.0)))
    assert math.isfinite(loss(table, place, (16.0, 6.0, 30.0)))
    assert math.isnan(loss(table, place, (18.0, 8.0, 30.0)))


def test_lookups_are_counted() -> None:
    table = content().table
    for _ in range(3):
        loss(table, (-20.0, 0.0, 2.0), (0.0, 0.0, 10.0))
    loss(table, (-20.0, 0.0, 2.0), (0.0, 0.0, 31.0))
    assert table.lookups.tolist() == [3, 1]


def test_a_tabled_loss_is_relative_to_open_ground() -> None:
    table = content().table
    a, b = (-20.0, 0.0, 2.0), (0.0, 0.0, 10.0)
    away = math.dist(a, b)
    relative = float(tabled_loss_db(table, *a, *b, away, WAVE))
    assert relative + float(open_ground_db(away, a[2], b[2], WAVE)) == pytest.approx(loss(table, a, b))
