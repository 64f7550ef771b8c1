"""Flights of every airframe by the builtin autopilot, also in turbulence and on a low battery.

Tolerances are in metres of true position, about twice what the controllers show.
"""

from __future__ import annotations

import numpy as np
import pytest

from skyrange.vehicle.builtin.modes import Mode
from skyrange.vehicle.contract import VehicleSpec
from skyrange.world import AIRFRAMES, Body, SensorSpec, Wind, World
from skyrange.world.sensing.geomagnetism import magnetic_field_at
from tests.integration.flight_harness import QUANTUM_NS, Range, square, start

pytestmark = pytest.mark.rotating

V = "blue/b1"
SLOW_BUT_ONE = ["iris", *(pytest.param(name, marks=pytest.mark.slow) for name in sorted(AIRFRAMES.keys() - {"iris"}))]


def _range(airframe: str, wind: Wind | None = None, charge: float = 1.0) -> Range:
    r = Range([VehicleSpec(V, 1, airframe=airframe)])
    body = Body(V, airframe, 0.0, 0.0, charge=charge, seed=11)
    r.world = World([body], QUANTUM_NS, wind or Wind(), sensors=SensorSpec(0.0, magnetic_field_at(r.origin)))
    return r


@pytest.mark.parametrize("airframe", SLOW_BUT_ONE)
def test_flies_a_square(airframe: str) -> None:
    r = _range(airframe)
    assert r.upload(V, square(20, 5)) == 0
    start(r, V)
    r.run_until(r.has("event.item_reached", 5), 90.0)
    assert np.abs(np.array([p[0, 2] for t, p in r.track if t > 9.0]) - 5.0).max() < 0.4
    r.run_until(r.has("event.disarmed"), 60.0)
    assert [note.kind for _, note in r.notes if note.kind in ("event.crash", "event.collision")] == []
    assert np.hypot(*r.positions()[0, :2]) < 0.3


@pytest.mark.parametrize("airframe", sorted(AIRFRAMES))
def test_hovers_still(airframe: str) -> None:
    """No oscillation of the rate loops: body rates below 0.01 rad/s, height within 5 cm."""
    r = _range(airframe)
    r.take_off(V, 10.0)
    r.run(12.0)
    rates, heights = [], []

    def look(r: Range) -> None:
        rates.append(np.abs(r.world.sensors(slice(None)).gyro_radps).max())
        heights.append(r.positions()[0, 2])

    r.run(5.0, look)
    assert max(rates) < 0.01
    assert np.ptp(heights) < 0.05


@pytest.mark.parametrize("airframe", SLOW_BUT_ONE)
def test_holds_its_place_in_moderate_turbulence(airframe: str) -> None:
    """W20 of 15.4 m/s in a wind of 5 m/s: σ of the gusts at 10 m is 2.7 m/s along; within 3 m, and it lands."""
    r = _range(airframe, Wind((5.0, 0.0, 0.0), 15.4))
    r.take_off(V, 10.0)
    r.run(10.0)
    since = r.seconds
    r.run(30.0)
    held = np.array([p[0] for t, p in r.track if t >= since])
    assert np.abs(held - held.mean(axis=0)).max() < 3.0
    assert held.std(axis=0)[:2].min() > 0.02  # and the gusts are felt
    assert r.mode(V, Mode.LAND) == 0
    r.run_until(r.has("event.disarmed"), 60.0)
    assert r.events("event.crash") == []


def test_a_low_battery_takes_more_throttle() -> None:
    throttle = []
    for charge in (1.0, 0.3):
        r = _range("iris", charge=charge)
        r.take_off(V, 10.0)
        r.run(10.0)
        throttle.append(float(r.world.truth()["throttle"][0]))
        assert abs(r.positions()[0, 2] - 10.0) < 0.3
    assert throttle[1] > throttle[0] + 0.05
