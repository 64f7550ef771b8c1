"""Base of kinds that send pulses to a LiDAR, and what generations of LiDARs make of them."""

from __future__ import annotations

from math import inf, pi
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from skyrange.attack.bases.light import LIGHT_M_PER_NS, LightsSensor
from skyrange.contracts.components import Floats
from skyrange.contracts.params import Number
from skyrange.contracts.plugins.form import param
from skyrange.contracts.scan_light import ScanLight
from skyrange.core import elementwise
from skyrange.core.time import Time

Generation = Literal["first", "randomised", "fingerprint"]


class SendsPulses(LightsSensor):
    """Sends pulses that a LiDAR takes for echoes of its own, at distances that depend on their time."""

    generation: Generation = param(
        "Generation of the LiDAR. first: its pulses come at known times; randomised: at random times; fingerprint: "
        "each carries a code.",
        default="first",
    )
    jitter_ns: Number = param(
        "Of a randomised LiDAR: span of the random times of its pulses, in nanoseconds.", default=1_000.0, ge=0, le=1e6
    )
    accepted: Number = param(
        "Of a LiDAR with a fingerprint: share of the attacker's pulses that it takes for its own.",
        default=0.05, ge=0, le=1,
    )  # fmt: skip
    timing_ns: Number = param(
        "Error of the time of the attacker's pulses in nanoseconds, one standard deviation; 1 ns is 0.15 m.",
        default=1.0, ge=0, le=1e6,
    )  # fmt: skip

    def time_pulses(
        self, now: Time, light: ScanLight, pulses: NDArray[np.int64], distance: Floats, *, predicted: bool = True
    ) -> Floats:
        """(n,): the distances at which the LiDAR takes echoes that were meant for `distance`; not a number for none.

        `predicted` pulses are sent at times that the attacker expects, others in answer to the LiDAR's own.
        """
        draws = self.draw("attack.light.pulses", light, now, pulses)
        normal = elementwise.power(-2.0 * elementwise.log(1.0 - draws[:, 0]), 0.5)
        normal *= elementwise.cos(2.0 * pi * draws[:, 1])
        late_ns = self.timing_ns * normal
        if predicted and self.generation == "randomised":
            late_ns = late_ns + (draws[:, 2] - 0.5) * self.jitter_ns
        taken = np.where(np.isfinite(distance), distance, np.nan) + 0.5 * LIGHT_M_PER_NS * late_ns
        taken[~(taken > 0.0)] = np.nan
        return self.refuse(taken, draws[:, 3])

    def refuse(self, distance: Floats, draws: Floats) -> Floats:
        """(n,): the distances without the pulses that a fingerprint gives away."""
        share = self.accepted if self.generation == "fingerprint" else inf
        return np.where(draws < share, distance, np.nan)
