"""GNSS drift: the offset of fixes grows at a constant rate, with a consistent or an unaltered velocity."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, inf
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, Place, ThreatModel
from skyrange.attack.gnss.false_fixes import Rate, falsify_fixes
from skyrange.attack.victims import Victims
from skyrange.contracts.components import Floats
from skyrange.contracts.params import Number, Params, refuse
from skyrange.core.errors import Problem

GROWING, HELD, RETURNING, BACK = range(4)
"""Phases of a drift."""


class Drift(Params):
    """The offset of the fixes grows from zero at a constant rate."""

    vehicles: Victims = Field(description="Aircraft whose GNSS fixes are falsified, such as ['blue/b1'].")
    rate_mps: Rate = Field(
        description="Rate at which the fixes move away from the truth, [east, north, up] in m/s, each from -500 to 500."
    )
    velocity: Literal["consistent", "unaltered"] = Field(
        default="consistent",
        description="Velocity in the false fixes. consistent: that of the false track; unaltered: as measured.",
    )
    largest_m: Number | None = Field(
        default=None, gt=0, le=1_000_000, description="Largest distance from the truth in metres; default: no limit."
    )
    at_largest: Literal["hold", "return"] = Field(
        default="hold",
        description="What happens at largest_m. hold: the offset stays; return: it goes back to zero at the same rate.",
    )

    @model_validator(mode="after")
    def _returns_from_somewhere(self) -> Drift:
        if self.at_largest == "return" and self.largest_m is None:
            raise refuse(Problem("largest_m", "missing", "the distance from which at_largest = 'return' goes back"))
        return self


@dataclass(frozen=True, slots=True)
class DriftTrack:
    """A track along `rate_mps` up to `largest_m`, which then stays there or returns to the truth."""

    rate_mps: Place
    largest_m: float
    returns: bool
    tells_velocity: bool

    def at(self, seconds: Floats) -> tuple[Floats, Floats, NDArray[np.int64]]:
        """See `false_fixes.Track`."""
        rate = np.array(self.rate_mps, dtype=np.float64)
        speed = hypot(*self.rate_mps)
        turn_s = self.largest_m / speed if speed > 0.0 else inf
        phases = np.where(seconds < turn_s, GROWING, HELD)
        grown_s = np.minimum(seconds, turn_s)
        if self.returns:
            phases[seconds >= turn_s] = RETURNING
            phases[seconds >= 2.0 * turn_s] = BACK
            grown_s = np.maximum(np.minimum(seconds, 2.0 * turn_s - seconds), 0.0)
        sense = (phases == GROWING).astype(np.float64) - (phases == RETURNING)
        reported = sense if self.tells_velocity else np.zeros_like(sense)
        return grown_s[:, None] * rate, reported[:, None] * rate, phases.astype(np.int64)


def make(params: Drift, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for aircraft that are not in the scenario."""
    largest_m = inf if params.largest_m is None else params.largest_m
    track = DriftTrack(params.rate_mps, largest_m, params.at_largest == "return", params.velocity == "consistent")
    return falsify_fixes(params.vehicles, track, context)


DRIFT = AttackPlugin(
    Drift,
    make,
    "Makes GNSS fixes drift away from the truth at a constant rate.",
    technique="EX-0014.04",
    counterfactual="mute",
    surface=("gnss",),
    persists="acts",
    effect="the estimated position leaves the true one, and the autopilot flies the opposite way",
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
