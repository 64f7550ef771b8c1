"""Plan of a pull-off: offsets and speeds of GNSS fixes that a model of the victim's filter accepts."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, inf
from typing import Final

import numpy as np

from skyrange.attack.gnss.innovation_model import FilterParameters, converged
from skyrange.contracts.components import Floats, Ints

PULLING, CRUISING, STOPPING = range(1, 4)
"""Phases of a pull: velocity limited by a gate; at its greatest speed; at the end of its distance."""
STOP_S: Final = 8.0
"""Towards the end the speed is the remaining distance over this time, as far as the gates accept it."""
CLOSER: Final = 0.2
"""Share of the remaining way to the position gate that one fix may take."""
_REACHED: Final = 0.95
_SETTLED_MPS: Final = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class PullPlan:
    """Offset, speed and phase of each fix from the first on, `period_s` apart; after the last the speed stays."""

    offset_at_m: Floats
    speed_at_mps: Floats
    phase_at: Ints
    period_s: float

    def motion(self, since_s: Floats) -> tuple[Floats, Floats, Ints]:
        """Offsets, speeds and phases at times since the first fix.

        Between two fixes the speed changes linearly, so position and velocity agree at the time of any fix.
        """
        last = len(self.offset_at_m) - 1
        row = np.minimum(since_s / self.period_s, last).astype(np.int64)
        further = np.minimum(row + 1, last)
        into_s = since_s - row * self.period_s
        change = (self.speed_at_mps[further] - self.speed_at_mps[row]) / self.period_s
        speed = self.speed_at_mps[row] + change * into_s
        offset = self.offset_at_m[row] + 0.5 * (self.speed_at_mps[row] + speed) * into_s
        return offset, speed, self.phase_at[further]


def plan_pull(
    assumed: FilterParameters, gate_fraction: float, greatest_mps: float, distance_m: float, duration_s: float
) -> PullPlan:
    """Offsets and speeds for a pull that lasts at most `duration_s`, to a distance that may be infinite.

    The predicted innovations are at most `gate_fraction` of their gates.
    """
    model = converged(assumed)
    position_m = gate_fraction * model.position_gate_m
    velocity_mps = gate_fraction * model.velocity_gate_mps
    period_s = assumed.period_s
    offsets, speeds, phases, from_m = [0.0], [0.0], [PULLING], 0.0
    for _ in range(max(1, ceil(duration_s / period_s))):
        offset, speed, phase = offsets[-1], speeds[-1], phases[-1]
        speed_limit = min(greatest_mps, max((distance_m - offset) / STOP_S, -greatest_mps))
        # the innovation of position grows slowly: the steps to its gate become shorter
        error_m, error_mps = float(model.error[0]), float(model.error[1])
        wanted = error_mps + speed_limit - model.speed_once_level(velocity_mps)
        most = (error_m + from_m + CLOSER * (position_m - from_m) - offset) / period_s
        least = (error_m + from_m - CLOSER * (position_m + from_m) - offset) / period_s
        most = min(most, error_mps + velocity_mps)
        least = max(least, error_mps - velocity_mps)
        chosen = min(max(wanted, least), most)
        if speed_limit < greatest_mps:
            phase = STOPPING
        elif chosen >= _REACHED * greatest_mps:
            phase = max(phase, CRUISING)
        offset += 0.5 * (speed + chosen) * period_s
        from_m = offset - error_m
        model.fuse(offset, chosen)
        offsets.append(offset)
        speeds.append(chosen)
        phases.append(phase)
        if phase != PULLING and distance_m == inf and abs(chosen - error_mps) < _SETTLED_MPS:
            break
    return PullPlan(np.array(offsets), np.array(speeds), np.array(phases, dtype=np.int64), period_s)
