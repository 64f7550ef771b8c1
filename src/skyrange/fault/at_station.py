"""Base of faults at ground stations: taps on the station's side of its links."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from skyrange.attack.bases.on_path import LinkTap
from skyrange.fault.contract import FaultContext, FaultParts

SIDE: Final = "gcs"
"""Frames to the station cross the channel before they pass the tap, and those from it afterwards."""


class AtStation(LinkTap):
    """Has a tap at the station on each of its links. A kind builds its parts with `place_at_station`."""

    def place_at_station(self, links: Sequence[str], context: FaultContext) -> FaultParts:
        """The taps. Raises `InputError` for a link that the scenario does not have."""
        return FaultParts(taps=[replace(tap, side=SIDE) for tap in self.make_taps(links, context)])
