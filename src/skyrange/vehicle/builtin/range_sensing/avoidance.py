"""Simple avoidance: velocities of GUIDED are limited so that the aircraft stops at obstacles, or backs away from them.

After libraries/AC_Avoidance/AC_Avoid.cpp (`adjust_velocity`, `adjust_velocity_proximity`), which ArduCopter's GUIDED
applies to velocity targets alone (mode_guided.cpp, `velaccel_control_run`): positions, AUTO and RTL are flown as they
are. As there, the limited velocity replaces the target, and the limits stay until the next target comes.

Not modelled: fences (bit 0 of AVOID_ENABLE), obstacles above (MAV_SENSOR_ROTATION_PITCH_90), and the lean by which
ALT_HOLD and LOITER avoid.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from skyrange.core import elementary
from skyrange.core.time import NEVER, NS_PER_MS, Time
from skyrange.vehicle.builtin.control.shaping import sqrt_controller, stopping_distance
from skyrange.vehicle.builtin.fleet import Fleet, Timer, Vehicle
from skyrange.vehicle.builtin.flight_modes import guided
from skyrange.vehicle.builtin.layout import ControlMode
from skyrange.vehicle.builtin.range_readings.plane_vectors import (
    TINY,
    Vector2,
    closest_on_second,
    closest_to_origin,
    crosses_plane,
    dot,
    length,
)
from skyrange.vehicle.builtin.range_readings.readings import Proximity
from skyrange.vehicle.builtin.range_sensing.sensors import measure_height

LOOP_S: Final = 0.0025
"""ArduCopter's loop. Each pass limits what the last one made of a command, so that a command changes the velocity by no
more than AVOID_ACCEL_MAX times this, however long it takes until the next one."""
_LOOPS: Final = 4
"""Passes in the 10 ms after which guidance reads the velocity."""
_PROXIMITY_BIT: Final = 2  # AC_AVOID_USE_PROXIMITY_SENSOR
_MAX_ACCEL_MPS2: Final = 1.0  # AC_AVOID_ACCEL_CMSS_MAX
_BACK_SHARE: Final = 0.4  # calc_backup_velocity_2D
_TIMEOUT_NS: Final[Time] = 200 * NS_PER_MS  # AC_AVOID_ACCEL_TIMEOUT_MS
_AHEAD_M: Final = 0.02  # adjust_velocity_proximity, stopping_point_plus_margin


Vector3 = tuple[float, float, float]
"""East, north, up."""


class _Limits(NamedTuple):
    """Gain and acceleration of position control, and the margin."""

    gain: float
    accel_mps2: float
    margin_m: float

    def max_speed(self, distance_m: float) -> float:
        """The speed from which it stops within a distance (`get_max_speed`)."""
        return float(sqrt_controller(distance_m, self.gain, self.accel_mps2, LOOP_S))


class _Rules(NamedTuple):
    """How a velocity is changed: AVOID_BEHAVE, AVOID_BACKUP_DZ, AVOID_BACKUP_SPD, AVOID_ACCEL_MAX."""

    slides: bool
    dead_zone_m: float
    back_mps: float
    accel_mps2: float


def avoid_obstacles(fleet: Fleet) -> None:
    """Limit the velocities of all aircraft with a proximity sensor, where it is time to (every 10 ms)."""
    for row, sensors in fleet.range_sensors.items():
        if sensors.proximity is not None:
            sensors.proximity.boundary.drop_old(fleet.now)
            _avoid(fleet, fleet.vehicles[row], sensors.proximity)


def _avoid(fleet: Fleet, vehicle: Vehicle, proximity: Proximity) -> None:
    row = vehicle.row
    if fleet.control(vehicle) != ControlMode.VELOCITY or fleet.landed(vehicle) or vehicle.paused:
        return
    if not guided.in_guided_mode(vehicle):
        return
    if not int(fleet.param(vehicle, "AVOID_ENABLE")) & _PROXIMITY_BIT or _is_too_low(fleet, vehicle):
        return
    accel = min(float(fleet.flight["accel_xy"][row]), _MAX_ACCEL_MPS2)
    limits = _Limits(fleet.param(vehicle, "PSC_POSXY_P"), accel, fleet.param(vehicle, "AVOID_MARGIN"))
    rules = _Rules(
        fleet.param(vehicle, "AVOID_BEHAVE") == 0.0,
        fleet.param(vehicle, "AVOID_BACKUP_DZ"),
        fleet.param(vehicle, "AVOID_BACKUP_SPD"),
        fleet.param(vehicle, "AVOID_ACCEL_MAX"),
    )
    lines = proximity.boundary.list_lines()
    yaw = float(fleet.estimate["yaw"][row])
    target = fleet.flight["target_vel"][row]
    commanded = fleet.timers[row, Timer.GUIDED_TIMEOUT] != NEVER
    velocity: Vector3 = tuple(target.tolist())
    for _ in range(_LOOPS):
        before = velocity if commanded else (0.0, 0.0, 0.0)
        velocity = _adjust(proximity, fleet.now, before, lines, limits, rules, yaw)
        if velocity == before:
            break
    target[:] = velocity


def _adjust(  # noqa: PLR0917
    proximity: Proximity,
    now: Time,
    original: Vector3,
    lines: Sequence[tuple[Vector2, Vector2]],
    limits: _Limits,
    rules: _Rules,
    yaw: float,
) -> Vector3:
    """One pass of `adjust_velocity`, for a velocity east, north and up."""
    east, north, up = original
    cos, sin = elementary.cos(yaw), elementary.sin(yaw)
    wanted = (east * cos + north * sin, east * sin - north * cos)  # ahead, right
    safe, climb = limit_velocity(limits, lines, wanted, up, slides=rules.slides)
    back = _find_back_velocity(limits, lines, rules.dead_zone_m)
    if safe == wanted and climb == up and back == (0.0, 0.0):
        return original
    level = (safe[0] * cos + safe[1] * sin, safe[0] * sin - safe[1] * cos)
    back = (back[0] * cos + back[1] * sin, back[0] * sin - back[1] * cos)
    modified = (*_back_away(level, back, rules.back_mps), climb)
    modified = _limit_accel(proximity, now, original, modified, rules.accel_mps2)
    proximity.limited_ns = now
    return modified


def _is_too_low(fleet: Fleet, vehicle: Vehicle) -> bool:
    """Whether a rangefinder measures less than AVOID_ALT_MIN (avoidance.cpp, `low_alt_avoidance`)."""
    height = measure_height(fleet, vehicle)
    return height is not None and height < fleet.param(vehicle, "AVOID_ALT_MIN")


def limit_velocity(
    limits: _Limits, lines: Sequence[tuple[Vector2, Vector2]], wanted: Vector2, up: float, *, slides: bool
) -> tuple[Vector2, float]:
    """The velocity, ahead and right, and the climb rate that keep the margin from lines of obstacles, in m/s.

    With `slides` the part towards each line is limited. Otherwise the part towards the point of the line nearest
    to the way ahead, and all of it stops within the margin.
    """
    speed = math.sqrt(wanted[0] * wanted[0] + wanted[1] * wanted[1] + up * up)
    if speed == 0.0:
        return wanted, up
    reach = _AHEAD_M + limits.margin_m + float(stopping_distance(speed, limits.gain, limits.accel_mps2))
    end = (wanted[0] * reach / speed, wanted[1] * reach / speed)
    safe, climb = wanted, up
    for first, second in lines:
        if length(closest_to_origin(first, second)) < TINY:
            continue
        if slides:
            towards = closest_to_origin(first, second)
        else:
            towards = closest_on_second(end, first, second)
            if not crosses_plane(end, towards, second if towards == first else first):
                continue
            if length(towards) <= limits.margin_m:
                safe, climb = (0.0, 0.0), 0.0
                continue
        safe = _limit_towards(limits, safe, climb, towards)
    return safe, climb


def _limit_towards(limits: _Limits, velocity: Vector2, climb: float, towards: Vector2) -> Vector2:
    """Limit the part of a velocity towards a level obstacle (`limit_velocity_3D`)."""
    level = length(velocity)
    speed = math.sqrt(level * level + climb * climb)
    distance = length(towards)
    if speed == 0.0 or distance == 0.0:
        return velocity
    most = limits.max_speed(max(distance - limits.margin_m * level / speed, 0.0))
    way = (towards[0] / distance, towards[1] / distance)
    excess = dot(velocity, way) - most
    return velocity if excess <= 0.0 else (velocity[0] - way[0] * excess, velocity[1] - way[1] * excess)


def _find_back_velocity(limits: _Limits, lines: Sequence[tuple[Vector2, Vector2]], dead_zone_m: float) -> Vector2:
    """The velocity away from what is within the margin: the largest parts of each quadrant, added."""
    largest: dict[tuple[bool, bool], Vector2] = {}
    for first, second in lines:
        towards = closest_to_origin(first, second)
        distance = length(towards)
        breach = limits.margin_m - distance
        if distance < TINY or breach <= dead_zone_m:
            continue
        speed = limits._replace(accel_mps2=_BACK_SHARE * limits.accel_mps2).max_speed(breach)
        x, y = -towards[0] / distance * speed, -towards[1] / distance * speed
        quadrant = (x > 0.0, y > 0.0)
        old = largest.get(quadrant, (0.0, 0.0))
        largest[quadrant] = (_larger(old[0], x), _larger(old[1], y))
    ahead = right = 0.0
    for part in largest.values():
        ahead, right = ahead + part[0], right + part[1]
    return ahead, right


def _larger(old: float, new: float) -> float:
    return new if abs(new) > abs(old) else old


def _back_away(velocity: Vector2, back: Vector2, most: float) -> Vector2:
    """A velocity that is at least as fast, on each axis, as that of backing away (`adjust_velocity`)."""
    speed = length(back)
    if speed < TINY or most <= 0.0:
        return velocity
    scale = min(1.0, most / speed)
    east, north = (
        old if abs(want) < TINY else max(old, want) if want > 0.0 else min(old, want)
        for old, want in zip(velocity, (back[0] * scale, back[1] * scale), strict=True)
    )
    return east, north


def _limit_accel(
    proximity: Proximity,
    now: Time,
    original: Vector3,
    modified: Vector3,
    most: float,
) -> Vector3:
    """Change the velocity no faster than AVOID_ACCEL_MAX (`limit_accel`)."""
    if most == 0.0:
        return modified
    if now - proximity.limited_ns > _TIMEOUT_NS:
        proximity.limited_vel = original
    before = proximity.limited_vel
    change = [new - old for new, old in zip(modified, before, strict=True)]
    size = math.sqrt(change[0] * change[0] + change[1] * change[1] + change[2] * change[2])
    if size > most * LOOP_S:
        share = most * LOOP_S / size
        modified = (before[0] + change[0] * share, before[1] + change[1] * share, before[2] + change[2] * share)
    proximity.limited_vel = modified
    return modified
