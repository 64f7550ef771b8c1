"""Parts of both teams: commands at a ground station, a filter at companions, taps and a GNSS fault of the adversary."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.attack.bases.mavlink.orders import STATION, mode_order
from skyrange.attack.gnss.drift import Drift
from skyrange.attack.tapped_links import STATION_SIDE, ends_of, side_of
from skyrange.codec.mavlink import Packer, sender_system
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.flight_modes import COPTER_MODE_NUMBERS
from skyrange.contracts.components import SensorAct, Sensors
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import Act, TapPlacement
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.contracts.verdicts import Drop, Inject, Verdict
from skyrange.core.ids import Port, link_name
from skyrange.core.time import NEVER, NS_PER_MS, Time
from skyrange.defence.placement import DefenceTap
from skyrange.env.acts import ACT_DELAY_NS, RED, BlueAct, BlueChoices, Clock, RedAct, RedChoice


@dataclass(slots=True)
class Announcer:
    """Notes each choice but "nothing", when its step begins, so that the record of an episode has all."""

    name: str
    choices: RedChoice | BlueChoices
    clock: Clock
    ports: Sequence[Port] = ()
    service_ns: Time = NS_PER_MS
    due: Time = ACT_DELAY_NS

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        """Note the choices of the step that has begun."""
        out, choices = Outbox(), self.choices
        self.due = self.clock.next_act(now)
        if isinstance(choices, RedChoice):
            if choices.act is not None:
                out.note("event.red_action", choices.vehicle, {"action": choices.act.name.lower()})
            return out
        for vehicle, act in choices.acts.items():
            if act is not BlueAct.NOTHING:
                out.note("event.blue_action", vehicle, {"action": act.name.lower()})
        return out

    def next_wakeup(self) -> Time | None:
        """The beginning of the next step."""
        return self.due


STATION_SYSTEM: Final = STATION[0]
CONSOLE: Final = (STATION_SYSTEM, int(mav.MAV_COMP_ID_USER2))
"""MAVLink system and component id of the commands: a component of its own in the station's system, so that the sequence
numbers of the station's frames stay what they are."""
_MODES: Final = {BlueAct.RESUME: COPTER_MODE_NUMBERS["AUTO"], BlueAct.RETURN: COPTER_MODE_NUMBERS["RTL"]}


@dataclass(slots=True)
class CommandConsole:
    """A program beside the ground station that commands modes; its frames cross the whole control link."""

    link: str
    vehicle: str
    system: int
    choices: BlueChoices
    clock: Clock
    packer: Packer
    due: Time = ACT_DELAY_NS

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Let it pass."""
        return ()

    def next_wakeup(self) -> Time | None:
        """The beginning of the next step."""
        return self.due

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """Inject the command of this step, if one was chosen."""
        self.due = self.clock.next_act(now)
        mode = _MODES.get(self.choices.acts.get(self.vehicle, BlueAct.NOTHING))
        if mode is None:
            return ()
        payload = self.packer.pack(mode_order(mode).message(self.system))
        return [Inject(payload, "fwd", *ends_of(self.link, "fwd"))]


@dataclass(slots=True)
class SourceFilter(DefenceTap):
    """Drops frames towards the aircraft of MAVLink systems other than the station's while they are blocked."""

    vehicle: str
    choices: BlueChoices

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Decide on a frame."""
        if frame.direction != "fwd" or not self.choices.is_blocked(self.vehicle, now):
            return ()
        return () if sender_system(frame.payload) == STATION_SYSTEM else (Drop(),)


@dataclass(frozen=True, slots=True)
class _BlueTaps:
    systems: Mapping[str, int]
    choices: BlueChoices
    clock: Clock

    def make_console(self, link: str) -> CommandConsole:
        vehicle = link.partition(":")[2]
        return CommandConsole(link, vehicle, self.systems[vehicle], self.choices, self.clock, Packer(*CONSOLE))

    def make_filter(self, link: str) -> SourceFilter:
        return SourceFilter(link, link.partition(":")[2], self.choices)


def make_blue_team(
    agent: str, systems: Mapping[str, int], choices: BlueChoices, clock: Clock
) -> tuple[Act, list[TapPlacement]]:
    """An operator's defence and its taps; `systems` are the MAVLink system ids of its aircraft."""
    made = _BlueTaps(systems, choices, clock)
    taps = []
    for link in (link_name("gcs", vehicle) for vehicle in systems):
        taps.append(TapPlacement(link, "gcs", made.make_console, agent))
        taps.append(TapPlacement(link, "companion", made.make_filter, agent))
    plan = Act(agent, agents=[Announcer(agent, choices, clock)], one_process=True, noted=False, role="defence")
    return plan, taps


SYSTEM: Final = (254, 190)
"""MAVLink system and component id in whose name the adversary commands."""
Floats = NDArray[np.float64]
_FIX_2D: Final = 2  # MAVLink GPS_FIX_TYPE: the lowest one with a position
_NS: Final = 1e-9


@dataclass(slots=True)
class AdversaryTap:
    """A router on the way of a control link: it injects commands, and drops frames."""

    link: str
    vehicle: str
    system: int
    mode: int
    choice: RedChoice
    clock: Clock
    packer: Packer
    due: Time = ACT_DELAY_NS

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Drop the frame while the link is to be dropped."""
        return (Drop(),) if self.choice.is_of(self.vehicle, RedAct.LINK) else ()

    def next_wakeup(self) -> Time | None:
        """The beginning of the next step."""
        return self.due

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """Inject the command of this step, if it was chosen."""
        self.due = self.clock.next_act(now)
        if not self.choice.is_of(self.vehicle, RedAct.MODE):
            return ()
        payload = self.packer.pack(mode_order(self.mode).message(self.system))
        return [Inject(payload, "fwd", *ends_of(self.link, "fwd"))]


@dataclass(frozen=True, slots=True)
class _AdversaryTaps:
    systems: Mapping[str, int]
    mode: int
    choice: RedChoice
    clock: Clock

    def make(self, link: str) -> AdversaryTap:
        vehicle = link.partition(":")[2]
        return AdversaryTap(link, vehicle, self.systems[vehicle], self.mode, self.choice, self.clock, Packer(*SYSTEM))


@dataclass(slots=True)
class ChosenDrift:
    """A fault of all GNSS receivers: the fixes of the chosen aircraft leave the truth at a constant rate.

    A fix that has been shifted stays so until the next one.
    """

    name: str
    vehicles: Sequence[str]
    drift: Drift
    choice: RedChoice
    slow: bool = True
    per_fix: bool = True
    labelled_ns: Time = NEVER
    """Start of the drift that was labelled last."""
    _shifted: dict[int, tuple[Time, Floats, Floats]] = field(default_factory=dict, init=False)
    """By row: when the last shifted fix was measured, and by how much its position and velocity are off."""

    def on_sensors(self, now: Time, sensors: Sensors) -> Sequence[SensorAct]:
        """Shift the fixes that were measured since the choice; an act when that begins."""
        choice = self.choice
        acts: Sequence[SensorAct] = ()
        if choice.act is RedAct.GNSS:
            row = self.vehicles.index(choice.vehicle)
            measured = int(sensors.gnss_time_ns[row])
            age_ns = measured - choice.since_ns
            if age_ns >= 0 and sensors.gnss_fix[row] >= _FIX_2D:
                if row not in self._shifted or self._shifted[row][0] != measured:
                    offsets, velocities, _ = self.drift.shift(np.array([age_ns * _NS]))
                    self._shifted[row] = measured, offsets[0], velocities[0]
                if self.labelled_ns != choice.since_ns:
                    self.labelled_ns = choice.since_ns
                    acts = [SensorAct(choice.vehicle, "gnss")]
        for row, (measured, offset, velocity) in self._shifted.items():
            if sensors.gnss_time_ns[row] == measured:
                sensors.gnss_enu_m[row] += offset
                sensors.gnss_vel_enu_mps[row] += velocity
        return acts


def make_red_team(
    systems: Mapping[str, int],
    choice: RedChoice,
    clock: Clock,
    *,
    mode: int,
    drift: Drift,
    over_air: Container[str] = (),
) -> tuple[Act, list[TapPlacement]]:
    """The adversary's attack and its taps; `systems` are the MAVLink system ids of all aircraft.

    On the links `over_air` it is in the operator's network, as attacks are by default.
    """
    vehicles = sorted(systems)
    make = _AdversaryTaps(systems, mode, choice, clock).make
    links = [link_name("gcs", vehicle) for vehicle in vehicles]
    taps = [TapPlacement(link, STATION_SIDE if link in over_air else side_of(link), make, RED) for link in links]
    fault = ChosenDrift(f"{RED}.gnss", vehicles, drift, choice)
    plan = Act(RED, agents=[Announcer(RED, choice, clock)], sensor_hooks=[fault], one_process=True, noted=False)
    return plan, taps
