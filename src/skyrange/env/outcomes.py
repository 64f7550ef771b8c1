"""True outcomes of an episode: progress of missions, mishaps and false reactions, and the rewards made of them."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Final

import numpy as np
import shapely
from numpy.typing import NDArray

from skyrange.contracts.alerts import Alert
from skyrange.contracts.components import World
from skyrange.contracts.frames import Frame, FrameBlock
from skyrange.contracts.mailboxes import Note
from skyrange.contracts.verdicts import Label
from skyrange.core.errors import InputError, Problem
from skyrange.core.time import NEVER, NS_PER_S, Time
from skyrange.gcs.plan.plans import FlightPlan
from skyrange.gcs.plan.routes import enu_points
from skyrange.metrics.paths import resampled

Floats = NDArray[np.float64]
CORRIDOR_M: Final = 5.0
"""Distance from its route within which an aircraft makes progress."""
ASTRAY_M: Final = 20.0
"""Horizontal distance from the convex hull of its route beyond which an aircraft in the air is astray: the straight way
home is within the hull."""
LANDED_OUT_M: Final = 5.0
"""Horizontal distance from its home and from the end of its route beyond which an aircraft has landed out."""
FASTEST_MPS: Final = 12.0
"""How far along its route an aircraft can come in a second."""
_EVENTS: Final = {"event.crash": "crash", "event.collision": "collision"}


@dataclass(frozen=True, slots=True)
class Rewards:
    """Weights of what the rewards consist of, each at least 0."""

    progress: float = 1.0
    """To the blue agent for a whole mission of one aircraft; in proportion for a part of it."""
    mishap: float = 1.0
    """From the blue agent for each mishap of an aircraft: the first crash, the first collision, the first time that it
    is astray, and a landing elsewhere."""
    false_reaction: float = 0.1
    """From the blue agent for each act about an aircraft that red has done nothing to within `aftermath_s`."""
    hostile_act: float = 0.01
    """From the red agent for each step in which it acts."""
    aftermath_s: float = 20.0
    """How long after the beginning of a hostile step a reaction to it is not false, in seconds."""

    def __post_init__(self) -> None:
        problems = [
            Problem(f"rewards.{setting.name}", repr(value), "a finite number, at least 0")
            for setting in fields(self)
            if isinstance(value := getattr(self, setting.name), bool)
            or not isinstance(value, (int, float))
            or not (math.isfinite(value) and value >= 0)
        ]
        if problems:
            raise InputError("rewards", problems)


@dataclass(slots=True)
class MissionProgress:
    """How far an aircraft has come along the route of its plan, by its true positions; it never goes back.

    It comes past each corner of the route in turn, within `CORRIDOR_M`. One that was away goes on where it meets the
    leg again that it had left.
    """

    route: Floats
    """(n, 3) points of the route at equal distances, metres from the origin."""
    corners: Sequence[int]
    """The points at which its legs begin and end, in order."""
    at: int = 0
    """The point that it has come to."""
    _hull: Any = field(init=False)
    """The horizontal convex hull of the route, a shape of shapely."""

    def __post_init__(self) -> None:
        self._hull = shapely.MultiPoint(self.route[:, :2]).convex_hull

    @classmethod
    def of(cls, plan: FlightPlan) -> MissionProgress:
        """At the start of a plan."""
        ends = np.array(enu_points(plan), dtype=np.float64)
        route = resampled(ends)
        lengths = np.concatenate([[0.0], np.cumsum(np.sqrt((np.diff(ends, axis=0) ** 2).sum(axis=1)))])
        shares = lengths / lengths[-1] if lengths[-1] > 0.0 else lengths
        return cls(route, [round(share * (len(route) - 1)) for share in shares.tolist()])

    @property
    def share(self) -> float:
        """The part of the route that is done, 0 to 1."""
        return self.at / max(len(self.route) - 1, 1)

    def advance(self, place: Floats, seconds: float, *, landed: bool = False) -> float:
        """Take in the position (3,) after `seconds`; the part of the route that was done meanwhile.

        An aircraft that has `landed` near the end of its route has done all of it.
        """
        before, last = self.share, len(self.route) - 1
        if self.at == last:
            return 0.0
        step_m = float(np.linalg.norm(self.route[1] - self.route[0]))
        corner = self.corners[bisect_right(self.corners, self.at)]
        until = max(self.at + math.ceil(FASTEST_MPS * seconds / step_m), corner)
        ahead = self.route[self.at : until + 1]
        away = np.sqrt(((ahead - place) ** 2).sum(axis=1))
        nearest = int(away.argmin())
        if away[nearest] <= CORRIDOR_M:
            self.at += nearest
        if landed and until >= last and (last - self.at) * step_m <= CORRIDOR_M and away[-1] <= CORRIDOR_M:
            self.at = last
        return self.share - before

    def distance_m(self, place: Floats) -> float:
        """Horizontal distance of a position (3,) from the convex hull of the route, 0 within."""
        return float(self._hull.distance(shapely.Point(place[:2])))

    def end_distance_m(self, place: Floats) -> float:
        """Horizontal distance of a position (3,) from the nearer one of both ends of the route."""
        ends = self.route[[0, -1], :2]
        return float(np.sqrt(((ends - place[:2]) ** 2).sum(axis=1)).min())


@dataclass(slots=True)
class Outcomes:
    """An observer of the truth: what has come of the missions of all aircraft."""

    rewards: Rewards
    progress: dict[str, MissionProgress] = field(default_factory=dict)
    """By aircraft."""
    mishaps: dict[str, list[str]] = field(default_factory=dict)
    """By aircraft, its kinds of mishaps in order."""
    hostile_ns: dict[str, Time] = field(default_factory=dict)
    """By aircraft, the beginning of the last step in which red acted on it."""
    truth_period_ns: Time = NEVER
    _new: list[str] = field(default_factory=list)
    _flown: set[str] = field(default_factory=set)
    _ended: set[str] = field(default_factory=set)

    def on_note(self, now: Time, source: str, note: Note) -> None:
        """Learn of crashes and collisions."""
        kind = _EVENTS.get(note.kind)
        vehicle = note.about.split(".", 1)[0]
        if kind is not None and vehicle in self.progress:
            self._add(vehicle, kind)

    def on_frame(self, frame: Frame) -> None:
        """Nothing."""

    def on_block(self, block: FrameBlock) -> None:
        """Nothing."""

    def on_label(self, label: Label) -> None:
        """Nothing."""

    def on_alert(self, now: Time, detector: str, alert: Alert) -> None:
        """Nothing."""

    def on_truth(self, now: Time, world: World) -> None:
        """Nothing: the end of a step is what counts."""

    def end_step(self, world: World, seconds: float) -> dict[str, float]:
        """Take in the truth at the end of a step that lasted `seconds`; the score of each aircraft in it.

        The score is that of progress and mishaps, positive for the blue team.
        """
        truth = world.truth()
        scores = {}
        for row, vehicle in enumerate(world.vehicles):
            if vehicle not in self.progress:
                continue
            place = np.array([truth[name][row] for name in ("east_m", "north_m", "up_m")])
            route = self.progress[vehicle]
            resting = bool(truth["on_ground"][row]) and float(truth["throttle"][row]) == 0.0
            crashed = bool(truth["crashed"][row])
            if crashed:
                self._ended.add(vehicle)
            elif not truth["on_ground"][row]:
                self._flown.add(vehicle)
                if route.distance_m(place) > ASTRAY_M:
                    self._add(vehicle, "astray")
            elif resting and vehicle in self._flown and vehicle not in self._ended:
                self._ended.add(vehicle)
                if route.end_distance_m(place) > LANDED_OUT_M:
                    self._add(vehicle, "landed out")
            gained = 0.0 if crashed else route.advance(place, seconds, landed=vehicle in self._ended)
            scores[vehicle] = self.rewards.progress * gained - self.rewards.mishap * self._new.count(vehicle)
        self._new.clear()
        return scores

    def count_false(self, now: Time, vehicles: Sequence[str]) -> int:
        """How many reactions about these aircraft in the step that begins at `now` are false."""
        aftermath_ns = self.rewards.aftermath_s * NS_PER_S
        return sum(now - self.hostile_ns.get(vehicle, -NEVER) > aftermath_ns for vehicle in vehicles)

    @property
    def over(self) -> bool:
        """Whether every aircraft has landed or crashed."""
        return len(self._ended) == len(self.progress)

    def _add(self, vehicle: str, kind: str) -> None:
        known = self.mishaps.setdefault(vehicle, [])
        if kind not in known:
            known.append(kind)
            self._new.append(vehicle)
