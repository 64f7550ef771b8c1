"""GNSS jump: all fixes have a constant offset from the truth; velocities stay true."""

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
    """All fixes have the same offset. The reported velocity stays true, because the offset does not change."""

    vehicles: Victims = Field(description="Aircraft whose GNSS fixes are falsified, such as ['blue/b1'].")
    offset_m: Offset = Field(
        description="Offset of the fixes from the truth, [east_m, north_m, up_m] in metres, each from -100000 to "
        "100000."
    )


@dataclass(frozen=True, slots=True)
class OffsetTrack:
    """A constant track at `offset_m`."""

    offset_m: Place

    def at(self, seconds: Floats) -> tuple[Floats, Floats, NDArray[np.int64]]:
        """See `false_fixes.Track`."""
        offsets = np.tile(np.array(self.offset_m, dtype=np.float64), (len(seconds), 1))
        return offsets, np.zeros_like(offsets), np.zeros(len(seconds), dtype=np.int64)


def make(params: Jump, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for aircraft that are not in the scenario."""
    return falsify_fixes(params.vehicles, OffsetTrack(params.offset_m), context)


JUMP = AttackPlugin(Jump, make, "Shifts GNSS fixes by a constant offset, from one fix to the next.")
