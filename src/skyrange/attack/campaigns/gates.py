"""Gates between the acts of a campaign and the range: what an act puts out takes effect in its stages only.

The parts of an act run all the time, as those of every attack do, so that they observe and keep their state.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields

import numpy as np

from skyrange.attack.campaigns.course import Course
from skyrange.contracts.alerts import Alert
from skyrange.contracts.components import Agent, SensorAct, SensorHook, Sensors, Tap
from skyrange.contracts.frames import Frame
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.contracts.verdicts import Verdict
from skyrange.core.ids import Port
from skyrange.core.time import Time


@dataclass(slots=True)
class GatedTap:
    """A tap whose verdicts count while its act acts."""

    inner: Tap
    act: str
    course: Course

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """The verdicts of the act's tap, or none."""
        verdicts = self.inner.on_frame(now, frame)
        return verdicts if self.course.acts_now(self.act) else ()

    def next_wakeup(self) -> Time | None:
        """When the act's tap is to act."""
        return self.inner.next_wakeup()

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """What the act's tap injects, or nothing."""
        verdicts = self.inner.on_wakeup(now)
        return verdicts if self.course.acts_now(self.act) else ()


@dataclass(frozen=True, slots=True)
class GatedTapMaker:
    """Makes the gated tap of a link."""

    make: Callable[[str], Tap]
    act: str
    course: Course

    def __call__(self, link: str) -> GatedTap:
        """The tap of a link."""
        return GatedTap(self.make(link), self.act, self.course)


@dataclass(slots=True)
class GatedAgent:
    """An agent whose frames and notes count while its act acts."""

    inner: Agent
    act: str
    course: Course
    name: str = field(init=False)
    service_ns: Time = field(init=False)
    ports: Sequence[Port] = field(init=False)

    def __post_init__(self) -> None:
        self.name, self.service_ns, self.ports = self.inner.name, self.inner.service_ns, self.inner.ports

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        """Step the act's agent; what it sends, or nothing."""
        outbox = self.inner.step(now, inbox)
        return outbox if self.course.acts_now(self.act) else Outbox()

    def next_wakeup(self) -> Time | None:
        """When the act's agent is to be stepped."""
        return self.inner.next_wakeup()


@dataclass(slots=True)
class GatedHook:
    """A sensor fault that alters readings while its act acts, and copies of them else."""

    inner: SensorHook
    act: str
    course: Course
    name: str = field(init=False)
    vehicles: Sequence[str] = field(init=False)
    first: bool = field(init=False)

    def __post_init__(self) -> None:
        self.name, self.vehicles = self.inner.name, self.inner.vehicles
        self.first = getattr(self.inner, "first", False)

    def on_sensors(self, now: Time, sensors: Sensors) -> Sequence[SensorAct | Alert]:
        """Alter the readings or copies of them; the acts to be labelled."""
        if self.course.acts_now(self.act):
            return self.inner.on_sensors(now, sensors)
        copies = Sensors(*(np.array(getattr(sensors, one.name)) for one in fields(Sensors)))
        self.inner.on_sensors(now, copies)
        return []
