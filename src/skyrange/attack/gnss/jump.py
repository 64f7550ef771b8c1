"""GNSS jump: all fixes have a constant offset from the truth; velocities stay true."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, Place, ThreatModel
from skyrange.attack.gnss.false_fixes import Offset, falsify_fixes
from skyrange.attack.victims import Victims
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


JUMP = AttackPlugin(
    Jump,
    make,
    "Shifts GNSS fixes by a constant offset, from one fix to the next.",
    technique="EX-0014.04",
    counterfactual="mute",
    surface=("gnss",),
    persists="acts",
    effect="the estimator rejects fixes, then resets to the false position or fails safe",
    threat=ThreatModel(
        knowledge="the place of each victim, to align code and Doppler with the authentic signals",
        position="in sight of the victims' antennas",
        equipment="a GNSS simulator that follows each victim alone",
        budget="a signal some decibels above the authentic ones, for as long as it acts",
    ),
    controls=Controls(
        load="none, because a spoofed signal takes no airtime of the range's links",
        content="the sham: the same acts with unaltered fixes",
        placement="the same offset on another aircraft",
    ),
    realism={
        "position and velocity": "simulated: the truth with an offset",
        "fix type, satellites, claimed accuracy": "assumed: unaltered, a seamless capture",
    },
)
