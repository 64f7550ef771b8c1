"""Geometric avoidance: a safe waypoint by a search of paths, then on with the mission. The published behaviour.

A track on a conflict course yields a waypoint at once: the first bend of the shortest way to the goal that keeps clear
of walls and of everybody heard. Passing on the right is preferred, so that two who meet head-on and do alike
pass each other (as 14 CFR 91.113(e) has it, for aircraft with people on board).

Path search for avoidance: the shortest open path over a few chosen places, past others and around buildings. The
places: along the mission's own leg beyond the trouble, a fan around oneself, rings around those that stand, and the
corners of buildings (the shortest path among polygons bends at their corners only: Lozano-Pérez & Wesley, CACM 22(10),
1979). Between them Dijkstra's algorithm (Numerische Mathematik 1, 1959), where a leg is open when it keeps clear of
walls and, at the time it would be flown, of everybody's cylinder.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from skyrange.city.wall_index import WallIndex
from skyrange.core import elementary, elementary_python, elementwise
from skyrange.core.compiled import compiled
from skyrange.core.time import Time
from skyrange.vehicle.avoidance.conflicts import entry_s, find_conflicts, velocity_towards
from skyrange.vehicle.avoidance.contract import AvoidanceLimits, AvoidancePlugin, Episode, Own, Tracks, Vector
from skyrange.vehicle.avoidance.episodes import EpisodicAvoidance
from skyrange.vehicle.avoidance.wall_queries import (
    clearance,
    corners,
    find_buildings_nearby,
    is_leg_clear,
    is_straight_clear,
)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_MAX_CORNERS = 64
_STEP_M = 25.0
"""How far apart places on the mission's leg are."""
_FAN_DEG = (30.0, 60.0, 90.0, 135.0, 180.0)
_SIDES = 8
_MAX_RINGS = 10
_ROOM = 1.15
"""Rings are this much wider than the cylinder, so that legs between their places keep out of it."""


@compiled
def _open(  # noqa: PLR0917
    a: Floats, b: Floats, begin_s: float, pos: Floats, vel: Floats, speed: float, radius: float, half_height: float,
    standing_mps: float, horizon_s: float,
) -> bool:  # fmt: skip
    """Whether a leg begun at `begin_s` keeps out of all cylinders."""
    dx, dy, dz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    if length < 1e-6:
        return True
    ux, uy, uz = dx / length * speed, dy / length * speed, dz / length * speed
    for k in range(pos.shape[0]):
        wx, wy, wz = vel[k, 0], vel[k, 1], vel[k, 2]
        stands = wx * wx + wy * wy < standing_mps * standing_mps
        if stands:
            wx = wy = wz = 0.0
        z = a[2] if math.isnan(pos[k, 2]) else pos[k, 2] + wz * begin_s
        at = entry_s(
            pos[k, 0] + wx * begin_s - a[0], pos[k, 1] + wy * begin_s - a[1], z - a[2], wx - ux, wy - uy, wz - uz,
            radius, half_height,
        )  # fmt: skip
        if at <= length / speed and (stands or begin_s + at <= horizon_s):
            return False
    return True


@compiled
def _dijkstra(  # noqa: PLR0917
    nodes: Floats, free: Floats, walls: WallIndex, near: Ints, pos: Floats, vel: Floats, speed: float, radius: float,
    half_height: float, standing_mps: float, horizon_s: float, left: Floats, came: Ints,
) -> bool:  # fmt: skip
    """Shortest way from node 0 to node 1, as `came` from; `left` (n,) is added to the cost of starting there."""
    count = nodes.shape[0]
    cost, length = np.full(count, math.inf), np.zeros(count)
    done = np.zeros(count, dtype=np.bool_)
    cost[0] = 0.0
    while True:
        here = -1
        for n in range(count):
            if not done[n] and cost[n] < math.inf and (here < 0 or cost[n] < cost[here]):
                here = n
        if here < 0:
            return False
        if here == 1:
            return True
        done[here] = True
        for n in range(count):
            if done[n] or free[n] <= 0.0:
                continue
            dx, dy, dz = nodes[n, 0] - nodes[here, 0], nodes[n, 1] - nodes[here, 1], nodes[n, 2] - nodes[here, 2]
            step = math.sqrt(dx * dx + dy * dy + dz * dz)
            total = cost[here] + step + (left[n] if here == 0 else 0.0)
            if total >= cost[n]:
                continue
            if not _open(
                nodes[here], nodes[n], length[here] / speed, pos, vel, speed, radius, half_height, standing_mps,
                horizon_s,
            ):  # fmt: skip
                continue
            margin = (0.8 if here == 0 else 0.98) * min(free[here], free[n])
            if is_leg_clear(
                walls, near, nodes[here, 0], nodes[here, 1], nodes[here, 2], nodes[n, 0], nodes[n, 1], nodes[n, 2],
                margin,
            ):  # fmt: skip
                cost[n], length[n], came[n] = total, length[here] + step, here


def find_first_waypoint(
    own: Own, anchor: Vector, tracks: Tracks, walls: WallIndex, limits: AvoidanceLimits, radius_m: float
) -> tuple[Vector | None, bool]:
    """Where to fly first on the way to the goal, and whether that is the goal itself or on its leg; None: no way.

    Beyond `AvoidanceLimits.reach_m` it is enough to come back to the leg from `anchor` to the goal.
    """
    here, z = np.array(own.pos_enu_m), own.pos_enu_m[2]
    nodes, on_leg = _places(own, anchor, tracks, limits, radius_m)
    near = find_buildings_nearby(walls, nodes, limits.reach_m if len(walls.box) else 0.0) if len(walls.box) else _NONE
    beside = near[(walls.box[near, 5] > z - limits.wall_m) & (walls.box[near, 4] < z + limits.wall_m)]
    if beside.size:
        nodes = np.vstack((nodes, _around(walls, beside, here, nodes[1], z, limits)))
    free = np.empty(len(nodes))
    for n, (east, north, up) in enumerate(nodes.tolist()):
        free[n] = clearance(walls, near, east, north, up, limits.wall_m) if near.size else limits.wall_m
    if free[0] <= 0.0:
        return None, False
    # the mission's own places may be near a wall; others have to keep their distance
    free[on_leg:][free[on_leg:] < limits.wall_m] = 0.0
    away = nodes[:, :2] - here[:2]
    free[2:][(away[2:, 0] * away[2:, 0]) + (away[2:, 1] * away[2:, 1]) <= (limits.arrive_m * limits.arrive_m)] = (
        0.0  # it is there already
    )
    course = nodes[1, :2] - here[:2]
    to_left = course[0] * away[:, 1] - course[1] * away[:, 0] > 1e-6 * max(float(np.abs(course).max()), 1.0)
    came = np.zeros(len(nodes), dtype=np.int64)
    reached = _dijkstra(
        nodes, free, walls, near, tracks.pos_enu_m, tracks.vel_enu_mps, own.cruise_mps, radius_m,
        limits.protected_up_m, limits.standing_mps, limits.look_ahead_s * limits.margin,
        np.where(to_left, radius_m, 0.0), came,
    )  # fmt: skip
    if not reached:
        return None, False
    step = 1
    while came[step] != 0:
        step = int(came[step])
    x, y, up = nodes[step].tolist()
    return (x, y, up), step == 1


_NONE = np.zeros(0, dtype=np.int64)


def _places(own: Own, anchor: Vector, tracks: Tracks, limits: AvoidanceLimits, radius_m: float) -> tuple[Floats, int]:
    """Oneself, the end, places on the mission's leg, the fan, the rings: (n, 3), and how many the first three are."""
    here, goal = np.array(own.pos_enu_m), np.array(own.goal_enu_m)
    begin = np.array(anchor)
    leg = goal - begin
    length = math.sqrt(leg[0] * leg[0] + leg[1] * leg[1] + leg[2] * leg[2])
    away = goal - here
    far = math.sqrt(away[0] * away[0] + away[1] * away[1]) > limits.reach_m
    along: list[Floats] = []
    last = length
    unit = leg / max(length, 1e-9)
    if length > _STEP_M:
        past = here - begin
        passed = float(past[0] * unit[0] + past[1] * unit[1] + past[2] * unit[2])
        last = passed + limits.reach_m if far else length
        while last < length and _taken(begin + unit * last, tracks, limits, radius_m):
            last += _STEP_M
        steps = np.arange(max(passed, 0.0) + _STEP_M, min(last, length), _STEP_M)
        along = [begin + unit * step for step in steps.tolist()]
    end = begin + unit * last if last < length else goal
    course = elementary.atan2(end[1] - here[1], end[0] - here[0])
    fan = []
    for degrees in _FAN_DEG:
        for side in (-1.0, 1.0):
            for reach in (1.5, 3.0):
                angle = course + side * math.radians(degrees)
                fan.append(
                    (
                        here[0] + reach * radius_m * elementary.cos(angle),
                        here[1] + reach * radius_m * elementary.sin(angle),
                    )
                )
    ring_m = radius_m * _ROOM / elementary.cos(math.pi / _SIDES)
    standing = []
    for (east, north, _), (vx, vy, _) in zip(tracks.pos_enu_m.tolist(), tracks.vel_enu_mps.tolist(), strict=True):
        away_m = elementary.hypot(east - here[0], north - here[1])
        if elementary.hypot(vx, vy) < limits.standing_mps:
            standing.append((away_m + elementary.hypot(end[0] - east, end[1] - north), east, north))
    for _, east, north in sorted(standing)[:_MAX_RINGS]:  # those nearest to the straight way
        for side in range(_SIDES):
            angle = course + (side + 0.5) * 2.0 * math.pi / _SIDES
            fan.append((east + ring_m * elementary.cos(angle), north + ring_m * elementary.sin(angle)))
    level = [(x, y, here[2]) for x, y in fan]
    return np.array([here, end, *along, *level]), 2 + len(along)


def _taken(place: Floats, tracks: Tracks, limits: AvoidanceLimits, radius_m: float) -> bool:
    """Whether somebody stands there."""
    for (east, north, up), (vx, vy, _) in zip(tracks.pos_enu_m.tolist(), tracks.vel_enu_mps.tolist(), strict=True):
        level = math.isnan(up) or abs(up - place[2]) < limits.protected_up_m
        close = elementary.hypot(east - place[0], north - place[1]) < radius_m * _ROOM
        if level and close and elementary.hypot(vx, vy) < limits.standing_mps:
            return True
    return False


def _around(walls: WallIndex, near: Ints, here: Floats, end: Floats, up_m: float, limits: AvoidanceLimits) -> Floats:
    """Corners to fly around, (n, 3): those that make the shortest detours, and at most so many."""
    room = np.empty((4096, 2))
    # a right angle leaves 0.7 of it to each wall: room enough for who is there but for `arrive_m`
    corner_points = room[: corners(walls, near, 1.75 * limits.wall_m, room)]
    detour = elementwise.hypot(*(corner_points - here[:2]).T) + elementwise.hypot(*(corner_points - end[:2]).T)
    kept = np.argsort(detour, kind="stable")[:_MAX_CORNERS]
    kept = kept[detour[kept] <= elementary.hypot(*(end[:2] - here[:2]).tolist()) + 2.0 * limits.reach_m]
    return np.column_stack((corner_points[kept], np.full(len(kept), up_m)))


class Geometric(EpisodicAvoidance):
    """`geometric`."""

    kind = "geometric"

    def needed(self, own: Own, tracks: Tracks) -> bool:
        """Not where the way straight to the goal is open: what conflicts then is a turn that is being flown."""
        place, direct = find_first_waypoint(
            own, own.pos_enu_m, tracks, self.walls, self.limits, self.limits.protected_m
        )
        return place is None or not direct

    def find_waypoint(self, now: Time, own: Own, tracks: Tracks, episode: Episode, radius_m: float) -> Vector | None:
        """The first place on the shortest way that is open."""
        return find_first_waypoint(own, episode.anchor_enu_m, tracks, self.walls, self.limits, radius_m)[0]

    def still_good(self, own: Own, tracks: Tracks, episode: Episode) -> bool:
        """Not reached, and nobody and nothing in between."""
        place = episode.waypoint_enu_m
        if (
            place is None
            or elementary_python.distance(place, own.pos_enu_m) <= self.limits.arrive_m
            or episode.stuck_ns is not None
        ):
            return False
        velocity, takes_s = velocity_towards(own.pos_enu_m, place, own.cruise_mps)
        within_s = min(takes_s, self.limits.look_ahead_s)
        conflicts = find_conflicts(own.pos_enu_m, velocity, tracks, self.limits, moving_s=within_s, standing_s=within_s)
        return not conflicts and is_straight_clear(self.walls, own.pos_enu_m, place, self.limits.wall_m)


GEOMETRIC = AvoidancePlugin(
    AvoidanceLimits,
    lambda limits, context: Geometric(context.city, limits),
    "Flies the shortest way to its goal that keeps clear of other aircraft and of walls.",
)
