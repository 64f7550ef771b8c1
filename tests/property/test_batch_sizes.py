"""Does an aircraft's flight depend on how many others share its arrays? To the bit, it does not.

The kernels compute several aircraft at once in lanes, whose number divides no fleet in general; so a fleet in one piece
is compared with the same fleet in pieces of any sizes, in all modes and in states far from the usual ones.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from skyrange.vehicle.builtin import loop
from skyrange.vehicle.builtin.control import gains
from skyrange.vehicle.builtin.control.motor_control import LANES
from skyrange.vehicle.builtin.estimation import estimator
from skyrange.vehicle.builtin.estimation.state import FILTER
from skyrange.vehicle.builtin.layout import ESTIMATE, FLIGHT, GAINS, LEGS, AutoYawMode, ControlMode, new_records
from skyrange.vehicle.builtin.parameters.table import SETTINGS, fill_settings
from skyrange.world import multirotor
from skyrange.world.airframes import AIRFRAMES, MOTORS
from skyrange.world.body_state import BodyState
from skyrange.world.world import make_state

DT_S = 0.0025
STEPS = 8
"""So many that every phase of slow control comes twice."""
MOST = 5 * LANES
SIZES = [1, 2, 7, 8, 9, LANES - 1, LANES, LANES + 1, 3 * LANES + 5, 64, 65]

pieces = st.lists(st.sampled_from(SIZES), min_size=1, max_size=6)


def slices(sizes: list[int]) -> Iterator[slice]:
    """Consecutive pieces of `MOST` rows; the last one takes the rest."""
    begin = 0
    for size in [*sizes, MOST]:
        if begin < MOST:
            yield slice(begin, begin + size)
        begin += size


def attitudes(chance: np.random.Generator, spread: float) -> NDArray[np.float64]:
    """Unit quaternions around level flight, and with a large `spread` around nothing at all."""
    quat = np.array([1.0, 0.0, 0.0, 0.0]) + spread * chance.standard_normal((MOST, 4))
    unit: NDArray[np.float64] = quat / np.linalg.norm(quat, axis=1, keepdims=True)
    return unit


def random_rows(dtype: np.dtype[Any], chance: np.random.Generator, size: float) -> Any:
    """Records whose floats are random, with quantities that are positive in all flights."""
    rows = new_records(dtype, MOST)
    for name in dtype.names or ():
        if dtype[name].base.kind == "f":
            rows[name] = size * chance.standard_normal(rows[name].shape)
    for name in ("accel_xy", "accel_z", "speed_xy", "speed_up", "speed_down", "fixed_yaw_slewrate"):
        if name in (dtype.names or ()):
            rows[name] = 0.5 + np.abs(rows[name])
    return rows


def fleet(seed: int, spread: float) -> tuple[Any, ...]:
    """The arguments of `run_loop` for `MOST` aircraft in all modes, of two kinds, and their filters."""
    chance = np.random.default_rng(seed)
    estimate, flight = random_rows(ESTIMATE, chance, 1.0), random_rows(FLIGHT, chance, 1.0)
    legs, tuned = new_records(LEGS, MOST), new_records(GAINS, 2)
    parameters = np.zeros(2, SETTINGS)
    for row, name in enumerate(list(AIRFRAMES)[:2]):
        fill_settings(parameters, row, name, AIRFRAMES[name], 1, {})
        gains.set_motor_factors(tuned, row, AIRFRAMES[name])
        gains.compute_gains(tuned[row], parameters[row], DT_S)
    estimate["quat"], flight["att_target"] = attitudes(chance, spread), attitudes(chance, spread)
    flight["guided_quat"] = attitudes(chance, spread)
    flight["control"] = chance.choice([int(mode) for mode in ControlMode], MOST)
    flight["auto_yaw_mode"] = chance.choice([int(mode) for mode in AutoYawMode], MOST)
    flight["landed"] = chance.random(MOST) < 0.15
    flight["rates_only"] = chance.random(MOST) < 0.5
    flight["throttle"] = chance.random(MOST)
    flight["since_slow_s"] = DT_S * chance.integers(0, 4, MOST)
    flight["arming_delay_s"] = np.where(chance.random(MOST) < 0.1, 0.006, 0.0)
    set_index = chance.integers(0, 2, MOST)
    filters = random_rows(FILTER, chance, 0.1)
    filters["aiding"] = chance.integers(0, 2, MOST)
    return estimate, flight, legs, set_index, tuned, parameters, np.zeros((MOST, 4)), filters


def flown(tables: tuple[Any, ...], seed: int, sizes: list[int]) -> list[bytes]:
    """All that `STEPS` ticks of estimator and control loop leave, of a copy of the tables flown in pieces."""
    tables = tuple(table.copy() for table in tables)
    estimate, flight, legs, set_index, tuned, parameters, out, filters = tables
    chance = np.random.default_rng(seed)
    for _ in range(STEPS):
        gyro, accel = chance.standard_normal((MOST, 3)), 10.0 * chance.standard_normal((MOST, 3))
        gyro[chance.random(MOST) < 0.1] = math.nan
        accel[chance.random(MOST) < 0.1] = math.inf
        for rows in slices(sizes):
            estimator.step_strapdown(gyro[rows], accel[rows], DT_S, estimate[rows], filters[rows])
            own = estimate[rows], flight[rows], legs[rows], set_index[rows], tuned, parameters, out[rows]
            loop.run_loop(*own, DT_S)
    return [table.tobytes() for table in tables]


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), spread=st.sampled_from([0.0, 0.05, 0.3, 10.0]), sizes=pieces)
@example(seed=1, spread=0.05, sizes=[1] * (MOST - 1))
def test_estimator_and_control_of_an_aircraft_do_not_depend_on_the_others(
    seed: int, spread: float, sizes: list[int]
) -> None:
    tables = fleet(seed, spread)
    assert flown(tables, seed, sizes) == flown(tables, seed, [MOST])


def bodies(seed: int, spread: float) -> BodyState:
    """Bodies in the air, on the ground and imposed."""
    chance = np.random.default_rng(seed)
    names = list(AIRFRAMES)
    state = make_state([AIRFRAMES[names[k]] for k in chance.integers(0, len(names), MOST)], DT_S)
    state.flags[:, multirotor.ALOFT] = chance.random(MOST) < 0.5
    state.air[:] = chance.standard_normal((MOST, 3))
    state.limit[:] = 900.0
    state.commands[:] = chance.random((MOST, MOTORS))
    state.position[:] = 2.0 * chance.standard_normal((MOST, 3)) * [1, 1, 0.01]
    state.velocity[:] = 3.0 * chance.standard_normal((MOST, 3))
    state.attitude[:] = attitudes(chance, spread)
    state.rates[:] = 5.0 * chance.standard_normal((MOST, 3))
    state.rotor_radps[:] = 600.0 * chance.random((MOST, MOTORS))
    state.is_imposed[:] = chance.random(MOST) < 0.1
    return state


def moved(seed: int, spread: float, sizes: list[int]) -> list[bytes]:
    """All that `STEPS` quanta leave of the bodies, moved in pieces."""
    state = bodies(seed, spread)
    by_body = {name: array for name, array in state._asdict().items() if len(array) == MOST}
    for _ in range(STEPS):
        most = 0.0
        for rows in slices(sizes):
            multirotor.advance(DT_S, state._replace(**{name: array[rows] for name, array in by_body.items()}))
            most = max(most, float(state.max_step2_m2[0]))
        state.max_step2_m2[0] = most
    return [array.tobytes() for array in state]


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), spread=st.sampled_from([0.0, 0.3, 10.0]), sizes=pieces)
@example(seed=1, spread=0.3, sizes=[1] * (MOST - 1))
def test_the_motion_of_a_body_does_not_depend_on_the_others(seed: int, spread: float, sizes: list[int]) -> None:
    assert moved(seed, spread, sizes) == moved(seed, spread, [MOST])
