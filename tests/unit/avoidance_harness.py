"""How are encounters flown without autopilots and radio? Points with limited acceleration, tracks at 1 Hz and late."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from skyrange.city.city import City
from skyrange.core.time import NS_PER_MS, NS_PER_S
from skyrange.vehicle.avoidance.contract import Avoidance, AvoidanceAction, Episode, Own, Tracks, Vector

STEP_NS = 50 * NS_PER_MS
LOOK_NS = 250 * NS_PER_MS
LATENCY_NS = 300 * NS_PER_MS
ACCEL_MPS2 = 2.5
"""ArduCopter's WPNAV_ACCEL."""


@dataclass
class Flyer:
    """One aircraft: flies to `goal` in a straight line, brakes for it, obeys its avoidance."""

    pos: Vector
    goal: Vector
    avoidance: Avoidance
    speed_mps: float = 10.0
    phase: float = 0.0
    """When within the second its broadcasts go out."""
    vel: Vector = (0.0, 0.0, 0.0)
    episode: Episode | None = None
    waypoint: Vector | None = None
    holds: bool = False
    home: bool = False
    log: list[tuple[float, str]] = field(default_factory=list)
    path: list[Vector] = field(default_factory=list)
    arrived_s: float | None = None

    def __post_init__(self) -> None:
        (x, y, z), (a, b, c) = self.pos, self.goal
        length = math.dist(self.pos, self.goal) or 1.0
        self.vel = tuple(self.speed_mps * part / length for part in (a - x, b - y, c - z))  # type: ignore[assignment]

    def look(self, now: int, tracks: Tracks) -> None:
        if self.home:
            return
        own = Own(self.pos, self.vel, self.goal, self.speed_mps)
        decision = self.avoidance.decide(now, own, tracks, self.episode)
        self.episode = decision.episode
        self.holds = decision.action is AvoidanceAction.STOP
        self.waypoint = decision.waypoint_enu_m if decision.action is AvoidanceAction.GO else None
        self.home = decision.action is AvoidanceAction.RETURN
        if not self.log or self.log[-1][1] != decision.action:
            self.log.append((now / NS_PER_S, str(decision.action)))

    def move(self, dt: float) -> None:
        target = self.pos if self.holds or self.home else self.waypoint or self.goal
        away = [b - a for a, b in zip(self.pos, target, strict=True)]
        length = math.sqrt(sum(part * part for part in away))
        # ArduCopter slows so that it can stop at a place: v² = 2·a·d
        speed = min(self.speed_mps, math.sqrt(2.0 * 0.8 * ACCEL_MPS2 * length))
        want = [part / length * speed if length > 1e-6 else 0.0 for part in away]
        change = [w - v for w, v in zip(want, self.vel, strict=True)]
        size = math.sqrt(sum(part * part for part in change))
        share = min(1.0, ACCEL_MPS2 * dt / size) if size > 0 else 0.0
        self.vel = tuple(v + share * c for v, c in zip(self.vel, change, strict=True))  # type: ignore[assignment]
        self.pos = tuple(p + v * dt for p, v in zip(self.pos, self.vel, strict=True))  # type: ignore[assignment]
        self.path.append(self.pos)


@dataclass
class Outcome:
    flyers: list[Flyer]
    least_m: float
    """Least horizontal distance between any two, at times when their heights differ by less than 5 m."""
    seconds: float

    def actions(self, row: int) -> list[str]:
        return [name for _, name in self.flyers[row].log]


def fly(
    flyers: list[Flyer],
    seconds: float,
    ghosts: Tracks | None = None,
    until_s: float | None = None,
    city: City | None = None,
) -> Outcome:
    """Fly until all have arrived. `ghosts` are heard by everyone (until `until_s`) and stand; walls are asserted."""
    heard: list[dict[int, tuple[int, Vector, Vector]]] = [{} for _ in flyers]
    post: list[tuple[int, int, Vector, Vector]] = []
    least = math.inf
    now = 0
    while now < seconds * NS_PER_S and not all(f.arrived_s is not None or f.home for f in flyers):
        for row, flyer in enumerate(flyers):
            if now % NS_PER_S == int(flyer.phase * NS_PER_S) // STEP_NS * STEP_NS:
                post.append((now, row, flyer.pos, flyer.vel))
        for sent, row, pos, vel in [letter for letter in post if letter[0] + LATENCY_NS <= now]:
            for other in range(len(flyers)):
                if other != row:
                    heard[other][row] = (sent, pos, vel)
        post = [letter for letter in post if letter[0] + LATENCY_NS > now]
        if now % LOOK_NS == 0:
            for row, flyer in enumerate(flyers):
                rows = sorted(heard[row].items())
                # the receiver knows when it heard, not when it was measured
                age = [(now - sent - LATENCY_NS) / NS_PER_S for _, (sent, _, _) in rows]
                told_vel: np.ndarray = np.array([vel for _, (_, _, vel) in rows]).reshape(-1, 3)
                told_pos: np.ndarray = np.array([pos for _, (_, pos, _) in rows]).reshape(-1, 3)
                told_pos = told_pos + told_vel * np.array(age).reshape(-1, 1)
                if ghosts is not None and (until_s is None or now < until_s * NS_PER_S):
                    told_pos = np.vstack((told_pos, ghosts.pos_enu_m))
                    told_vel = np.vstack((told_vel, ghosts.vel_enu_mps))
                flyer.look(now, Tracks(told_pos, told_vel))
        for flyer in flyers:
            flyer.move(STEP_NS / NS_PER_S)
            if city is not None:
                assert city.inside(*flyer.pos) is None, f"in a wall at {flyer.pos}, {now / NS_PER_S} s"
            if flyer.arrived_s is None and math.dist(flyer.pos, flyer.goal) < 2.0:
                flyer.arrived_s = now / NS_PER_S
        for row, one in enumerate(flyers):
            for two in flyers[:row]:
                if abs(one.pos[2] - two.pos[2]) < 5.0 and one.arrived_s is None and two.arrived_s is None:
                    least = min(least, math.dist(one.pos[:2], two.pos[:2]))
        now += STEP_NS
    return Outcome(flyers, least, now / NS_PER_S)
