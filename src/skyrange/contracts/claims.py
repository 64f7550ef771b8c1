"""Claimed tracks: where an attack says that an aircraft is which does not exist."""

from __future__ import annotations

from dataclasses import dataclass

Vector = tuple[float, float, float]
"""East, north and up."""


@dataclass(frozen=True, slots=True)
class ClaimedTrack:
    """The track of one claimed aircraft, from the start of its attack until its stop, at a constant velocity."""

    radio: str
    """The endpoint whose `rid_up` link carries its broadcasts in the honest arm. A real aircraft carries this radio."""
    start_enu_m: Vector
    """Position at the start of the attack, in metres from the origin."""
    velocity_mps: Vector
    uas_id: str = ""
    """The UAS ID that it claims."""

    def at(self, seconds: float) -> Vector:
        """The position `seconds` after the start of the attack: the sum that its broadcasts contain, bit for bit."""
        (x, y, z), (u, v, w) = self.start_enu_m, self.velocity_mps
        return x + u * seconds, y + v * seconds, z + w * seconds
