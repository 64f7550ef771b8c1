"""Whatever sensors say: every number of the estimator stays finite, attitude a rotation, other rows untouched."""

from __future__ import annotations

import copy
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from skyrange.codec.mavlink import dialect
from skyrange.contracts.components import Sensors
from skyrange.vehicle.builtin.parameters.table import PARAMETERS
from skyrange.vehicle.contract import VehicleSpec
from tests.integration.flight_harness import Range
from tests.tiers import examples

pytestmark = pytest.mark.rotating

NAMES = [field.name for field in fields(Sensors) if field.name != "attitude"]
WILD = st.sampled_from([np.nan, np.inf, -np.inf, 1e308, -1e308, 1e-308, 1e9, -1e4, 0.0, 3.0, -0.5])
WHOLE = st.sampled_from([0, 1, 3, 6, -1, 2**63 - 1, -(2**63), 10**9, 255])
NAMED = [parameter.name for parameter in PARAMETERS if parameter.name.startswith("EK3_")]
LIES = st.lists(st.tuples(st.sampled_from(NAMES), st.integers(0, 2), WILD, WHOLE), min_size=1, max_size=8)


@pytest.fixture(scope="module")
def aloft() -> Range:
    fly = Range([VehicleSpec(f"blue/b{i}", i + 1, home_enu_m=(20.0 * i, 0.0, 0.0)) for i in range(2)], noise=1.0)
    for spec in fly.specs:
        fly.mode(spec.vehicle, 4)
        fly.arm(spec.vehicle)
        fly.command(spec.vehicle, dialect.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 10.0)
    fly.run(10.0)
    return fly


def sane(fly: Range) -> None:
    fleet, estimator = fly.engines[0]._fleet, fly.engines[0]._estimator
    for table in (fleet.estimate, estimator.filters, fleet.flight):
        assert table.dtype.names
        for name in table.dtype.names:
            column = table[name]
            for inner in column.dtype.names or ():
                assert np.isfinite(column[inner]).all(), (name, inner)
            if not column.dtype.names:
                assert np.isfinite(column).all(), name
    assert np.isfinite(estimator._history).all()
    assert np.abs((fleet.estimate["quat"] ** 2).sum(axis=1) - 1.0).max() < 1e-9
    for diagonal in ((0, 4, 7, 9), (0, 3, 5), (0, 2)):
        name = {4: "cov_horizontal", 3: "cov_vertical", 2: "cov_yaw"}[len(diagonal)]
        assert (estimator.filters[name][:, list(diagonal)] >= 0.0).all()


@settings(max_examples=examples(60), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(LIES, st.booleans())
def test_no_reading_poisons_the_state(aloft: Range, lies: list[tuple[str, int, float, int]], fresh: bool) -> None:
    fly, calm = copy.deepcopy(aloft), copy.deepcopy(aloft)

    def tamper(now: int, sensors: Sensors) -> None:
        for name, axis, value, whole in lies:
            array = getattr(sensors, name)
            if array.dtype.kind == "i":
                array[0] = whole
            elif array.ndim == 2:
                array[0, axis] = value
            else:
                array[0] = value
        if fresh:
            sensors.gnss_time_ns[0] = now

    fly.tamper = tamper
    fly.run(1.5)
    sane(fly)
    fly.tamper = None
    fly.run(0.5)
    sane(fly)
    calm.run(2.0)
    mine, other = fly.engines[0]._fleet.estimate, calm.engines[0]._fleet.estimate
    assert mine[1].tobytes() == other[1].tobytes()


@settings(max_examples=examples(40), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(st.tuples(st.sampled_from(NAMED), WILD), min_size=1, max_size=6),
)
def test_no_parameter_does_either(aloft: Range, asked: list[tuple[str, float]]) -> None:
    fly = copy.deepcopy(aloft)
    for name, value in asked:
        with np.errstate(over="ignore"):
            single = float(np.float32(value))
        fly.send("blue/b0", dialect.MAVLink_param_set_message(1, 1, name.encode(), single, 9))
    fly.run(1.0)
    sane(fly)


def test_sensors_that_are_mad_for_a_minute_are_survived(aloft: Range) -> None:
    """Every reading random over its full range, so that every reset and time-out comes up."""
    fly = copy.deepcopy(aloft)
    rng = np.random.default_rng(4)

    def tamper(now: int, sensors: Sensors) -> None:
        for name in NAMES:
            array = getattr(sensors, name)
            if array.dtype.kind == "i":
                array[0] = rng.integers(0, 7)
            else:
                array[0] = rng.choice([np.nan, np.inf, -1e300, 1.0, 50.0, -20.0, rng.normal() * 1e5])
        sensors.gnss_time_ns[0] = now - rng.integers(0, 400_000_000)

    fly.tamper = tamper
    for _ in range(30):
        fly.run(2.0)
        sane(fly)
