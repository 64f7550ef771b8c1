"""Optimal reciprocal collision avoidance (van den Berg 2011): everybody who hears takes half of the way round.

J. van den Berg, S. Guy, M. Lin, D. Manocha, "Reciprocal n-body collision avoidance", Robotics Research (ISRR 2009),
by its authors' RVO2 library through pyrvo (an optional dependency), in the plane. The velocity it finds is
flown as a place a few seconds ahead. It presumes that others do the same: one that does not is kept from less well.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from skyrange.city.city import City
from skyrange.core import elementary
from skyrange.core.extras import missing_module
from skyrange.core.time import Time
from skyrange.vehicle.avoidance.conflicts import velocity_towards
from skyrange.vehicle.avoidance.contract import AvoidanceLimits, AvoidancePlugin, Episode, Own, Tracks, Vector
from skyrange.vehicle.avoidance.episodes import EpisodicAvoidance
from skyrange.vehicle.avoidance.wall_queries import find_buildings_nearby, is_straight_clear

AHEAD_S = 3.0
"""How far ahead the place lies that stands for the velocity."""
WALL_S = 4.0
"""The look-ahead for walls; as in RVO2's examples it is shorter than that for others."""
_MAX_NEIGHBOURS = 16
_STEP_S = 0.25


class Orca(EpisodicAvoidance):
    """`orca`. One simulator is made for each decision and thrown away, so that copies go on alike."""

    kind = "orca"

    def __init__(self, city: City | None = None, limits: AvoidanceLimits | None = None) -> None:
        """Raises `InputError` where pyrvo is not installed."""
        super().__init__(city, limits)
        _library()

    def find_waypoint(self, now: Time, own: Own, tracks: Tracks, episode: Episode, radius_m: float) -> Vector | None:
        """A few seconds along the velocity that ORCA chooses; None where it is none, or leads into a wall."""
        limits = self.limits
        sim = _library().RVOSimulator()
        x, y, z = own.pos_enu_m
        wanted = velocity_towards(own.pos_enu_m, own.goal_enu_m, own.cruise_mps)[0]
        most = max(own.cruise_mps, 1.0)
        half = 0.5 * radius_m
        reach = limits.look_ahead_s * 2.0 * most
        sim.set_time_step(_STEP_S)
        sim.set_agent_defaults(reach, _MAX_NEIGHBOURS, limits.look_ahead_s, WALL_S, half, most)
        self._build(sim, x, y, z)
        sim.add_agent((x, y))
        sim.set_agent_velocity(0, (own.vel_enu_mps[0], own.vel_enu_mps[1]))
        # a trace of a turn to the right breaks the symmetry of two who meet exactly head-on
        sim.set_agent_pref_velocity(0, (wanted[0] + 0.02 * wanted[1], wanted[1] - 0.02 * wanted[0]))
        beside = np.isnan(tracks.pos_enu_m[:, 2]) | (np.abs(tracks.pos_enu_m[:, 2] - z) < limits.protected_up_m)
        for row in np.flatnonzero(beside).tolist():
            (east, north, _), (ve, vn, _) = tracks.pos_enu_m[row].tolist(), tracks.vel_enu_mps[row].tolist()
            number = sim.add_agent((east, north))
            sim.set_agent_velocity(number, (ve, vn))
            sim.set_agent_pref_velocity(number, (ve, vn))
            sim.set_agent_radius(number, half)
        sim.do_step()
        velocity = sim.get_agent_velocity(0)
        if elementary.hypot(velocity.x, velocity.y) < 0.1:
            return None
        place = (x + AHEAD_S * velocity.x, y + AHEAD_S * velocity.y, z)
        return place if is_straight_clear(self.walls, own.pos_enu_m, place, limits.wall_m) else None

    def _build(self, sim: Any, x: float, y: float, z: float) -> None:
        """Tell the simulator of the walls around: each edge as a wall of its own, so that any ring's sense will do."""
        walls, limits = self.walls, self.limits
        if not len(walls.box):
            return
        for b in find_buildings_nearby(walls, np.array([(x, y, z)]), 3.0 * limits.protected_m).tolist():
            for x0, y0, x1, y1 in walls.edges[walls.edge_start[b] : walls.edge_start[b + 1]].tolist():
                sim.add_obstacle([(x0, y0), (x1, y1)])
        sim.process_obstacles()


ORCA = AvoidancePlugin(
    AvoidanceLimits,
    lambda limits, context: Orca(context.city, limits),
    "Flies the velocity of optimal reciprocal collision avoidance (ORCA); needs pyrvo.",
)


def _library() -> Any:
    try:
        import pyrvo
    except ImportError as error:
        raise missing_module("pyrvo", "orca", "avoidance orca") from error
    return pyrvo
