"""Bases of defences that judge the Remote ID broadcasts which protected aircraft receive."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from skyrange.attack.contract import Aircraft
from skyrange.attack.exclusive import Exclusive
from skyrange.attack.tapped_links import TapMaker
from skyrange.contracts.components import Tap
from skyrange.contracts.frames import Frame
from skyrange.contracts.links import TapPlacement
from skyrange.contracts.verdicts import Drop, Verdict
from skyrange.core.ids import link_name
from skyrange.core.time import Time
from skyrange.defence.contract import Defence, DefenceContext
from skyrange.defence.placement import Alarm, Protection, inspects_forward, inspects_none, place_taps
from skyrange.defence.receptions import Claim, Finding, OwnAircraft, OwnTap, Reader, Sender


@dataclass(frozen=True, slots=True)
class TapOf:
    """Makes the tap of a link: an instance that is there already, of one aircraft or station."""

    tap: Tap

    def __call__(self, link: str) -> Tap:
        """The tap."""
        return self.tap


class ReceptionTap(Protection):
    """Has a tap at the companion's end of each `rid_down` link, and one of `rid_data` from which it learns.

    Taps of one aircraft share state; they are at ends of its companion, which is in one process of a live range. Of
    each aircraft there is a copy of an instance.
    """

    needs: ClassVar[tuple[str, ...]] = ("on_frame",)
    decides: ClassVar[str] = ""
    """What it decides as the only one about an aircraft, such as "motion check"."""

    vehicle: str
    """The aircraft that receives."""
    own: OwnAircraft
    reader: Reader
    alarm: Alarm

    def build(self, context: DefenceContext) -> Defence:
        """Taps. Raises `InputError` for aircraft that are not in the scenario, and without a radio medium."""
        vehicles = self.find_protected(context)
        placed: list[TapPlacement] = []
        for vehicle in vehicles:
            tap, aircraft = self.copy(), context.vehicles[vehicle]
            tap.vehicle, tap.alarm = vehicle, Alarm(vehicle)
            tap.own, tap.reader = OwnAircraft(context.origin, aircraft.system_id), Reader(context.origin)
            tap.begin(aircraft)
            placed += place_taps("rid_down", "companion", [vehicle], context, TapOf(tap), inspects_forward)
            if link_name("rid_data", vehicle) in context.links:
                learns = TapMaker(OwnTap, (tap.own,))
                placed += place_taps("rid_data", "companion", [vehicle], context, learns, inspects_none)
            placed += tap.place_more(context)
        return Defence(taps=placed, exclusive=[Exclusive(f"{self.decides} of {vehicle}") for vehicle in vehicles])

    def begin(self, aircraft: Aircraft) -> None:
        """Set what depends on the aircraft; called once for each."""

    def place_more(self, context: DefenceContext) -> Sequence[TapPlacement]:
        """Further taps of one aircraft, from which it learns; called once for each."""
        return ()

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Decide on a frame of `rid_down`; those towards the companion are broadcasts."""
        raise NotImplementedError

    def next_wakeup(self) -> Time | None:
        """Never."""
        return None

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """Nothing."""
        return ()

    def refuse(self, now: Time, sender: Sender, finding: Finding) -> list[Verdict]:
        """Drop a broadcast and raise the alarm, if the finding has one."""
        if not finding.kind:
            return [Drop()]
        data = {"uas_id": sender.uas_id, "address": sender.address.hex(), **dict(finding.data)}
        return [Drop(), *self.alarm.raise_at(now, finding.kind, finding.score, **data)]


class BroadcastJudge(ReceptionTap):
    """Judges broadcasts by sender and Location. Malformed payloads pass: the companion refuses them."""

    needs: ClassVar[tuple[str, ...]] = ("judge",)

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Decide on a broadcast."""
        if frame.direction != "fwd":
            return ()
        read = self.reader.read(frame.payload)
        return () if read is None else self.judge(now, *read)

    def judge(self, now: Time, sender: Sender, claim: Claim | None) -> Sequence[Verdict]:
        """Take in a broadcast; a `Drop` among what it returns keeps it from the companion."""
        raise NotImplementedError
