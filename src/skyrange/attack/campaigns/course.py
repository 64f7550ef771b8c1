"""Course of a campaign: its stage, the acts that act, and the gates through which alone they act on the range.

The parts of an act run all the time, as those of every attack do, so that they observe and keep their state.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from itertools import combinations
from typing import Final

import numpy as np

from skyrange.attack.campaigns.adversary import Adversary, CampaignStage, Observation
from skyrange.contracts.alerts import Alert
from skyrange.contracts.components import Agent, SensorAct, SensorHook, Sensors, Tap
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import Schedule
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.contracts.scan_light import ScanHook, ScanLight, ScannerKind
from skyrange.contracts.verdicts import Verdict
from skyrange.core.errors import ComponentError, nearest
from skyrange.core.ids import Port
from skyrange.core.time import NEVER, Time

MAX_STAGES: Final = 1_000
"""Stages that a campaign may have, and through which an adversary may go at one time."""


@dataclass(slots=True)
class Course:
    """Asks the adversary for its stage, and starts and stops the acts."""

    campaign: str
    """The campaign's id."""
    adversary: Adversary
    schedule: Schedule
    """When the campaign acts."""
    acts: Mapping[str, Schedule]
    """When each act acts, as its parts read it."""
    longest_ns: Time = NEVER
    """After so long the campaign ends, whatever the adversary decides."""
    excluded: Mapping[tuple[str, str], str] = field(default_factory=dict)
    """What two acts would both alter, by the sorted names of the acts."""
    stage: CampaignStage | None = None
    over: bool = False
    """Whether the campaign has ended."""
    acting: frozenset[str] = frozenset()
    entered: list[str] = field(default_factory=list)
    """Stages entered since they were last noted; "end" for the end."""
    _stopped: set[str] = field(default_factory=set)

    def observe(self, now: Time, observation: Observation) -> None:
        """Hand an observation to the adversary."""
        self.adversary.observe(now, observation)

    def update(self, now: Time) -> None:
        """Go on to the stage that the adversary decides on, over any number of them.

        Raises `ComponentError` for an adversary that decides what no adversary may.
        """
        start = self.schedule.start_ns
        if self.over or now < start:
            return
        for _ in range(MAX_STAGES + 1):
            stage = None if now - start >= self.longest_ns else self.adversary.decide(now)
            if stage is None:
                self._enter("end", frozenset(), now)
                self.stage, self.over = None, True
                return
            if stage is self.stage:
                return
            acts = self._acts_of(stage)
            if self.stage is not None and stage.name == self.stage.name and acts == self.acting:
                return
            self._enter(stage.name, acts, now)
            self.stage = stage
        raise self._error(f"enters more than {MAX_STAGES} stages at one time")

    def acts_now(self, act: str) -> bool:
        """Whether an act acts in the current stage."""
        return act in self.acting

    def _enter(self, name: str, after: frozenset[str], now: Time) -> None:
        for act in self.acting - after:
            self.acts[act].stop_ns = now
            self._stopped.add(act)
        for act in after - self.acting:
            self.acts[act].start_ns, self.acts[act].stop_ns = now, self.schedule.stop_ns
        self.acting = after
        self.entered.append(name)

    def _acts_of(self, stage: object) -> frozenset[str]:
        """The acts of a stage. Raises `ComponentError` for one that cannot be entered."""
        if not isinstance(stage, CampaignStage):
            raise self._error(f"decided on {stage!r}, which is no CampaignStage and not None")
        acts = frozenset(stage.acts)
        for act in sorted(acts):
            if act not in self.acts:
                raise self._error(f"starts {act!r} in stage {stage.name!r}, which is no act", nearest(act, self.acts))
            if act in self._stopped:
                raise self._error(f"starts the act {act!r} again", "Declare it twice, under two names.")
        for pair in combinations(sorted(acts), 2):
            if pair in self.excluded:
                what = self.excluded[pair]
                raise self._error(f"has {pair[0]!r} and {pair[1]!r} act at once, which exclude each other: {what}")
        return acts

    def _error(self, problem: str, hint: str = "") -> ComponentError:
        return ComponentError(f"adversary of {self.campaign}", problem, hint)


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
        copies = Sensors(*(np.array(getattr(sensors, sensor_field.name)) for sensor_field in fields(Sensors)))
        self.inner.on_sensors(now, copies)
        return []


@dataclass(slots=True)
class GatedScanHook:
    """A scan hook that alters light while its act acts."""

    inner: ScanHook
    act: str
    course: Course
    name: str = field(init=False)
    vehicles: Sequence[str] = field(init=False)
    kinds: Sequence[ScannerKind] = field(init=False)
    sensor: str | None = field(init=False)

    def __post_init__(self) -> None:
        self.name, self.vehicles = self.inner.name, self.inner.vehicles
        self.kinds, self.sensor = self.inner.kinds, self.inner.sensor

    def on_scan(self, now: Time, light: ScanLight) -> bool:
        """Alter the light, or not."""
        return self.course.acts_now(self.act) and self.inner.on_scan(now, light)
