"""Avoidance as plugins: from own state, tracks and the current episode to a decision.

An avoidance is a plain object. `decide` is a pure function; the state that lasts between calls (an `Episode`) is an
argument and part of the result. Kinds are plugins of `skyrange.avoidance`. Their parameters are `AvoidanceLimits` or a
subclass.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from skyrange.contracts.params import Number, Params
from skyrange.contracts.plugins.registry import AVOIDANCE, Plugin
from skyrange.core.time import NEVER, Time

if TYPE_CHECKING:
    from skyrange.city.city import City

Floats = NDArray[np.float64]
Vector = tuple[float, float, float]


class AvoidanceAction(StrEnum):
    """What an aircraft does now."""

    KEEP = "keep"
    """Fly the mission."""
    STOP = "stop"
    """Hold the current position."""
    GO = "go"
    """Fly to the waypoint of the decision."""
    RESUME = "resume"
    """Continue the mission; the episode is over."""
    RETURN = "return"
    """Return home, because the episode has taken too long."""


class AvoidanceLimits(Params):
    """Parameters of all kinds. The defaults suit a small multirotor at 10 m/s; none comes from a regulation.

    `docs/explanation/detect-and-avoid.md` describes their effect on separation.
    """

    protected_m: Number = Field(
        default=20.0,
        gt=0,
        le=1000,
        description="Radius in metres of the protected cylinder around each other aircraft.",
    )
    protected_up_m: Number = Field(
        default=12.0, gt=0, le=500, description="Half the height of that cylinder, in metres."
    )
    look_ahead_s: Number = Field(
        default=12.0,
        gt=0,
        le=120,
        description="Look-ahead time in seconds: entering a cylinder within it is a conflict.",
    )
    margin: Number = Field(
        default=1.25,
        ge=1,
        le=5,
        description="Factor on the size of the cylinder that must be clear before the mission continues.",
    )
    clear_s: Number = Field(
        default=1.5,
        ge=0,
        le=60,
        description="Time in seconds for which the way must be clear before the mission continues.",
    )
    commit_s: Number = Field(
        default=1.0, ge=0, le=60, description="Least time in seconds for which a waypoint is kept."
    )
    standing_mps: Number = Field(
        default=1.0, ge=0, le=10,
        description="Speed in m/s below which another aircraft counts as standing and is expected to stay there.",
    )  # fmt: skip
    patience_s: Number = Field(
        default=30.0,
        ge=0,
        le=3600,
        description="Time in seconds without a way after which the radius shrinks to least_m.",
    )
    least_m: Number = Field(default=8.0, gt=0, le=1000, description="Radius in metres after patience_s without a way.")
    give_up_s: Number = Field(
        default=120.0, gt=0, le=3600, description="Time in seconds without a way after which the aircraft returns home."
    )
    longest_s: Number = Field(
        default=300.0,
        gt=0,
        le=36_000,
        description="Duration of avoidance in seconds after which the aircraft returns home in any case.",
    )
    wall_m: Number = Field(
        default=4.0, gt=0, le=15,
        description="Distance from walls and roofs in metres, unless the mission itself goes nearer.",
    )  # fmt: skip
    reach_m: Number = Field(
        default=200.0, ge=20, le=2000, description="Radius in metres of the search for a way around other aircraft."
    )
    arrive_m: Number = Field(
        default=1.5, gt=0, le=50, description="Distance in metres at which a waypoint counts as reached."
    )


class Own(NamedTuple):
    """The aircraft's estimate of its own state. `goal_enu_m` is the next point of its mission."""

    pos_enu_m: Vector
    vel_enu_mps: Vector
    goal_enu_m: Vector
    cruise_mps: float


class Tracks(NamedTuple):
    """The k aircraft that it receives: current positions, extrapolated, and velocities; unknown velocities are 0."""

    pos_enu_m: Floats
    """(k, 3); an unknown height is NaN and counts as the own height."""
    vel_enu_mps: Floats
    """(k, 3)."""


NO_TRACKS = Tracks(np.zeros((0, 3)), np.zeros((0, 3)))


@dataclass(frozen=True, slots=True)
class Episode:
    """State of a current avoidance. An episode begins with a conflict and ends with RESUME or RETURN."""

    begun_ns: Time
    anchor_enu_m: Vector
    """Where the aircraft left the leg of its mission."""
    waypoint_enu_m: Vector | None = None
    changed_ns: Time = -NEVER
    """When the waypoint, or to have none, was chosen."""
    clear_ns: Time | None = None
    """Since when the way to the goal has been clear."""
    stuck_ns: Time | None = None
    """Since when there has been no way."""


class AvoidanceDecision(NamedTuple):
    """What to do. `tracks` are the rows in conflict; `episode` is the argument of the next call."""

    action: AvoidanceAction
    episode: Episode | None
    waypoint_enu_m: Vector | None = None
    tracks: tuple[int, ...] = ()
    considered: tuple[int, ...] = ()
    """Rows that are not in conflict but shaped the decision, such as tracks around which a waypoint was chosen."""


KEEP = AvoidanceDecision(AvoidanceAction.KEEP, None)


class Avoidance(Protocol):
    """One kind of avoidance with its parameters, for any number of aircraft. It can be deep-copied."""

    limits: AvoidanceLimits

    def decide(self, now: Time, own: Own, tracks: Tracks, episode: Episode | None) -> AvoidanceDecision:
        """What to do now. It is called several times a second during a conflict or an episode."""
        ...


@dataclass(frozen=True, slots=True)
class AvoidanceContext:
    """The context of an avoidance: data of the scenario."""

    city: City | None = None
    """The buildings; None without buildings."""


@dataclass(frozen=True, slots=True)
class AvoidancePlugin(Plugin[AvoidanceContext, Avoidance]):
    """A kind of avoidance."""

    group: ClassVar[str] = AVOIDANCE
