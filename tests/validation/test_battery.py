"""Does a battery sag and end as its formula says, and do the airframes hover for as long as their makers say?"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from skyrange.world import AIRFRAMES, Airframe, Body, World, battery
from skyrange.world.airframes import GRAVITY_MPS2
from skyrange.world.world import make_state

QUANTUM_NS = 2_500_000


def _hover_w(airframe: Airframe) -> float:
    """Electrical power: four rotors at weight's thrust, arm·k·ω³ each, over the drive's efficiency, and avionics."""
    omega = math.sqrt(airframe.mass_kg * GRAVITY_MPS2 / (4.0 * airframe.thrust_ns2))
    return (
        4.0 * airframe.torque_arm_m * airframe.thrust_ns2 * omega**3 / airframe.drive_efficiency + airframe.avionics_w
    )


def _endurance_s(airframe: Airframe, share: float) -> float:
    """Time to draw a share of the charge at hover power: ∫ Q·dc / I(c), I from P = (E(c) - R·I)·I."""
    power = _hover_w(airframe)
    charges = np.linspace(1.0 - share, 1.0, 20_001)
    rest = airframe.cells * np.array([battery.resting_v(c) for c in charges])
    volts = 0.5 * (rest + np.sqrt(rest**2 - 4.0 * airframe.resistance_ohm * power))
    return float(np.trapezoid(3600.0 * airframe.capacity_ah * volts / power, charges))


class Pack:
    """One battery in the kernel under a constant load."""

    def __init__(self, airframe: Airframe, charge: float = 1.0) -> None:
        self._bodies = make_state([airframe], 1e-9 * QUANTUM_NS)
        self._bodies.charge[0] = charge
        self.charge, self.volts, self.amperes = self._bodies.charge, self._bodies.battery_v, self._bodies.battery_a
        self.limit = self._bodies.limit

    def draw(self, shaft_w: float, seconds: float) -> None:
        self._bodies.work_j[0] = shaft_w * seconds
        battery.discharge(seconds, self._bodies)


@pytest.mark.parametrize("name", sorted(AIRFRAMES))
def test_hover_endurance(name: str) -> None:
    """To a fifth of the charge, against the integral: 0.2 % for the table's corners. In the kernel, at 10 ms."""
    airframe = AIRFRAMES[name]
    pack = Pack(airframe)
    shaft_w = (_hover_w(airframe) - airframe.avionics_w) * airframe.drive_efficiency
    steps = 0
    while pack.charge[0] > 0.2:
        pack.draw(shaft_w, 0.01)
        steps += 1
    assert 0.01 * steps == pytest.approx(_endurance_s(airframe, 0.8), rel=2e-3)


@pytest.mark.parametrize(
    ("airframe", "low_min", "high_min"),
    [
        # 3DR, "IRIS+ Operation Manual": 1.282 kg with battery, 16 to 22 minutes
        (replace(AIRFRAMES["iris"], mass_kg=1.282), 16.0, 22.0),
        # Ascending Technologies, "AscTec Hummingbird" data sheet: up to 20 minutes; 10 % either way
        (AIRFRAMES["hummingbird"], 18.0, 22.0),
    ],
    ids=["iris+", "hummingbird"],
)
def test_hovers_for_as_long_as_its_maker_says(airframe: Airframe, low_min: float, high_min: float) -> None:
    assert low_min < _endurance_s(airframe, 0.98) / 60.0 < high_min


@pytest.mark.parametrize("name", sorted(AIRFRAMES))
def test_rotors_are_as_good_as_small_propellers_are(name: str) -> None:
    """Figure of merit, ideal over shaft power, T^1.5/√(2ρA) / (arm·k·ω³): 0.4 to 0.7 at these sizes.

    Small propellers in static thrust, e.g. Brandt & Selig, "Propeller Performance Data at Low Reynolds Numbers",
    AIAA 2011-1255; momentum theory after Leishman, "Principles of Helicopter Aerodynamics", 2.
    """
    airframe = AIRFRAMES[name]
    thrust = airframe.mass_kg * GRAVITY_MPS2 / 4.0
    ideal = thrust**1.5 / math.sqrt(2.0 * 1.225 * math.pi * airframe.propeller_m**2)
    shaft = airframe.torque_arm_m * thrust * math.sqrt(thrust / airframe.thrust_ns2)
    assert 0.4 < ideal / shaft < 0.7


def test_power_in_flight_is_torque_times_speed() -> None:
    """A hovering world draws `_hover_w` over its voltage: 1 % for the rotors that still settle."""
    iris = AIRFRAMES["iris"]
    world = World([Body("blue/b1", "iris", 0.0, 0.0, 500.0)])
    world.advance(0)
    for tick in range(1, 2000):
        scale = battery.RATED_V * iris.cells / world.truth()["battery_v"][0]
        world.actuate(slice(None), np.full((1, 4), iris.command_for(iris.hover_thrust * scale**2)))
        world.advance(tick * QUANTUM_NS)
    truth = {name: float(column[0]) for name, column in world.truth().items()}
    assert truth["battery_v"] * truth["battery_a"] == pytest.approx(_hover_w(iris), rel=0.01)
    assert truth["vel_up_mps"] == pytest.approx(0.0, abs=0.5)


def test_sag_is_current_times_resistance() -> None:
    """V = E - R·I and P = V·I at any load it can carry: rounding."""
    iris = AIRFRAMES["iris"]
    for shaft_w in (0.0, 100.0, 700.0):
        pack = Pack(iris, 0.6)
        rest = 3.0 * battery.resting_v(0.6)
        pack.draw(shaft_w, 0.01)
        assert pack.volts[0] == pytest.approx(rest - iris.resistance_ohm * pack.amperes[0], rel=1e-12)
        assert pack.volts[0] * pack.amperes[0] == pytest.approx(shaft_w / 0.8 + 6.0, rel=1e-12)


def test_no_more_power_than_a_source_can_give() -> None:
    """E²/4R at half the voltage (maximum power transfer)."""
    iris = AIRFRAMES["iris"]
    pack = Pack(iris)
    pack.draw(1e6, 0.01)
    rest = 3.0 * battery.resting_v(1.0)
    assert pack.volts[0] == pytest.approx(0.5 * rest)
    assert pack.volts[0] * pack.amperes[0] == pytest.approx(rest**2 / (4.0 * iris.resistance_ohm))


def test_resting_voltage_is_the_tables() -> None:
    """ArduPilot's SIM_Battery.cpp: its rows, and halfway between two."""
    for charge, volts in ((1.0, 4.173), (0.5, 3.742), (0.02, 2.977), (0.0, 0.001)):
        assert battery.resting_v(charge) == pytest.approx(volts, rel=1e-12)
    assert battery.resting_v(0.5 * (0.5 + 0.5385)) == pytest.approx(0.5 * (3.742 + 3.783), rel=1e-12)


def test_motors_weaken_with_the_voltage() -> None:
    """Speed at full command goes with the voltage: SIM_Motor.cpp's `voltage_scale`."""
    iris = AIRFRAMES["iris"]
    full, low = Pack(iris), Pack(iris, 0.1)
    for pack in (full, low):
        pack.draw(200.0, 0.01)
        assert pack.limit[0].tolist() == pytest.approx([1100.0 * pack.volts[0] / 11.1] * 4, rel=1e-12)
    assert low.limit[0, 0] < 0.8 * full.limit[0, 0]


def test_an_empty_battery_stops_the_motors_for_good() -> None:
    world = World([Body("blue/b1", "iris", 0.0, 0.0, 200.0, charge=0.001)])
    world.advance(0)
    world.actuate(slice(None), np.full((1, 4), 0.8))
    notes = []
    for tick in range(1, 30 * 400):
        notes += [note.kind for note in world.advance(tick * QUANTUM_NS)]
    truth = {name: float(column[0]) for name, column in world.truth().items()}
    assert (truth["charge"], truth["battery_v"], truth["battery_a"]) == (0.0, 0.0, 0.0)
    assert notes == ["event.contact", "event.crash"]


def test_a_start_without_charge_does_not_take_off() -> None:
    world = World([Body("blue/b1", "iris", 0.0, 0.0, charge=0.0)])
    world.advance(0)
    world.actuate(slice(None), np.ones((1, 4)))
    for tick in range(1, 800):
        assert list(world.advance(tick * QUANTUM_NS)) == []
    assert world.truth()["up_m"][0] == 0.0
