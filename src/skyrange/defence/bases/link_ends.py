"""Bases of defences that have a tap at one end of the links of protected aircraft."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, Final, Literal

from skyrange.attack.bases.mavlink.orders import read
from skyrange.attack.contract import Aircraft
from skyrange.attack.exclusive import Exclusive
from skyrange.attack.tapped_links import ends_of
from skyrange.codec.mavlink import Message, Packer
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import TapPlacement
from skyrange.contracts.verdicts import Inject, Verdict
from skyrange.core.time import Time
from skyrange.defence.contract import Defence, DefenceContext
from skyrange.defence.path_rules import PathEnd, PathRule, ends_at
from skyrange.defence.placement import Alarm, Protection, find_links

STATION: Final = 255
"""System id of a ground station by convention, in whose network a defence at its end stands."""
AUTOPILOT: Final = int(mav.MAV_COMP_ID_AUTOPILOT1)
Inspects = Callable[[Frame], bool]


@dataclass(frozen=True, slots=True)
class CopyForEnd:
    """Makes the tap at an end of a link: a copy of an instance."""

    prototype: EndTap
    side: str
    vehicle: str
    aircraft: Aircraft

    def __call__(self, link: str) -> EndTap:
        """The tap of a link."""
        made = self.prototype.copy()
        made.link, made.side, made.vehicle, made.system = link, self.side, self.vehicle, self.aircraft.system_id
        made.alarm = Alarm(self.vehicle)
        made.begin(self.aircraft)
        return made


class EndTap(Protection):
    """Has a tap at one end of the link of each aircraft, a copy of its own: what passes is shown to `on_frame`.

    A kind may define a static method `inspects`, which says for which frames it needs its endpoint's processor; without
    it that is for all.
    """

    needs: ClassVar[tuple[str, ...]] = ("on_frame",)
    decides: ClassVar[str] = ""
    """What it decides as the only one about an aircraft, such as "sequence check"."""

    link: str
    """Of a tap: the name of its link."""
    side: str
    """The end of the link."""
    vehicle: str
    """The aircraft whose link it is."""
    system: int
    """MAVLink system id of the aircraft."""
    alarm: Alarm
    armed: bool = False
    """Whether the aircraft is armed, as far as `learn_armed` was told."""

    def find_end(self) -> tuple[str, str]:
        """Role of the links, and the end of them at which it is: by default the companion's end of gcs links."""
        return "gcs", "companion"

    def build(self, context: DefenceContext) -> Defence:
        """Taps. Raises `InputError` for aircraft that are not in the scenario, or that have no such link."""
        vehicles = self.find_protected(context)
        role, side = self.find_end()
        return Defence(
            taps=self.place(role, side, vehicles, context),
            exclusive=[exclusive for vehicle in vehicles for exclusive in self.find_exclusive(vehicle)],
            path_rules=[rule for end in ends_at(role, side, vehicles) for rule in self.find_rules(end)],
        )

    def place(self, role: str, side: str, vehicles: Sequence[str], context: DefenceContext) -> list[TapPlacement]:
        """A tap at the `side` end of the link of this role of each aircraft.

        Raises `InputError` where none of the aircraft has such a link.
        """
        inspects: Inspects | None = getattr(type(self), "inspects", None)
        return [
            TapPlacement(link, side, CopyForEnd(self, side, vehicle, context.vehicles[vehicle]), inspects=inspects)
            for link, vehicle in find_links(role, vehicles, context).items()
        ]

    def find_exclusive(self, vehicle: str) -> list[Exclusive]:
        """What it decides as the only one about an aircraft."""
        return [Exclusive(f"{self.decides} of {vehicle}")]

    def find_rules(self, end: PathEnd) -> Sequence[PathRule]:
        """What it does on the way between station and autopilot, at one end."""
        return ()

    def begin(self, aircraft: Aircraft) -> None:
        """Set what depends on the aircraft; called once for each tap."""

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Decide on a frame that passes, in either direction."""
        raise NotImplementedError

    def next_wakeup(self) -> Time | None:
        """When it acts without a frame: never, unless a kind does."""
        return None

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """What it does without a frame."""
        return ()

    def learn_armed(self, payload: bytes) -> None:
        """Take in a heartbeat of the aircraft's autopilot."""
        message = read(payload)
        if message is not None and message.autopilot != mav.MAV_AUTOPILOT_INVALID:
            self.armed = bool(message.base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED)


class SpeakingTap(EndTap):
    """Sends MAVLink messages to the autopilot, as a component of its own in the station's system."""

    component: ClassVar[int] = 0
    """Its component id: answers to it are distinct from those to the station."""

    packer: Packer

    def begin(self, aircraft: Aircraft) -> None:
        """See `EndTap`."""
        self.packer = Packer(STATION, self.component)

    def say(self, message: Message) -> Inject:
        """Put a message on the link, towards the aircraft."""
        return Inject(self.packer.pack(message), "fwd", *ends_of(self.link, "fwd"))

    def command(self, command: int, *params: float) -> Inject:
        """Put a COMMAND_LONG on the link; parameters that are not given are 0."""
        values = [*map(float, params), *([0.0] * (7 - len(params)))]
        return self.say(mav.MAVLink_command_long_message(self.system, AUTOPILOT, command, 0, *values))


def role_of(at: Literal["companion", "proxy"]) -> str:
    """The role of the link at whose lower end a defence is: on the companion computer or before the autopilot."""
    return "gcs" if at == "companion" else "autopilot"
