"""What is asked of an avoidance, and what does it answer? Own state, tracks and what goes on → a decision.

An avoidance is a plain object: `decide` is a pure function, and what must outlive a call (an `Episode`) is handed in
and handed back. Kinds are plugins of `skyrange.avoidance`, made by `factory(city, **settings)`.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from skyrange.core.time import NEVER, Time

Floats = NDArray[np.float64]
Vector = tuple[float, float, float]


class Action(StrEnum):
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


@dataclass(frozen=True, slots=True)
class Limits:
    """The parameters of all kinds. Defaults suit a small multirotor at 10 m/s; none comes from a regulation.

    `docs/explanation/detect-and-avoid.md` says what each does to the separation that is held.
    """

    protected_m: float = 20.0
    """Radius of the upright cylinder around another aircraft that is kept out of."""
    protected_up_m: float = 12.0
    """Half its height."""
    look_ahead_s: float = 12.0
    """A conflict is an entry into the cylinder within so long, both flying straight on."""
    margin: float = 1.25
    """To go on with the mission, the cylinder and the look-ahead must be clear at this many times their size."""
    clear_s: float = 1.5
    """The way must have been clear for so long before the mission is resumed."""
    commit_s: float = 1.0
    """A waypoint is not exchanged for another one sooner."""
    standing_mps: float = 1.0
    """What moves slower stands: it is expected to be there still when one comes by, however late."""
    patience_s: float = 30.0
    """After so long without a way the radius shrinks to `least_m`."""
    least_m: float = 8.0
    give_up_s: float = 120.0
    """After so long without a way the aircraft returns home."""
    longest_s: float = 300.0
    """So does one that has been avoiding for so long."""
    wall_m: float = 4.0
    """Kept from walls and roofs, but for places that are nearer to them from the start."""
    reach_m: float = 200.0
    """How far around a way past others is looked for."""
    arrive_m: float = 3.0
    """A waypoint counts as reached within."""


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


class Decision(NamedTuple):
    """What to do; `tracks` are the rows that are in the way, `episode` is to be handed in next time."""

    action: Action
    episode: Episode | None
    waypoint_enu_m: Vector | None = None
    tracks: tuple[int, ...] = ()


KEEP = Decision(Action.KEEP, None)


class Avoidance(Protocol):
    """One kind of avoidance with its parameters; serves any number of aircraft. Deep-copyable."""

    limits: Limits

    def decide(self, now: Time, own: Own, tracks: Tracks, episode: Episode | None) -> Decision:
        """What to do now. Called several times a second while there is a conflict or an episode."""
        ...
