"""Parts of an operator's defence: commands at the ground station, and a filter at the companions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from skyrange.attack.bases.mavlink.orders import STATION, mode_order
from skyrange.attack.tapped_links import ends_of
from skyrange.codec.mavlink import Packer, sender_system
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.flight_modes import COPTER_MODE_NUMBERS
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import Act, TapPlacement
from skyrange.contracts.verdicts import Drop, Inject, Verdict
from skyrange.core.ids import link_name
from skyrange.core.time import Time
from skyrange.defence.placement import DefenceTap
from skyrange.env.acts import ACT_DELAY_NS, BlueAct, BlueChoices, Clock
from skyrange.env.announcer import Announcer

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
