"""Injected MAVLink frames of a source: the taps that inject what it makes, in whose name and for whom."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import Field

from skyrange.attack.bases.mavlink_orders import NOBODY, STATION, Sender
from skyrange.attack.contract import AttackContext
from skyrange.attack.on_path import InjectingTap, InjectionSource, TapMaker, place_taps
from skyrange.attack.victims import Victims, check_vehicles
from skyrange.codec.mavlink import Packer
from skyrange.contracts.links import TapPlacement
from skyrange.contracts.params import Params, Whole
from skyrange.core.ids import link_name


class Injection(Params):
    """Where frames are injected, and in whose name."""

    vehicles: Victims = Field(description="Aircraft that the frames are for, such as ['blue/b1'].")
    on: Literal["gcs", "log", "autopilot"] = Field(
        default="gcs", description="Link on which the frames are injected: gcs, or log or autopilot on board."
    )
    sender: Literal["station", "own"] = Field(
        default="station",
        description="station: in the name of the operator's ground station, as its heartbeats tell it; own: in the "
        "name of system_id and component_id.",
    )
    system_id: Whole = Field(default=254, ge=1, le=255, description="System id of the sender 'own', 1 to 255.")
    component_id: Whole = Field(default=190, ge=1, le=255, description="Component id of the sender 'own', 1 to 255.")


@dataclass(frozen=True, slots=True)
class _Senders:
    """What makes the sender of each link."""

    targets: tuple[tuple[str, int], ...]
    own: tuple[int, int] | None

    def make(self, link: str) -> Sender:
        packer = Packer(*(self.own or STATION))
        return Sender(packer, dict(self.targets)[link], self.own is None)


def _make_tap(
    link: str, source: Callable[..., InjectionSource], senders: _Senders, arguments: tuple[Any, ...]
) -> InjectingTap:
    return InjectingTap(link, source(senders.make(link), *arguments))


def inject(
    params: Injection, context: AttackContext, source: Callable[..., InjectionSource], *arguments: Any
) -> list[TapPlacement]:
    """Taps that inject what `source(sender, *arguments)` makes, one for each aircraft.

    Arguments are immutable or meant to be shared, as the schedule is. Raises `InputError` for aircraft that are not in
    the scenario.
    """
    check_vehicles(context, params.vehicles)
    targets = {link_name(params.on, vehicle): vehicle for vehicle in params.vehicles}
    systems = tuple(
        (link, NOBODY if context.sham else context.vehicles[one].system_id) for link, one in targets.items()
    )
    own = (params.system_id, params.component_id) if params.sender == "own" else None
    return place_taps(list(targets), context, TapMaker(_make_tap, (source, _Senders(systems, own), arguments)))
