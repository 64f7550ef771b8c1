"""Every airframe of the table hovers, climbs, sinks, leans and turns as its numbers and the formulas say."""

from __future__ import annotations

import math

import numpy as np
import pytest

from skyrange.vehicle.builtin.parameters.table import AIRFRAME_TUNING
from skyrange.world import AIRFRAMES, Airframe
from skyrange.world.airframes import AIR_DENSITY_KGM3, GRAVITY_MPS2
from tests.validation.test_physics_multirotor import Flight

NAMES = sorted(AIRFRAMES)


def _drag(airframe: Airframe) -> float:
    return 0.5 * AIR_DENSITY_KGM3 * airframe.drag_area_m2


def _speed_at(airframe: Airframe, tilt: float) -> tuple[float, float]:
    """Steady level speed at a tilt, and the share of thrust it takes: weight, body drag and rotor drag in balance."""
    weight, drag, speed, share = airframe.mass_kg * GRAVITY_MPS2, _drag(airframe), 5.0, 0.0
    for _ in range(300):
        thrust = weight * math.cos(tilt) + drag * speed**2 * math.sin(tilt)
        share = thrust / airframe.max_thrust_n
        turning = 4.0 * airframe.rotor_max_radps * math.sqrt(share)
        speed = 0.5 * (speed + weight * math.tan(tilt) / (drag * speed + airframe.rotor_drag_ns2 * turning))
    return speed, share


@pytest.mark.parametrize("name", NAMES)
def test_hover(name: str) -> None:
    """sqrt(m·g/4k) rad/s on each rotor holds height: 1 µm in 10 s."""
    airframe = AIRFRAMES[name]
    speed = math.sqrt(airframe.mass_kg * GRAVITY_MPS2 / (4.0 * airframe.thrust_ns2))
    flight = Flight(airframe).spin(np.full(4, airframe.hover_thrust))
    assert flight.rotor_radps[0] == pytest.approx(speed, rel=1e-12)
    flight.run(10.0)
    assert flight.position[0, 2] == pytest.approx(10_000.0, abs=1e-6)


@pytest.mark.parametrize(
    ("name", "hover"),
    [
        ("iris", 1.5 * 9.80665 / (4 * 5.84e-6 * 1100**2)),
        ("hummingbird", 0.716 * 9.80665 / (4 * 8.54858e-6 * 838**2)),
        ("x500", 2.064 * 9.80665 / (4 * 8.54858e-6 * 1000**2)),
    ],
)
def test_hover_throttle_is_of_the_published_numbers(name: str, hover: float) -> None:
    """m·g over four rotors' thrust, from the models' own figures: 0.520, 0.292, 0.592."""
    assert AIRFRAMES[name].hover_thrust == pytest.approx(hover, rel=1e-12)
    assert 0.125 < hover < 0.6875  # the range of MOT_THST_HOVER


@pytest.mark.parametrize("name", NAMES)
def test_fastest_climb(name: str) -> None:
    """Full thrust against weight and body drag, v = √((T - m·g)/(½ρ·CdA)): 0.1 %."""
    airframe = AIRFRAMES[name]
    climb = math.sqrt((airframe.max_thrust_n - airframe.mass_kg * GRAVITY_MPS2) / _drag(airframe))
    flight = Flight(airframe).spin(np.ones(4)).run(30.0)
    assert flight.velocity[0] == pytest.approx([0.0, 0.0, climb], rel=1e-3, abs=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_terminal_fall(name: str) -> None:
    """√(2·m·g/(ρ·CdA)), motors off: 1e-6."""
    airframe = AIRFRAMES[name]
    fall = math.sqrt(airframe.mass_kg * GRAVITY_MPS2 / _drag(airframe))
    assert -Flight(airframe).run(40.0).velocity[0, 2] == pytest.approx(fall, rel=1e-6)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("tilt_deg", [10.0, 30.0, 45.0])
def test_level_speed(name: str, tilt_deg: float) -> None:
    """The balance of forces holds to 1 mm/s after 20 s."""
    airframe, tilt = AIRFRAMES[name], math.radians(tilt_deg)
    speed, share = _speed_at(airframe, tilt)
    if share > 1.0:
        pytest.skip("more than full thrust")
    flight = Flight(airframe).spin(np.full(4, share))
    flight.attitude[0] = (math.cos(tilt / 2.0), 0.0, math.sin(tilt / 2.0), 0.0)
    flight.velocity[0] = (speed, 0.0, 0.0)
    flight.run(20.0)
    assert flight.velocity[0] == pytest.approx([speed, 0.0, 0.0], abs=1e-3)


@pytest.mark.parametrize("name", NAMES)
def test_first_instant_of_a_roll(name: str) -> None:
    """The left pair stronger than the right: dΩ/dt = Σ lever·thrust/J in the first quantum, 1e-9."""
    airframe = AIRFRAMES[name]
    share = airframe.hover_thrust
    thrust = np.array([share - 0.05, share + 0.05, share + 0.05, share - 0.05])
    flight = Flight(airframe).spin(thrust).run(0.0025)
    one = airframe.max_thrust_n / 4.0
    torque = sum(rotor.left_m * one * float(t) for rotor, t in zip(airframe.rotors, thrust, strict=True))
    assert flight.rates[0, 0] == pytest.approx(torque / airframe.inertia_kgm2[0] * 0.0025, rel=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_a_tumble_ends_its_spinning_up(name: str) -> None:
    """One side's rotors alone: Ω = √(torque/(½ρ·CdA·arm³)), 1 %."""
    airframe = AIRFRAMES[name]
    flight = Flight(airframe).spin(np.array([0.0, 0.5, 0.5, 0.0]))
    torque = sum(r.left_m for r in airframe.rotors[1:3]) * 0.5 * airframe.max_thrust_n / 4.0
    arm = max(math.hypot(r.forward_m, r.left_m) for r in airframe.rotors)
    end = math.sqrt(torque / (_drag(airframe) * arm**3))
    flight.run(20.0)
    assert flight.rates[0, 0] == pytest.approx(end, rel=0.01)


def test_a_tumble_is_no_faster_than_the_propellers_pitch() -> None:
    """A fixed-pitch rotor gives nothing where the air comes at it as fast as its pitch advances: 4.5 inches a turn.

    The Iris's 10 x 4.5 at hover speed advance at 14.4 m/s, which its arm's end does at 57 rad/s. With one side hovering
    on, the drag on rotation ends the spinning up there to 20 %.
    """
    iris = AIRFRAMES["iris"]
    hover = iris.rotor_max_radps * math.sqrt(iris.hover_thrust)
    fastest = 4.5 * 0.0254 * hover / (2.0 * math.pi) / iris.arm_m
    flight = Flight(iris).spin(np.array([0.0, iris.hover_thrust, iris.hover_thrust, 0.0])).run(20.0)
    assert flight.rates[0, 0] == pytest.approx(fastest, rel=0.2)


def test_the_table_is_sound() -> None:
    """QUAD X motors, propellers clear of each other and inside the cylinder, tuning of real names."""
    for name, airframe in AIRFRAMES.items():
        assert airframe.name == name
        signs = [(math.copysign(1, r.forward_m), math.copysign(1, r.left_m), r.spin) for r in airframe.rotors]
        assert signs == [(1, -1, 1), (-1, 1, 1), (1, 1, -1), (-1, -1, -1)]
        for rotor in airframe.rotors:
            assert math.hypot(rotor.forward_m, rotor.left_m) + airframe.propeller_m <= airframe.radius_m
        neighbours = math.hypot(
            airframe.rotors[0].forward_m - airframe.rotors[2].forward_m,
            airframe.rotors[0].left_m - airframe.rotors[2].left_m,
        )
        assert neighbours > 2.0 * airframe.propeller_m  # propellers clear each other
    assert set(AIRFRAME_TUNING) <= set(AIRFRAMES)
