"""Parts of the adversary: a tap on each control link, and a fault of GNSS receivers, which do what was chosen."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from skyrange.attack.bases.mavlink.orders import mode_order
from skyrange.attack.gnss.drift import Drift
from skyrange.attack.tapped_links import STATION_SIDE, ends_of, side_of
from skyrange.codec.mavlink import Packer
from skyrange.contracts.components import SensorAct, Sensors
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import Act, TapPlacement
from skyrange.contracts.verdicts import Drop, Inject, Verdict
from skyrange.core.ids import link_name
from skyrange.core.time import NEVER, Time
from skyrange.env.acts import ACT_DELAY_NS, RED, Clock, RedAct, RedChoice
from skyrange.env.announcer import Announcer

SYSTEM: Final = (254, 190)
"""MAVLink system and component id in whose name the adversary commands."""
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
    """A fault of all GNSS receivers: the fixes of the chosen aircraft leave the truth at a constant rate."""

    name: str
    vehicles: Sequence[str]
    drift: Drift
    choice: RedChoice
    slow: bool = True
    labelled_ns: Time = NEVER
    """Start of the drift that was labelled last."""

    def on_sensors(self, now: Time, sensors: Sensors) -> Sequence[SensorAct]:
        """Shift the fixes that were measured since the choice; an act when that begins."""
        choice = self.choice
        if choice.act is not RedAct.GNSS:
            return ()
        row = self.vehicles.index(choice.vehicle)
        age_ns = int(sensors.gnss_time_ns[row]) - choice.since_ns
        if age_ns < 0 or sensors.gnss_fix[row] < _FIX_2D:
            return ()
        offsets, velocities, _ = self.drift.shift(np.array([age_ns * _NS]))
        sensors.gnss_enu_m[row] += offsets[0]
        sensors.gnss_vel_enu_mps[row] += velocities[0]
        if self.labelled_ns == choice.since_ns:
            return ()
        self.labelled_ns = choice.since_ns
        return [SensorAct(choice.vehicle, "gnss")]


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
    links = [link_name("gcs", one) for one in vehicles]
    taps = [TapPlacement(one, STATION_SIDE if one in over_air else side_of(one), make, RED) for one in links]
    fault = ChosenDrift(f"{RED}.gnss", vehicles, drift, choice)
    plan = Act(RED, agents=[Announcer(RED, choice, clock)], sensor_hooks=[fault], one_process=True, noted=False)
    return plan, taps
