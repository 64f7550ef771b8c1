"""GNSS drift: fixes slide away at a constant rate, with or without the velocity that fits."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, inf
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Place
from skyrange.attack.gnss.false_fixes import Rate, Victims, falsify_fixes
from skyrange.contracts.components import Floats
from skyrange.contracts.params import Number, Params, refuse
from skyrange.core.errors import Problem

GROWING, HELD, RETURNING, BACK = range(4)
"""Phases of a drift."""


class Drift(Params):
    """Every fix is off by more than the one before; the first one is still true."""

    vehicles: Victims = Field(description="The aircraft whose GNSS receivers are deceived, such as ['blue/b1'].")
    rate_mps: Rate = Field(
        description="How fast the fixes move away from the truth: [east, north, up] in m/s, each up to 500."
    )
    velocity: Literal["consistent", "unaltered"] = Field(
        default="consistent",
        description="Reported velocity. consistent: that of the false track; unaltered: as it was measured.",
    )
    largest_m: Number | None = Field(
        default=None, gt=0, le=1_000_000, description="Largest distance from the truth in metres; default: none."
    )
    at_largest: Literal["hold", "return"] = Field(
        default="hold",
        description="What the drift does there. hold: stay; return: go back to the truth at the same rate.",
    )

    @model_validator(mode="after")
    def _returns_from_somewhere(self) -> Drift:
        if self.at_largest == "return" and self.largest_m is None:
            raise refuse(Problem("largest_m", "missing", "the distance from which at_largest = 'return' goes back"))
        return self


@dataclass(frozen=True, slots=True)
class DriftTrack:
    """A track along `rate_mps`: out, and beyond `largest_m` held there or back to the truth."""

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
        told = sense if self.tells_velocity else np.zeros_like(sense)
        return grown_s[:, None] * rate, told[:, None] * rate, phases.astype(np.int64)


def make(params: Drift, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for aircraft that are not there."""
    largest_m = inf if params.largest_m is None else params.largest_m
    track = DriftTrack(params.rate_mps, largest_m, params.at_largest == "return", params.velocity == "consistent")
    return falsify_fixes(params.vehicles, track, context)


DRIFT = AttackPlugin(Drift, make, "GNSS fixes slide away from the truth at a constant rate.")
