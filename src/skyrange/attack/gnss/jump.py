"""GNSS jump: fixes are off by a constant distance from one fix to the next; velocities stay true."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Place
from skyrange.attack.gnss.false_fixes import Offset, Victims, falsify_fixes
from skyrange.contracts.components import Floats
from skyrange.contracts.params import Params


class Jump(Params):
    """Every fix is off by the same distance. The reported velocity is true, and fits: the false place stands still."""

    vehicles: Victims = Field(description="The aircraft whose GNSS receivers are deceived, such as ['blue/b1'].")
    offset_m: Offset = Field(
        description="How far the fixes are from the truth: [east_m, north_m, up_m] in metres, each up to 100 km."
    )


@dataclass(frozen=True, slots=True)
class OffsetTrack:
    """A track that stands at `offset_m`."""

    offset_m: Place

    def at(self, seconds: Floats) -> tuple[Floats, Floats, NDArray[np.int64]]:
        """See `false_fixes.Track`."""
        offsets = np.tile(np.array(self.offset_m, dtype=np.float64), (len(seconds), 1))
        return offsets, np.zeros_like(offsets), np.zeros(len(seconds), dtype=np.int64)


def make(params: Jump, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for aircraft that are not there."""
    return falsify_fixes(params.vehicles, OffsetTrack(params.offset_m), context)


JUMP = AttackPlugin(Jump, make, "GNSS fixes are off by a constant distance, from one fix to the next.")
