"""Collision detection and response: swept cylinders, aircraft against aircraft and against buildings.

An aircraft is an upright cylinder from the bottom of its gear to its top, as wide as its propeller tips reach. In a
tick each aircraft moves along a straight line, and so does one relative to another: the time of overlap of two
cylinders is a quadratic in the plane and linear in height, solved exactly, so nothing passes through anything at any
speed. Against walls the path is sampled at every half radius, which a disc cannot skip however thin the wall.

Contact. Rigid bodies without friction: an impulse J along the normal at the point of contact, with restitution
`RESTITUTION`, through both masses and inertias, so momentum and, up to `MAX_RADPS`, angular momentum are conserved
(Baraff, "Physically Based Modeling", SIGGRAPH 2001). Aircraft are processed in the order of their ids.

Damage is a modelling choice, because no figures are published: a touched propeller is lost. In a contact from the side
these are the one nearest to the contact and all within 60 degrees of it, from above those under the other's disc, from
below none; and all of them if the impulse changes the aircraft's speed by more than `DESTRUCTION_MPS`.

A body whose pose is imposed by an engine does not yield: it is treated as infinitely heavy, and flies on marked as
crashed. One that a simulator moves yields and breaks like any other: the impulse goes to the simulator. Its contacts
with buildings and with others of its kind are the simulator's (`contact_tracker`).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from skyrange.city.wall_index import WallIndex, cell_of, distance_to_box, distance_to_footprint
from skyrange.core.compiled import compiled
from skyrange.world.airframes import MOTORS
from skyrange.world.body_state import BodyState, Floats, Ints
from skyrange.world.collision.broad_phase import (
    CG,
    HEIGHT,
    MASS,
    ON_ROOF_M,
    PER_JX,
    PER_JY,
    PER_JZ,
    PROPELLER,
    RADIUS,
    ROTORS,
    cylinder_gap,
    floor_and_clearance,
)
from skyrange.world.multirotor import CRASHED, IMPOSED, SIMULATED

RESTITUTION = 0.3
"""Coefficient of restitution along the normal, 0 inelastic, 1 elastic; a modelling choice."""
DESTRUCTION_MPS = 10.0
"""A change of speed that stops all motors; a modelling choice."""
MAX_RADPS = 100.0
"""Limit about each axis: faster than 16 turns a second an aircraft would break, and a tick could not follow the
rotation."""
GENTLE_MPS = 0.05
"""A slower touch causes neither bounce nor damage."""
_SIDE_COS = 0.5

WHO, WITH, SPEED, EAST, NORTH, UP, ENERGY = range(7)
"""Columns of a hit: rows of both bodies (a building is -1 less its index), relative speed, position, energy."""
NO_DAMAGE = -1.0
"""Energy of a touch without damage, such as of two aircraft that rest against each other; its position is not
reported."""


@compiled
def _into_body(q: Floats, x: float, y: float, z: float) -> tuple[float, float, float]:
    """A vector of the local frame in the body frame."""
    w, a, b, c = q[0], -q[1], -q[2], -q[3]
    tx, ty, tz = 2.0 * (b * z - c * y), 2.0 * (c * x - a * z), 2.0 * (a * y - b * x)
    return x + w * tx + b * tz - c * ty, y + w * ty + c * tx - a * tz, z + w * tz + a * ty - b * tx


@compiled
def _contact_response(i: int, state: BodyState, r: Any, n: Any) -> tuple[float, float]:
    """The speed of a body along `n` at a point `r` from its centre of gravity, and its inverse effective mass there."""
    velocity, attitude, rates, p = state.velocity[i], state.attitude[i], state.rates[i], state.shape[state.airframe[i]]
    nx, ny, nz = _into_body(attitude, n[0], n[1], n[2])
    rx, ry, rz = _into_body(attitude, r[0], r[1], r[2])
    tx, ty, tz = ry * nz - rz * ny, rz * nx - rx * nz, rx * ny - ry * nx
    speed = velocity[0] * n[0] + velocity[1] * n[1] + velocity[2] * n[2]
    speed += rates[0] * tx + rates[1] * ty + rates[2] * tz
    return speed, 1.0 / p[MASS] + tx * tx * p[PER_JX] + ty * ty * p[PER_JY] + tz * tz * p[PER_JZ]


@compiled
def _apply_impulse(i: int, state: BodyState, r: Any, n: Any, impulse: float, step_s: float) -> None:
    """Apply an impulse along `n` at a point `r` from the centre of gravity; the accelerometer measures it."""
    if state.is_imposed[i] == IMPOSED:
        return
    if state.is_imposed[i] == SIMULATED:
        state.impulse[i, 0] += impulse * n[0]
        state.impulse[i, 1] += impulse * n[1]
        state.impulse[i, 2] += impulse * n[2]
        state.impulse[i, 3] += impulse * (r[1] * n[2] - r[2] * n[1])
        state.impulse[i, 4] += impulse * (r[2] * n[0] - r[0] * n[2])
        state.impulse[i, 5] += impulse * (r[0] * n[1] - r[1] * n[0])
        return
    attitude, p = state.attitude[i], state.shape[state.airframe[i]]
    nx, ny, nz = _into_body(attitude, n[0], n[1], n[2])
    rx, ry, rz = _into_body(attitude, r[0], r[1], r[2])
    change = impulse / p[MASS]
    for axis in range(3):
        state.velocity[i, axis] += change * n[axis]
    spun = (
        impulse * (ry * nz - rz * ny) * p[PER_JX],
        impulse * (rz * nx - rx * nz) * p[PER_JY],
        impulse * (rx * ny - ry * nx) * p[PER_JZ],
    )
    for axis in range(3):
        state.rates[i, axis] = min(max(state.rates[i, axis] + spun[axis], -MAX_RADPS), MAX_RADPS)
    state.accel[i, 0] += change * nx / step_s
    state.accel[i, 1] += change * ny / step_s
    state.accel[i, 2] += change * nz / step_s


@compiled
def _break_motors(  # noqa: PLR0917
    i: int, state: BodyState, n: Any, east_m: float, north_m: float, reach_m: float, change: float
) -> None:
    """Stop the motors that a contact breaks: `n` points away from it; the last arguments locate the other's disc.

    A body that is `IMPOSED` is marked as crashed instead, because its motors are outside the world.
    """
    if state.is_imposed[i] == IMPOSED:
        state.flags[i, CRASHED] = 1
        return
    p = state.shape[state.airframe[i]]
    fx, fy, _ = _into_body(state.attitude[i], -n[0], -n[1], 0.0)
    ox, oy, _ = _into_body(state.attitude[i], east_m - state.position[i, 0], north_m - state.position[i, 1], 0.0)
    nearest, best = 0, -math.inf
    for m in range(MOTORS):
        x, y = p[ROTORS + 2 * m], p[ROTORS + 2 * m + 1]
        share = (x * fx + y * fy) / math.sqrt(x * x + y * y)
        if share > best:
            nearest, best = m, share
    for m in range(MOTORS):
        x, y = p[ROTORS + 2 * m], p[ROTORS + 2 * m + 1]
        if n[2] == 0.0:
            lost = m == nearest or x * fx + y * fy >= _SIDE_COS * math.sqrt(x * x + y * y)
        else:
            away = reach_m + p[PROPELLER]
            lost = n[2] < 0.0 and (x - ox) * (x - ox) + (y - oy) * (y - oy) < away * away
        if lost or change > DESTRUCTION_MPS:
            state.alive[i, m] = 0
            state.limit[i, m] = 0.0
            state.rotor_radps[i, m] = 0.0


@compiled
def _first_overlap(d0: Floats, d1: Floats, radii: float, height_a: float, height_b: float) -> tuple[float, bool]:
    """When in 0…1 a cylinder that moves from `d0` to `d1` relative to another first overlaps it (2 if not), and if
    sideways.
    """
    vx, vy, vz = d1[0] - d0[0], d1[1] - d0[1], d1[2] - d0[2]
    # in the plane: |d0 + v·t| < radii
    a = vx * vx + vy * vy
    b = d0[0] * vx + d0[1] * vy
    c = d0[0] * d0[0] + d0[1] * d0[1] - radii * radii
    side_in, side_out = -math.inf, math.inf
    if a > 0.0:
        root = b * b - a * c
        if root <= 0.0:
            return 2.0, False
        root = math.sqrt(root)
        side_in, side_out = (-b - root) / a, (-b + root) / a
    elif c >= 0.0:
        return 2.0, False
    # upwards: -height_a < d0 + v·t < height_b
    up_in, up_out = -math.inf, math.inf
    if vz != 0.0:
        one, two = (-height_a - d0[2]) / vz, (height_b - d0[2]) / vz
        up_in, up_out = min(one, two), max(one, two)
    elif d0[2] <= -height_a or d0[2] >= height_b:
        return 2.0, False
    begin = max(side_in, up_in)
    if begin > 1.0 or min(side_out, up_out) <= max(begin, 0.0):
        return 2.0, False
    if begin >= 0.0:
        return begin, side_in >= up_in
    # overlapping from the start: it is assumed to have entered through the nearer side
    across = radii - math.sqrt(d0[0] * d0[0] + d0[1] * d0[1])
    return 0.0, across <= min(d0[2] + height_a, height_b - d0[2])


@compiled
def _collide_pair(i: int, j: int, state: BodyState, step_s: float, hit: Floats) -> tuple[float, bool]:
    """Resolve the collision of two aircraft if their paths crossed: how far one was pushed, and
    whether they collided.
    """
    a, b = state.shape[state.airframe[i]], state.shape[state.airframe[j]]
    radii = a[RADIUS] + b[RADIUS]
    d0, d1 = np.empty(3), np.empty(3)
    for axis in range(3):
        d0[axis] = state.before[i, axis] - state.before[j, axis]
        d1[axis] = state.position[i, axis] - state.position[j, axis]
    when, sideways = _first_overlap(d0, d1, radii, a[HEIGHT], b[HEIGHT])
    if when > 1.0:
        return 0.0, False
    n = np.zeros(3)
    d = d0 + when * (d1 - d0)
    across = math.sqrt(d[0] * d[0] + d[1] * d[1])
    if sideways and across > 0.0:
        n[0], n[1] = d[0] / across, d[1] / across
        apart = radii - across
    else:
        n[2] = 1.0 if d[2] + a[HEIGHT] > b[HEIGHT] - d[2] else -1.0
        apart = b[HEIGHT] - d[2] if n[2] > 0.0 else d[2] + a[HEIGHT]
    if state.is_imposed[i] == SIMULATED and state.is_imposed[j] == SIMULATED:
        return 0.0, False
    led_a, led_b = state.is_imposed[i] != 0, state.is_imposed[j] != 0
    fixed_a, fixed_b = state.is_imposed[i] == IMPOSED, state.is_imposed[j] == IMPOSED
    share = b[MASS] / (a[MASS] + b[MASS])
    if led_a != led_b:
        share = 0.0 if led_a else 1.0
    apart = max(apart, 0.0)
    pa, pb = np.empty(3), np.empty(3)
    for axis in range(3):
        p, q = state.before[i, axis], state.before[j, axis]
        pa[axis] = p + when * (state.position[i, axis] - p) + n[axis] * apart * share
        pb[axis] = q + when * (state.position[j, axis] - q) - n[axis] * apart * (1.0 - share)
    # the point of contact: between the centres in proportion to the radii, in the middle of the overlap
    low, high = max(pa[2], pb[2]), min(pa[2] + a[HEIGHT], pb[2] + b[HEIGHT])
    weight = b[RADIUS] / radii
    point = np.array([pb[0] + weight * (pa[0] - pb[0]), pb[1] + weight * (pa[1] - pb[1]), 0.5 * (low + high)])
    ra = np.array([point[0] - pa[0], point[1] - pa[1], point[2] - pa[2] - a[CG]])
    rb = np.array([point[0] - pb[0], point[1] - pb[1], point[2] - pb[2] - b[CG]])
    speed_a, yield_a = _contact_response(i, state, ra, n)
    speed_b, yield_b = _contact_response(j, state, rb, n)
    closing = speed_b - speed_a
    if closing <= 0.0:  # parting already
        return 0.0, False
    for axis in range(3):  # for both the tick ends where they met
        if not led_a:
            state.position[i, axis] = pa[axis]
        if not led_b:
            state.position[j, axis] = pb[axis]
    relative = 0.0
    for axis in range(3):
        relative += (state.velocity[i, axis] - state.velocity[j, axis]) ** 2
    bounce = RESTITUTION if closing > GENTLE_MPS else 0.0
    impulse = 0.0
    if not (fixed_a and fixed_b):
        impulse = (1.0 + bounce) * closing / ((0.0 if fixed_a else yield_a) + (0.0 if fixed_b else yield_b))
    _apply_impulse(i, state, ra, n, impulse, step_s)
    _apply_impulse(j, state, rb, n, -impulse, step_s)
    apart = 0.0 if led_a and led_b else apart
    hit[WHO], hit[WITH], hit[SPEED], hit[ENERGY] = i, j, math.sqrt(relative), NO_DAMAGE
    if closing <= GENTLE_MPS:
        return apart, True
    _break_motors(i, state, n, pb[0], pb[1], b[RADIUS], impulse / a[MASS])
    _break_motors(j, state, -n, pa[0], pa[1], a[RADIUS], impulse / b[MASS])
    reduced = a[MASS] * b[MASS] / (a[MASS] + b[MASS])
    hit[ENERGY] = 0.5 * reduced * relative
    hit[EAST], hit[NORTH], hit[UP] = point[0], point[1], point[2]
    return apart, True


@compiled
def _collide_building(i: int, walls: WallIndex, state: BodyState, step_s: float, hit: Floats) -> tuple[float, bool]:
    """Resolve the collision of one aircraft with the first building on its path; returns as `_collide_pair`."""
    p = state.shape[state.airframe[i]]
    radius, height = p[RADIUS], p[HEIGHT]
    start, move = state.before[i].copy(), state.position[i] - state.before[i]
    long = math.sqrt(move[0] * move[0] + move[1] * move[1] + move[2] * move[2])
    looks = max(math.ceil(2.0 * long / radius), 1)
    for look in range(1, looks + 1):
        q = start + move * (look / looks)
        cell = cell_of(walls, q[0], q[1])
        if cell < 0:
            continue
        for k in range(walls.cell_start[cell], walls.cell_start[cell + 1]):
            b = walls.cell_buildings[k]
            base, top = walls.box[b, 4], walls.box[b, 5]
            if q[2] >= top - ON_ROOF_M or q[2] + height <= base or distance_to_box(walls, b, q[0], q[1]) >= radius:
                continue
            inside, away, near_e, near_n = distance_to_footprint(walls, b, q[0], q[1])
            if not inside and away >= radius:
                continue
            # out by the shortest path
            n = np.zeros(3)
            depth = radius + away if inside else radius - away
            lift, drop = top - q[2], q[2] + height - base
            if lift < depth and lift <= drop:
                n[2], depth = 1.0, lift
            elif drop < depth and base > 0.0:
                n[2], depth = -1.0, drop
            elif away > 0.0:
                sign = -1.0 if inside else 1.0
                n[0], n[1] = sign * (q[0] - near_e) / away, sign * (q[1] - near_n) / away
            else:
                n[2], depth = 1.0, lift
            place = q + n * depth
            if state.is_imposed[i]:
                depth = 0.0
            else:
                for axis in range(3):
                    state.position[i, axis] = place[axis]
            point = np.array([near_e, near_n, min(max(place[2] + p[CG], base), top)])
            if n[2] < 0.0 or (inside and n[2] > 0.0):
                point[0], point[1] = place[0], place[1]
            if n[2] != 0.0:
                point[2] = top if n[2] > 0.0 else base
            r = np.array([point[0] - place[0], point[1] - place[1], point[2] - place[2] - p[CG]])
            speed, yields = _contact_response(i, state, r, n)
            if speed >= 0.0:
                return depth, False
            v = state.velocity[i]
            total = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
            impulse = -(1.0 + (RESTITUTION if speed < -GENTLE_MPS else 0.0)) * speed / yields
            _apply_impulse(i, state, r, n, impulse, step_s)
            hit[WHO], hit[WITH], hit[SPEED], hit[ENERGY] = i, -1 - b, math.sqrt(total), NO_DAMAGE
            if speed >= -GENTLE_MPS:
                return depth, True
            _break_motors(i, state, n, place[0], place[1], math.inf, impulse / p[MASS])
            hit[ENERGY] = 0.5 * p[MASS] * total
            hit[EAST], hit[NORTH], hit[UP] = point[0], point[1], point[2]
            return depth, True
    return 0.0, False


@compiled
def resolve_collisions(  # noqa: PLR0917
    travelled: Floats,
    step_s: float,
    pairs: Ints,
    pair_due: Floats,
    order: Ints,
    walls: WallIndex,
    wall_due: Floats,
    state: BodyState,
) -> Floats:
    """Check all pairs and walls that are due and resolve their collisions; returns the hits (k, 7) in the order of ids.

    `travelled` (runs,) gains the longest push of each run. `pair_due` and `wall_due` are updated for what was checked.
    """
    hits = np.empty((2 * pairs.shape[0] + wall_due.shape[0], 7))
    count = 0
    longest = np.zeros(travelled.shape[0])
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        run = state.run[i]
        if travelled[run] <= pair_due[k]:
            continue
        push, met = _collide_pair(i, j, state, step_s, hits[count])
        longest[run] = max(longest[run], push)
        state.odometer_m[i] += 2.0 * push  # summed over the axes a push is less than twice its length
        state.odometer_m[j] += 2.0 * push
        if met:
            hits[count + 1] = hits[count]
            hits[count + 1, WHO], hits[count + 1, WITH] = j, i
            count += 2
        a, b = state.shape[state.airframe[i]], state.shape[state.airframe[j]]
        gap = cylinder_gap(state.position[i], state.position[j], a[RADIUS] + b[RADIUS], a[HEIGHT], b[HEIGHT])
        pair_due[k] = travelled[run] + 0.5 * gap
    if wall_due.shape[0] > 0:
        for k in range(order.shape[0]):
            i = order[k]
            if state.odometer_m[i] <= wall_due[i]:
                continue
            push, met = 0.0, False
            if state.is_imposed[i] != SIMULATED:
                push, met = _collide_building(i, walls, state, step_s, hits[count])
            longest[state.run[i]] = max(longest[state.run[i]], push)
            if met:
                count += 1
            p = state.shape[state.airframe[i]]
            state.floor[i], free = floor_and_clearance(walls, state.position[i], p[RADIUS], p[HEIGHT])
            wall_due[i] = state.odometer_m[i] + free
    for run in range(travelled.shape[0]):
        travelled[run] += longest[run]
    return hits[:count].copy()
