"""Avoidance as plugins: own state, tracks and the episode under way → a decision.

An avoidance is a plain object: `decide` is a pure function, and what must outlive a call (an `Episode`) is handed in
and handed back. Kinds are plugins of `skyrange.avoidance`. Their parameters are `AvoidanceLimits`, or a subclass of it
with more.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from skyrange.contracts.params import Number, Params
from skyrange.contracts.plugins import AVOIDANCE, Plugin
from skyrange.core.time import NEVER, Time

if TYPE_CHECKING:
    from skyrange.city.city import City

Floats = NDArray[np.float64]
Vector = tuple[float, float, float]


class AvoidanceAction(StrEnum):
    """What an aircraft shall do now."""

    KEEP = "keep"
    """Nothing: fly the mission."""
    STOP = "stop"
    """Hold where it is."""
    GO = "go"
    """Fly to the decision's waypoint."""
    RESUME = "resume"
    """Go on with the mission: the episode is over."""
    RETURN = "return"
    """Go home: it has waited long enough."""


class AvoidanceLimits(Params):
    """The parameters of all kinds. Defaults suit a small multirotor at 10 m/s; none comes from a regulation.

    `docs/explanation/detect-and-avoid.md` says what they do to the separation that is held.
    """

    protected_m: Number = Field(
        default=20.0,
        gt=0,
        le=1000,
        description="Radius in metres of the upright cylinder around others that is kept out of.",
    )
    protected_up_m: Number = Field(
        default=12.0, gt=0, le=500, description="Half the height of that cylinder in metres."
    )
    look_ahead_s: Number = Field(
        default=12.0, gt=0, le=120, description="Seconds within which entering the cylinder is a conflict."
    )
    margin: Number = Field(
        default=1.25, ge=1, le=5, description="Times the cylinder's size that must be clear before the mission goes on."
    )
    clear_s: Number = Field(
        default=1.5,
        ge=0,
        le=60,
        description="Seconds for which the way must have been clear before the mission goes on.",
    )
    commit_s: Number = Field(
        default=1.0, ge=0, le=60, description="Seconds before which a waypoint is not exchanged for another."
    )
    standing_mps: Number = Field(
        default=1.0, ge=0, le=10,
        description="Speed in m/s below which another stands: it is expected to be there still, however late.",
    )  # fmt: skip
    patience_s: Number = Field(
        default=30.0, ge=0, le=3600, description="Seconds without a way after which the radius shrinks to least_m."
    )
    least_m: Number = Field(default=8.0, gt=0, le=1000, description="Radius in metres after patience_s without a way.")
    give_up_s: Number = Field(
        default=120.0, gt=0, le=3600, description="Seconds without a way after which it returns home."
    )
    longest_s: Number = Field(
        default=300.0, gt=0, le=36_000, description="Seconds of avoiding after which it returns home in any case."
    )
    wall_m: Number = Field(
        default=4.0, gt=0, le=15,
        description="Metres kept from walls and roofs, but for places of the mission that are nearer to them.",
    )  # fmt: skip
    reach_m: Number = Field(
        default=200.0, ge=20, le=2000, description="Metres around within which a way past others is looked for."
    )
    arrive_m: Number = Field(default=1.5, gt=0, le=50, description="Metres within which a waypoint counts as reached.")


class Own(NamedTuple):
    """What the aircraft believes of itself. `goal_enu_m` is where its mission takes it next."""

    pos_enu_m: Vector
    vel_enu_mps: Vector
    goal_enu_m: Vector
    cruise_mps: float


class Tracks(NamedTuple):
    """Whom it hears, k rows: positions as of now, at the heard velocity; unknown velocities are 0."""

    pos_enu_m: Floats
    """(k, 3); an unknown height is NaN and counts as one's own."""
    vel_enu_mps: Floats
    """(k, 3)."""


NO_TRACKS = Tracks(np.zeros((0, 3)), np.zeros((0, 3)))


@dataclass(frozen=True, slots=True)
class Episode:
    """What an avoidance under way remembers; begins with a conflict and ends with RESUME or RETURN."""

    begun_ns: Time
    anchor_enu_m: Vector
    """Where the aircraft left its mission's leg."""
    waypoint_enu_m: Vector | None = None
    changed_ns: Time = -NEVER
    """When the waypoint, or the lack of one, was chosen."""
    clear_ns: Time | None = None
    """Since when the way to the goal has been clear."""
    stuck_ns: Time | None = None
    """Since when there has been no way."""


class AvoidanceDecision(NamedTuple):
    """What to do; `tracks` are the rows that are in the way, `episode` is to be handed in next time."""

    action: AvoidanceAction
    episode: Episode | None
    waypoint_enu_m: Vector | None = None
    tracks: tuple[int, ...] = ()


KEEP = AvoidanceDecision(AvoidanceAction.KEEP, None)


class Avoidance(Protocol):
    """One kind of avoidance with its parameters; serves any number of aircraft. Deep-copyable."""

    limits: AvoidanceLimits

    def decide(self, now: Time, own: Own, tracks: Tracks, episode: Episode | None) -> AvoidanceDecision:
        """What to do now. Called several times a second while there is a conflict or an episode."""
        ...


@dataclass(frozen=True, slots=True)
class AvoidanceContext:
    """What the scenario tells an avoidance that it makes."""

    city: City | None = None
    """The buildings; None for open country."""


@dataclass(frozen=True, slots=True)
class AvoidancePlugin(Plugin[AvoidanceContext, Avoidance]):
    """A kind of avoidance."""

    group: ClassVar[str] = AVOIDANCE
