"""Measures of a study that its report compares."""

from __future__ import annotations

from typing import Final, NamedTuple


class Quantity(NamedTuple):
    """A measure of a run, or of the aircraft that is affected most."""

    name: str
    unit: str
    table: str
    about: str


MISSIONS: Final = "missions_complete"
QUANTITIES: Final = (
    Quantity("departure_m", "m", "effects", "largest distance of any aircraft from where it is in the baseline"),
    Quantity("extra_distance_m", "m", "effects", "largest additional way of any aircraft"),
    Quantity("delay_s", "s", "effects", "largest delay of any mission that is complete in both"),
    Quantity(MISSIONS, "", "runs", "aircraft whose mission is complete"),
    Quantity("collisions", "", "runs", "collisions with aircraft, once for both, and with buildings"),
    Quantity("near_misses", "", "runs", "times that two aircraft in the air came near each other"),
)
