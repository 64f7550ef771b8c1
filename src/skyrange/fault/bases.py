"""Bases of faults that act on bodies, their motors or the air around them, and of faults at ground stations."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, ClassVar, Final

from skyrange.attack.bases.links import LinkTap
from skyrange.attack.bases.sensors import find_label
from skyrange.attack.declaration import Acting
from skyrange.attack.params import check_vehicles
from skyrange.contracts.components import BodyAct, Disturbances
from skyrange.contracts.plugins.form import state
from skyrange.core.time import Time
from skyrange.fault.contract import FaultContext, FaultParts


class OnBodies(Acting):
    """Acts on the bodies of its vehicles: `on_bodies` writes into arrays whose rows are these.

    One instance is the body fault. A kind has the parameter `vehicles`, or sets it in `prepare`.
    """

    needs: ClassVar[tuple[str, ...]] = ("on_bodies",)

    vehicles: Any
    """Their ids, in order."""
    name: str
    """The actor in labels."""
    label: str
    """What labels name: the first of the kind's surface."""
    met: set[int] = state(set)
    """Rows of the vehicles that it has acted on."""

    def build(self, context: FaultContext) -> FaultParts:
        """Itself as a body fault. Raises `InputError` for aircraft that are not in the scenario."""
        check_vehicles(context, self.vehicles)
        self.label = find_label(self)
        self.name = f"{self.id}.{self.label}"
        return FaultParts(body_hooks=[self])

    def on_bodies(self, now: Time, bodies: Disturbances) -> Sequence[BodyAct]:
        """Write into the bodies once it acts, and return the acts to be labelled: see `BodyHook`."""
        raise NotImplementedError

    def meet(self, rows: Iterable[int]) -> list[BodyAct]:
        """An act for each of these vehicles that it acts on for the first time."""
        new = [row for row in rows if row not in self.met]
        self.met.update(new)
        return [BodyAct(self.vehicles[row], self.label) for row in new]


SIDE: Final = "gcs"
"""Frames to the station cross the channel before they pass the tap, and those from it afterwards."""


class AtStation(LinkTap):
    """Has a tap at the station on each of its links. A kind builds its parts with `place_at_station`."""

    def place_at_station(self, links: Sequence[str], context: FaultContext) -> FaultParts:
        """The taps. Raises `InputError` for a link that the scenario does not have."""
        return FaultParts(taps=[replace(tap, side=SIDE) for tap in self.make_taps(links, context)])
