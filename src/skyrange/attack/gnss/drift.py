"""GNSS drift: the offset of fixes grows at a constant rate, with a consistent or an unaltered velocity."""

from __future__ import annotations

from math import inf
from typing import Literal

import numpy as np

import skyrange.plugin as sky
from skyrange.attack.bases.gnss.fixes import Rate, Shift
from skyrange.core.elementary import hypot3

GROWING, HELD, RETURNING, BACK = range(4)  # phases


@sky.attack(
    "gnss.drift",
    effect="the estimated position leaves the true one, and the autopilot flies the opposite way",
)
class Drift(sky.FalseFixes):
    """Makes GNSS fixes drift away from the truth at a constant rate."""

    rate_mps: Rate = sky.param("Velocity of the offset, [east, north, up] in m/s, each from -500 to 500.")
    velocity: Literal["consistent", "unaltered"] = sky.param(
        "Velocity of the fixes. consistent: that of the false track; unaltered: as measured.", default="consistent"
    )
    largest_m: sky.Number | None = sky.param(
        "Largest distance from the truth in metres; default: no limit.", default=None, gt=0, le=1_000_000
    )
    at_largest: Literal["hold", "return"] = sky.param(
        "What it does at largest_m. hold: it stays; return: it goes back to zero at the same rate.", default="hold"
    )

    def find_problems(self) -> sky.Problems:
        if self.at_largest == "return" and self.largest_m is None:
            yield sky.Problem("largest_m", "missing", "the distance from which at_largest = 'return' goes back")

    def shift(self, seconds: sky.Floats) -> Shift:
        rate, speed = np.array(self.rate_mps, dtype=np.float64), hypot3(*self.rate_mps)
        turn_s = self.largest_m / speed if self.largest_m is not None and speed > 0.0 else inf
        phases = np.where(seconds < turn_s, GROWING, HELD)
        grown_s = np.minimum(seconds, turn_s)
        if self.at_largest == "return":
            phases[seconds >= turn_s] = RETURNING
            phases[seconds >= 2.0 * turn_s] = BACK
            grown_s = np.maximum(np.minimum(seconds, 2.0 * turn_s - seconds), 0.0)
        sense = (phases == GROWING).astype(np.float64) - (phases == RETURNING)
        reported = sense if self.velocity == "consistent" else np.zeros_like(sense)
        return grown_s[:, None] * rate, reported[:, None] * rate, phases.astype(np.int64)
