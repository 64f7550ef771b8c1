"""Lost link: no frame arrives for as long as the fault acts."""

from __future__ import annotations

from skyrange.attack.link.drop import Dropper
from skyrange.attack.on_path import EVERY_LINK, TapMaker, place_taps
from skyrange.fault.contract import FaultContext, FaultParts, FaultPlugin
from skyrange.fault.links import Links, rule_for


class LostLink(Links):
    """The links are down from the start of the fault until it stops."""


def make(params: LostLink, context: FaultContext) -> FaultParts:
    """The parts. Raises `InputError` for links that the scenario does not have."""
    maker = TapMaker(Dropper, (rule_for(context, params.direction), 1.0))
    return FaultParts(taps=place_taps(params.links, context, maker))


LINK_OUTAGE = FaultPlugin(
    LostLink,
    make,
    "Takes links down for as long as it acts.",
    surface=EVERY_LINK,
    effect="the ends lose each other: failsafes for a lost link fire, and recover when it is back",
    cause="a modem without power, an unplugged cable, or an aircraft out of range",
    not_modelled="the time that a modem takes to register again: the link is back at once",
    realism={"the link": "assumed: every frame is lost while the fault acts, and none before or after"},
)
