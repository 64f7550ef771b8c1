"""Does the multirotor obey the closed forms of the physics it claims? Tolerances and sources at each test."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from skyrange.world import AIRFRAMES, Airframe, multirotor
from skyrange.world.airframes import AIR_DENSITY_KGM3, GRAVITY_MPS2
from skyrange.world.world import make_state

STEP_S = 0.0025
IRIS = AIRFRAMES["iris"]
NO_DRAG = replace(IRIS, drag_area_m2=0.0, rotor_drag_ns2=0.0)


class Flight:
    """One aircraft in the kernel, high above the ground, with its state in reach."""

    def __init__(
        self, airframe: Airframe, wind: tuple[float, float, float] = (0.0, 0.0, 0.0), up_m: float = 10_000.0
    ) -> None:
        self.airframe = airframe
        self.bodies = state = make_state([airframe], STEP_S)
        state.air[0] = wind
        state.limit[:] = airframe.rotor_max_radps
        state.position[0, 2] = up_m
        state.attitude[0, 0] = 1.0
        state.flags[0, multirotor.ALOFT] = 1
        self.work_j, self.commands, self.rotor_radps = state.work_j, state.commands, state.rotor_radps
        self.position, self.velocity, self.accel = state.position, state.velocity, state.accel
        self.attitude, self.rates = state.attitude, state.rates

    def run(self, seconds: float) -> Flight:
        for _ in range(round(seconds / STEP_S)):
            multirotor.advance(STEP_S, self.bodies)
        return self

    def spin(self, thrust: np.ndarray) -> Flight:
        """Rotors turning, and commanded to keep turning, at fractions of full thrust."""
        self.rotor_radps[0] = self.airframe.rotor_max_radps * np.sqrt(thrust)
        self.commands[0] = [self.airframe.command_for(float(fraction)) for fraction in thrust]
        return self


def _hovering(airframe: Airframe, wind: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Flight:
    return Flight(airframe, wind).spin(np.full(4, airframe.hover_thrust))


def _world_from_body(q: np.ndarray) -> np.ndarray:
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def test_hover_thrust_carries_the_weight() -> None:
    """Four rotors at sqrt(m·g / 4k) rad/s hold height (Newton): 1 µm in 10 s, rounding only."""
    speed = math.sqrt(IRIS.mass_kg * GRAVITY_MPS2 / (4.0 * IRIS.thrust_ns2))
    flight = _hovering(IRIS)
    assert flight.rotor_radps[0] == pytest.approx(speed, rel=1e-12)
    flight.run(10.0)
    assert flight.position[0, 2] == pytest.approx(10_000.0, abs=1e-6)
    assert flight.accel[0] == pytest.approx([0.0, 0.0, GRAVITY_MPS2], abs=1e-9)


def test_hover_command_solves_the_thrust_curve() -> None:
    """(1-e)·u + e·u² = m·g / (4·k·ω_max²), ArduPilot's SIM_Motor.cpp; for the Iris u = 0.66518 (to 1e-5)."""
    fraction = 1.5 * 9.80665 / (4.0 * 5.84e-6 * 1100.0**2)
    assert IRIS.hover_thrust == pytest.approx(fraction, rel=1e-12)
    u = IRIS.hover_command
    assert 0.35 * u + 0.65 * u * u == pytest.approx(fraction, rel=1e-12)
    assert u == pytest.approx(0.66518, abs=1e-5)
    flight = Flight(IRIS)
    flight.commands[0] = u
    flight.run(1.0)  # 80 time constants
    assert flight.rotor_radps[0] == pytest.approx(1100.0 * math.sqrt(fraction), rel=1e-12)


def test_free_fall_in_vacuum_is_exact() -> None:
    """Without drag z = z0 - g·t²/2 and v = -g·t (Galilei): exact for constant acceleration, so rounding only."""
    flight = Flight(NO_DRAG).run(0.5)
    assert 10_000.0 - flight.position[0, 2] == pytest.approx(0.5 * GRAVITY_MPS2 * 0.25, rel=1e-9)
    assert flight.velocity[0] == pytest.approx([0.0, 0.0, -GRAVITY_MPS2 * 0.5], rel=1e-12)
    assert flight.accel[0] == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)


def test_first_half_second_of_a_drop_is_nearly_free_fall() -> None:
    """Drag takes (v/v_t)²/6 of the fall, 0.9 % at 0.5 s: within 1 % of g·t²/2, and less, not more."""
    fallen = 10_000.0 - Flight(IRIS).run(0.5).position[0, 2]
    free = 0.5 * GRAVITY_MPS2 * 0.25
    assert 0.99 * free < fallen < 0.995 * free


def test_drop_approaches_terminal_velocity() -> None:
    """v = v_t·tanh(g·t/v_t), v_t = sqrt(2·m·g / (ρ·CdA)) (quadratic drag; NASA Glenn, "Terminal velocity"): 0.1 %."""
    terminal = math.sqrt(2.0 * IRIS.mass_kg * GRAVITY_MPS2 / (AIR_DENSITY_KGM3 * IRIS.drag_area_m2))
    flight = Flight(IRIS)
    for since, t in pairwise((0.0, 1.0, 2.0, 3.0, 20.0)):
        flight.run(t - since)
        assert -flight.velocity[0, 2] == pytest.approx(terminal * math.tanh(GRAVITY_MPS2 * t / terminal), rel=1e-3)
    assert -flight.velocity[0, 2] == pytest.approx(terminal, rel=1e-6)
    assert flight.accel[0, 2] == pytest.approx(GRAVITY_MPS2, rel=1e-6)


@pytest.mark.parametrize(("start", "command", "tau_s"), [(0.0, 1.0, 0.0125), (1100.0, 0.0, 0.025)])
def test_rotor_step_response(start: float, command: float, tau_s: float) -> None:
    """A first-order lag has made 1 - 1/e = 63.2 % of a step after its time constant, 86.5 % after two: rounding."""
    flight = Flight(IRIS)
    flight.rotor_radps[0] = start
    flight.commands[0] = command
    end = 1100.0 * command
    for constants in (1, 2):
        flight.run(tau_s)
        assert flight.rotor_radps[0] == pytest.approx(end + (start - end) * math.exp(-constants), rel=1e-9)


@pytest.mark.parametrize(
    ("stronger", "axis", "arm"),
    [((1, 2), 0, 0.42), ((1, 3), 1, 0.26), ((2, 3), 2, None)],
    ids=["left pair rolls right", "rear pair pitches down", "clockwise pair yaws left"],
)
def test_torque_step_accelerates_rotation(stronger: tuple[int, int], axis: int, arm: float | None) -> None:
    """dω/dt = τ/J about one axis (Euler), with τ from the geometry: 1e-9 over 0.2 s.

    The Iris's arms are longer in front (0.22 m) than behind (0.20 m), so the yaw pair is balanced for
    the check: with equal arms no other axis turns.
    """
    even = replace(NO_DRAG, rotors=tuple(replace(r, left_m=math.copysign(0.21, r.left_m)) for r in IRIS.rotors))
    thrust = np.full(4, 0.5)
    thrust[list(stronger)] += 0.01
    flight = Flight(even).spin(thrust).run(0.2)
    difference = 0.01 * even.max_thrust_n / 4.0
    lever = arm if arm is not None else 2.0 * even.torque_arm_m
    expected = np.zeros(3)
    expected[axis] = difference * lever / even.inertia_kgm2[axis] * 0.2
    assert flight.rates[0] == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_free_rotation_keeps_momentum_and_energy() -> None:
    """Without torque J·ω in space and ½·ω·J·ω are constant (Euler): 1e-4 and 1e-5 after 10 s of tumbling at 6 rad/s."""
    uneven = replace(NO_DRAG, inertia_kgm2=(0.02, 0.03, 0.055))
    inertia = np.array(uneven.inertia_kgm2)
    flight = Flight(uneven)
    flight.rates[0] = (3.0, 4.0, -3.5)
    before = inertia * flight.rates[0]
    energy = 0.5 * flight.rates[0] @ before
    flight.run(10.0)
    after = _world_from_body(flight.attitude[0]) @ (inertia * flight.rates[0])
    assert np.linalg.norm(after - before) < 1e-4 * np.linalg.norm(before)
    assert 0.5 * flight.rates[0] @ (inertia * flight.rates[0]) == pytest.approx(energy, rel=1e-5)


def test_symmetric_top_precesses() -> None:
    """Rates of a symmetric top turn about its axis at Ω = (Jz - Jx)/Jx·ωz (Goldstein, Classical Mechanics, 5.6).

    The midpoint rule's phase is late by (Ω·h)²/6, 2e-5 of the 18 rad turned here: 5e-4.
    """
    jx, _, jz = IRIS.inertia_kgm2
    flight = Flight(NO_DRAG)
    flight.rates[0] = (1.0, 0.0, 5.0)
    flight.run(4.0)
    angle = (jz - jx) / jx * 5.0 * 4.0
    assert flight.rates[0] == pytest.approx([math.cos(angle), math.sin(angle), 5.0], abs=5e-4)


def test_attitude_integrates_a_steady_rate() -> None:
    """A steady 2 rad/s yaw turns by 2·t: 1e-9 rad over 10 s."""
    flight = Flight(NO_DRAG)
    flight.rates[0] = (0.0, 0.0, 2.0)
    flight.run(10.0)
    w, _, _, z = flight.attitude[0]
    assert math.remainder(2.0 * math.atan2(z, w) - 20.0, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-9)


def test_drifts_with_a_steady_wind_by_rotor_drag() -> None:
    """Level, with rotor drag alone, v = w·(1 - exp(-c·Σω·t/m)) (linear drag): 0.1 %."""
    linear = replace(IRIS, drag_area_m2=0.0)
    flight = _hovering(linear, wind=(5.0, -2.0, 0.0))
    turning = float(flight.rotor_radps.sum())
    flight.run(4.0)
    share = 1.0 - math.exp(-linear.rotor_drag_ns2 * turning * 4.0 / linear.mass_kg)
    assert flight.velocity[0] == pytest.approx([5.0 * share, -2.0 * share, 0.0], rel=1e-3, abs=1e-9)


def test_drifts_with_a_steady_wind_by_body_drag() -> None:
    """Level, with body drag alone, w - v = w / (1 + k·w·t), k = ρ·CdA/2m (quadratic drag): 0.1 %."""
    bluff = replace(IRIS, rotor_drag_ns2=0.0)
    flight = _hovering(bluff, wind=(0.0, 8.0, 0.0)).run(5.0)
    k = 0.5 * AIR_DENSITY_KGM3 * bluff.drag_area_m2 / bluff.mass_kg
    assert flight.velocity[0] == pytest.approx([0.0, 8.0 - 8.0 / (1.0 + k * 8.0 * 5.0), 0.0], rel=1e-3, abs=1e-9)


def test_ends_at_the_speed_of_the_wind() -> None:
    flight = _hovering(IRIS, wind=(3.0, 4.0, 0.0)).run(120.0)
    assert flight.velocity[0] == pytest.approx([3.0, 4.0, 0.0], abs=1e-6)
    assert flight.accel[0] == pytest.approx([0.0, 0.0, GRAVITY_MPS2], abs=1e-6)


@pytest.mark.parametrize(("tilt_deg", "speed_mps"), [(30.0, 12.5), (45.0, 17.3)])
def test_level_speed_at_a_tilt(tilt_deg: float, speed_mps: float) -> None:
    """Force balance across and along the rotor axis at steady level flight; the speeds quoted in the table, 0.1 m/s."""
    tilt = math.radians(tilt_deg)
    drag = 0.5 * AIR_DENSITY_KGM3 * IRIS.drag_area_m2
    weight = IRIS.mass_kg * GRAVITY_MPS2
    speed = speed_mps
    for _ in range(100):  # fixed point of weight·tan = (body + rotor drag), rotor speed from the axial balance
        thrust = weight * math.cos(tilt) + drag * speed**2 * math.sin(tilt)
        turning = 4.0 * math.sqrt(thrust / 4.0 / IRIS.thrust_ns2)
        speed = 0.5 * (speed + weight * math.tan(tilt) / (drag * speed + IRIS.rotor_drag_ns2 * turning))
    assert speed == pytest.approx(speed_mps, abs=0.1)
    flight = Flight(IRIS).spin(np.full(4, thrust / IRIS.max_thrust_n))
    flight.attitude[0] = (math.cos(tilt / 2.0), 0.0, math.sin(tilt / 2.0), 0.0)  # nose (east) down
    flight.velocity[0] = (speed, 0.0, 0.0)
    flight.run(20.0)
    assert flight.velocity[0] == pytest.approx([speed, 0.0, 0.0], abs=1e-3)
