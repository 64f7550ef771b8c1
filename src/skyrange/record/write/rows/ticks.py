"""Encoding of truth and sensors, tick by tick, into Arrow batches and rows of hash words."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from skyrange.contracts.components import ReceivedSensors, Sensors, World
from skyrange.core.ids import hash64
from skyrange.core.time import NS_PER_S, Time
from skyrange.record.digests import Words
from skyrange.record.schema import TABLES

_NAMES = pa.dictionary(pa.int32(), pa.string())


class TruthTick(NamedTuple):
    """The true state at one tick: `columns` are (n,) arrays by name, in the order of `vehicles`."""

    time_ns: Time
    vehicles: tuple[str, ...]
    sources: tuple[str, ...]
    columns: Mapping[str, NDArray[np.float64]]


class SensorTick(NamedTuple):
    """The sensors at one tick: `values` is (n, 30) in the order of the `sensors` table's columns."""

    time_ns: Time
    vehicles: tuple[str, ...]
    values: NDArray[np.float32]


def truth_tick(now: Time, world: World) -> TruthTick:
    """The true state of the bodies that exist."""
    vehicles, sources, columns = tuple(world.vehicles), tuple(world.sources), dict(world.truth())
    present = world.present
    if present is None:
        return TruthTick(now, vehicles, sources, columns)
    rows = np.flatnonzero(present).tolist()
    return TruthTick(
        now,
        tuple(vehicles[row] for row in rows),
        tuple(sources[row] for row in rows),
        {name: values[rows] for name, values in columns.items()},
    )


def sensor_tick(now: Time, world: World) -> SensorTick:
    """The sensors of the bodies that exist."""
    values = sensor_values(world.sensors(slice(0, len(world.vehicles))))
    present = world.present
    if present is None:
        return SensorTick(now, tuple(world.vehicles), values)
    rows = np.flatnonzero(present).tolist()
    return SensorTick(now, tuple(world.vehicles[row] for row in rows), values[rows])


def received_tick(now: Time, world: World, received: ReceivedSensors) -> SensorTick:
    """What autopilots received at one tick, of the bodies that exist and to which it is not what was sensed."""
    rows = np.arange(len(world.vehicles))[received.rows]
    values = sensor_values(received.sensors)
    differ = (values.view(np.uint32) != sensor_values(world.sensors(received.rows)).view(np.uint32)).any(axis=1)
    if world.present is not None:
        differ &= world.present[rows]
    return SensorTick(now, tuple(world.vehicles[row] for row in rows[differ].tolist()), values[differ])


def sensor_values(sensors: Sensors) -> NDArray[np.float32]:
    """A copy of one tick's sensors as (n, 30), in the order of the `sensors` table."""
    return np.column_stack(
        [
            sensors.gyro_radps,
            sensors.accel_mps2,
            sensors.attitude,
            sensors.gnss_enu_m,
            sensors.gnss_vel_enu_mps,
            sensors.baro_up_m,
            sensors.rangefinder_m,
            sensors.compass_gauss,
            sensors.gnss_accuracy,
            sensors.gnss_fix,
            sensors.gnss_satellites,
            sensors.gnss_time_ns / NS_PER_S,
            sensors.gnss_utc_error_ns / NS_PER_S,
            sensors.battery_v,
            sensors.battery_a,
        ]
    ).astype(np.float32)


def truth_batch(ticks: Sequence[TruthTick]) -> pa.RecordBatch:
    """Rows of truth, tick by tick; all ticks must have the columns of the first."""
    arrays = [_times(ticks), _names([tick.vehicles for tick in ticks]), _names([tick.sources for tick in ticks])]
    names = list(ticks[0].columns)
    arrays += [pa.array(_column(ticks, name)) for name in names]
    return pa.RecordBatch.from_arrays(arrays, names=["time_ns", "vehicle", "source", *names])


def split_ticks(batch: pa.RecordBatch) -> list[TruthTick]:
    """Rows of truth split into ticks by their time; `batch` must have at least one row."""
    times = batch.column("time_ns").to_numpy()
    bounds = [0, *(np.flatnonzero(np.diff(times)) + 1).tolist(), len(times)]
    vehicles, sources = batch.column("vehicle").to_pylist(), batch.column("source").to_pylist()
    columns = {name: batch.column(name).to_numpy() for name in batch.schema.names[3:]}
    return [
        TruthTick(
            int(times[start]),
            tuple(vehicles[start:end]),
            tuple(sources[start:end]),
            {name: column[start:end] for name, column in columns.items()},
        )
        for start, end in pairwise(bounds)
    ]


def sensor_batch(ticks: Sequence[SensorTick]) -> pa.RecordBatch:
    """Rows of `sensors` or `received_sensors`, tick by tick."""
    values = np.concatenate([tick.values for tick in ticks])
    return sensor_table(_times(ticks), _names([tick.vehicles for tick in ticks]), values)


def sensor_table(times_ns: pa.Array, vehicles: pa.Array, values: NDArray[np.float32]) -> pa.RecordBatch:
    """Rows of `sensors` or `received_sensors` from times, names and values (rows, 30)."""
    arrays = [times_ns, vehicles, *(pa.array(values[:, place]) for place in range(values.shape[1]))]
    return pa.RecordBatch.from_arrays(arrays, names=[column.name for column in TABLES["sensors"]])


def repeat_names(names: Sequence[str], count: int) -> pa.DictionaryArray:
    """Some names one after the other, `count` times over."""
    known = list(dict.fromkeys(names))
    codes = np.array([known.index(name) for name in names], dtype=np.int32)
    return pa.DictionaryArray.from_arrays(pa.array(np.tile(codes, count)), pa.array(known, pa.string()))


def truth_words(ticks: Sequence[TruthTick]) -> Words:
    """The digest's words, (rows, 4 + columns): time, vehicle, source, names, and the bits of every column.

    Columns are in order of name, so that the digest does not depend on the world's order.
    """
    names = sorted(ticks[0].columns)
    rows = sum(len(tick.vehicles) for tick in ticks)
    words = np.empty((rows, 4 + len(names)), dtype=np.uint64)
    words[:, 0] = np.repeat(
        np.array([tick.time_ns for tick in ticks], dtype=np.int64), [len(tick.vehicles) for tick in ticks]
    ).view(np.uint64)
    words[:, 1] = np.concatenate(_per_tick([tick.vehicles for tick in ticks], _hashes))
    words[:, 2] = np.concatenate(_per_tick([tick.sources for tick in ticks], _hashes))
    words[:, 3] = hash64("\n".join(names))
    for place, name in enumerate(names):
        words[:, 4 + place] = _column(ticks, name).view(np.uint64)
    return words


def _column(ticks: Sequence[TruthTick], name: str) -> NDArray[np.float64]:
    return np.concatenate([tick.columns[name] for tick in ticks]).astype(np.float64, copy=False)


def _times(ticks: Sequence[TruthTick] | Sequence[SensorTick]) -> pa.Array:
    times = np.array([tick.time_ns for tick in ticks], dtype=np.int64)
    return pa.array(np.repeat(times, [len(tick.vehicles) for tick in ticks]))


def _names(ticks: Sequence[tuple[str, ...]]) -> pa.Array:
    names = list(dict.fromkeys(name for tick in dict.fromkeys(ticks) for name in tick))
    numbers = {name: number for number, name in enumerate(names)}
    codes = np.concatenate(_per_tick(ticks, lambda tick: np.array([numbers[name] for name in tick], dtype=np.int32)))
    return pa.DictionaryArray.from_arrays(pa.array(codes), pa.array(names, pa.string())).cast(_NAMES)


def _hashes(names: tuple[str, ...]) -> NDArray[np.uint64]:
    return np.array([hash64(name) for name in names], dtype=np.uint64)


def _per_tick(ticks: Sequence[tuple[str, ...]], of: Callable[[tuple[str, ...]], NDArray[Any]]) -> list[NDArray[Any]]:
    """`of` applied to each tick's names; consecutive equal names, the usual case, are computed only once."""
    arrays: list[NDArray[Any]] = []
    for at, names in enumerate(ticks):
        arrays.append(arrays[-1] if at > 0 and names == ticks[at - 1] else of(names))
    return arrays
