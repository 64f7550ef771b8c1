"""Acts that agents choose from, and the choices of a step as parts of the range read them."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from typing import Final

from skyrange.core.time import NEVER, NS_PER_MS, Time

RED: Final = "red"
"""The agent of the red team, and the id of its attack in labels."""
ACT_DELAY_NS: Final = NS_PER_MS
"""How long after the beginning of a step frames of its acts are sent: all of the last step has happened by then."""


def blue_agent(operator: str) -> str:
    """The agent of an operator, and the id of its defence in events: `blue_green` of the operator `green`."""
    return f"blue_{operator}"


class RedAct(IntEnum):
    """What the adversary does to one aircraft during a step."""

    MODE = 0
    """Commands a flight mode, once a step, in the name of a MAVLink system of its own."""
    GNSS = 1
    """Lets the GNSS fixes drift from the truth, for as many steps in a row as it is chosen."""
    LINK = 2
    """Drops all frames of the control link."""


class BlueAct(IntEnum):
    """What an operator does about one of its aircraft at the beginning of a step."""

    NOTHING = 0
    RESUME = 1
    """Commands mode AUTO: the mission goes on from its current item."""
    RETURN = 2
    """Commands mode RTL."""
    BLOCK = 3
    """Has the companion drop frames of MAVLink systems other than the station's for some seconds."""


@dataclass(frozen=True, slots=True)
class Clock:
    """The steps of an episode, which begin at multiples of their length."""

    step_ns: Time

    def next_act(self, now: Time) -> Time:
        """The next time after `now` at which frames of acts are sent."""
        since = now - ACT_DELAY_NS
        return since - since % self.step_ns + self.step_ns + ACT_DELAY_NS


@dataclass(slots=True)
class RedChoice:
    """The adversary's choice of a step. Only the environment writes here, between two steps."""

    vehicle: str = ""
    """"" for none."""
    act: RedAct | None = None
    since_ns: Time = NEVER
    """Beginning of the first of the steps in a row with this choice."""

    def choose(self, now: Time, vehicle: str, act: RedAct | None) -> None:
        """Take a choice for the step that begins at `now`."""
        if (vehicle, act) != (self.vehicle, self.act):
            self.vehicle, self.act, self.since_ns = vehicle, act, now

    def is_of(self, vehicle: str, act: RedAct) -> bool:
        """Whether it is this act on this aircraft."""
        return self.act is act and self.vehicle == vehicle


@dataclass(slots=True)
class BlueChoices:
    """The choices of one operator. Only the environment writes here, between two steps."""

    acts: dict[str, BlueAct] = field(default_factory=dict)
    """By aircraft."""
    blocked_until_ns: dict[str, Time] = field(default_factory=dict)
    """By aircraft, the end of its last BLOCK."""

    def choose(self, now: Time, vehicle: str, act: BlueAct, block_ns: Time) -> None:
        """Take a choice for the step that begins at `now`."""
        self.acts[vehicle] = act
        if act is BlueAct.BLOCK:
            self.blocked_until_ns[vehicle] = now + block_ns

    def is_blocked(self, vehicle: str, now: Time) -> bool:
        """Whether frames of strange systems are dropped at `now`."""
        return now < self.blocked_until_ns.get(vehicle, 0)
