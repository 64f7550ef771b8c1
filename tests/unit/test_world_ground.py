"""Does an aircraft rest, slide, land, tip over and lie as the ground demands?"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from skyrange.world import AIRFRAMES, Body, Wind, World, battery

QUANTUM_NS = 2_500_000
IRIS = AIRFRAMES["iris"]


def _world(up_m: float = 0.0, wind: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> World:
    world = World([Body("blue/b1", "iris", 3.0, -4.0, up_m)], wind=Wind(wind))
    world.advance(0)
    return world


def _fly(
    world: World, start_s: float, seconds: float, command: float | list[float] = 0.0
) -> list[tuple[float, str, dict[str, Any]]]:
    """Tick a world; what it noted, with the time."""
    world.actuate(slice(None), np.broadcast_to(np.asarray(command, dtype=np.float64), (1, 4)))
    notes = []
    first = round(start_s * 400)
    for tick in range(first + 1, first + round(seconds * 400) + 1):
        notes += [(tick / 400, note.kind, dict(note.data)) for note in world.advance(tick * QUANTUM_NS)]
    return notes


def _hover(world: World) -> float:
    """The command that carries the weight at the present voltage: full thrust goes with its square."""
    return IRIS.command_for(IRIS.hover_thrust * (battery.RATED_V * IRIS.cells / _one(world)["battery_v"]) ** 2)


def _one(world: World) -> dict[str, float]:
    return {name: float(column[0]) for name, column in world.truth().items()}


@pytest.mark.parametrize("command", [0.0, 0.1, 0.3])
def test_rests_to_the_bit_in_wind(command: float) -> None:
    world = _world(wind=(6.0, -8.0, 0.0))
    before = _one(world)
    assert _fly(world, 0.0, 30.0, command) == []
    after = _one(world)
    changes = {"throttle", "charge", "battery_v", "battery_a"}
    assert {k: v for k, v in after.items() if k not in changes} == {k: v for k, v in before.items() if k not in changes}
    assert after["on_ground"] == 1.0
    assert world.sensors(slice(0, 1)).accel_mps2[0] == pytest.approx([0.0, 0.0, 9.80665], abs=1e-9)


def test_slides_when_the_wind_beats_friction() -> None:
    """60 m/s pushes with 0.5·ρ·CdA·v² = 120 N against a grip of m·g = 14.7 N."""
    world = _world(wind=(60.0, 0.0, 0.0))
    _fly(world, 0.0, 1.0)
    now = _one(world)
    assert now["vel_east_mps"] > 10.0
    assert now["up_m"] == 0.0


def test_takes_off_straight_up() -> None:
    world = _world()
    _fly(world, 0.0, 1.0, 0.8)
    now = _one(world)
    assert now["up_m"] > 1.0
    assert now["on_ground"] == 0.0
    assert (now["east_m"], now["north_m"]) == pytest.approx((3.0, -4.0), abs=1e-9)


def test_drop_touches_down_once_and_stays() -> None:
    """From 0.4 m an impact at sqrt(2·g·h) = 2.8 m/s, 2 % for drag and the quantum."""
    world = _world(up_m=0.4)
    notes = _fly(world, 0.0, 5.0)
    assert [kind for _, kind, _ in notes] == ["event.contact"]
    assert notes[0][2]["speed_mps"] == pytest.approx(math.sqrt(2.0 * 9.80665 * 0.4), rel=0.02)
    now = _one(world)
    assert (now["up_m"], now["vel_up_mps"], now["on_ground"], now["crashed"]) == (0.0, 0.0, 1.0, 0.0)


def test_a_fall_that_no_gear_has_to_stand_is_a_crash() -> None:
    """14 CFR 27.727: a drop of one and a half times 13 inches, 0.495 m; 0.55 m is beyond it."""
    world = _world(up_m=0.55)
    notes = _fly(world, 0.0, 5.0)
    assert [kind for _, kind, _ in notes] == ["event.contact", "event.crash"]
    assert notes[1][2] == {"tilt_deg": 0.0, "speed_mps": notes[0][2]["speed_mps"]}
    assert _fly(world, 5.0, 2.0, 1.0) == []
    assert _one(world)["up_m"] == 0.0


def test_soft_landing_and_another() -> None:
    """Sinking at a steady half metre per second is what a landing looks like; a hop makes a second touchdown."""
    world = _world(up_m=3.0)
    now_s, contacts = 0.0, []
    for _ in range(2):
        for _ in range(20 * 400):
            sink = _one(world)["vel_up_mps"]
            command = _hover(world) + 0.3 * (-0.5 - sink)
            contacts += _fly(world, now_s, 0.0025, command)
            now_s += 0.0025
            if _one(world)["on_ground"]:
                break
        contacts += _fly(world, now_s, 1.0, 0.1)
        now_s += 1.0
        contacts += _fly(world, now_s, 0.5, 0.75)
        now_s += 0.5
    assert [kind for _, kind, _ in contacts] == ["event.contact", "event.contact"]
    assert [data["speed_mps"] for _, _, data in contacts] == pytest.approx([0.5, 0.5], abs=0.15)


def test_skipping_on_the_ground_is_no_new_touchdown() -> None:
    world = _world()
    notes = _fly(world, 0.0, 0.08, 0.75) + _fly(world, 0.08, 1.0, 0.0)
    assert notes == []
    assert _one(world)["on_ground"] == 1.0


def test_idle_torque_does_not_tilt_a_standing_aircraft() -> None:
    """A difference of thrust below what the stance holds: level to 0.2 degrees, no crash."""
    world = _world()
    assert _fly(world, 0.0, 10.0, [0.2, 0.4, 0.4, 0.2]) == []
    now = _one(world)
    assert math.hypot(now["qx"], now["qy"]) < math.radians(0.1)


def test_uneven_take_off_tips_over_and_stays_down() -> None:
    """Both left rotors lift the left feet; past the tip angle the propellers break."""
    world = _world()
    notes = _fly(world, 0.0, 3.0, [0.0, 0.85, 0.85, 0.0])
    assert [kind for _, kind, _ in notes] == ["event.crash"]
    assert math.degrees(IRIS.tip_angle_rad) < notes[0][2]["tilt_deg"] < 90.0
    lying = _one(world)
    assert (lying["crashed"], lying["on_ground"]) == (1.0, 1.0)
    assert _fly(world, 3.0, 5.0, 1.0) == []
    still = _one(world)
    assert still["up_m"] == 0.0
    assert [still[k] for k in ("qw", "qx", "qy", "qz")] == [lying[k] for k in ("qw", "qx", "qy", "qz")]
    assert (still["rate_x_radps"], still["rate_y_radps"], still["rate_z_radps"]) == (0.0, 0.0, 0.0)


def test_falls_inverted_and_stays_down() -> None:
    """Half a roll in the air, then a fall: one touchdown, which is a crash too."""
    world = _world(up_m=30.0)
    notes = _fly(world, 0.0, 0.2, IRIS.hover_command) + _fly(world, 0.2, 0.15, [0.5, 0.8, 0.8, 0.5])
    notes += _fly(world, 0.35, 8.0)
    assert [kind for _, kind, _ in notes] == ["event.contact", "event.crash"]
    assert notes[0][2]["speed_mps"] > 10.0
    assert _fly(world, 8.35, 2.0, 1.0) == []
    assert _one(world)["up_m"] == 0.0


def test_landing_tilted_comes_level() -> None:
    """A touchdown at 15 degrees of tilt ends upright: the stance brings the aircraft level."""
    world = _world(up_m=0.3)
    world._bodies.attitude[0] = (math.cos(math.radians(7.5)), math.sin(math.radians(7.5)), 0.0, 0.0)
    assert [kind for _, kind, _ in _fly(world, 0.0, 3.0)] == ["event.contact"]
    now = _one(world)
    assert math.hypot(now["qx"], now["qy"]) < 1e-5
    assert now["crashed"] == 0.0


def test_skids_to_a_stop_by_friction() -> None:
    """Coulomb: from v the way is v²/(2·μ·g), 0.459 m from 3 m/s; 2 % for air drag."""
    world = _world()
    world._bodies.velocity[0, 0] = 3.0
    _fly(world, 0.0, 2.0)
    assert _one(world)["vel_east_mps"] == 0.0
    assert _one(world)["east_m"] - 3.0 == pytest.approx(9.0 / (2.0 * 9.80665), rel=0.02)


def test_accelerometer_feels_friction() -> None:
    """A skid decelerates at μ·g against its motion: heading north and skidding east, that is to the left."""
    world = _world()
    world._bodies.velocity[0, 0] = 3.0
    _fly(world, 0.0, 0.0025)
    assert world.sensors(slice(0, 1)).accel_mps2[0] == pytest.approx([0.0, 9.80665, 9.80665], rel=0.03, abs=1e-9)
