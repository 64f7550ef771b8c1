"""GNSS pull-off: the offset of fixes grows as fast as the innovation gates of the victim's estimator accept."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, inf, radians
from typing import Final

import numpy as np

import skyrange.plugin as sky
from skyrange.attack.bases.gnss.fixes import Shift
from skyrange.attack.bases.gnss.innovation_model import FilterParameters, converged
from skyrange.contracts.components import Floats, Ints
from skyrange.core.elementary import cos, sin

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


ALIGNED = 0
"""The phase without an offset; the others are those of the plan."""


@sky.attack(
    "gnss.pull_off",
    effect="the aircraft accelerates away from its path, and its estimator accepts every fix and reports no glitch",
    knowledge="the place of each victim, to align code and Doppler; noises, gates and claimed accuracy of its "
    "estimator, which open autopilots publish as defaults; neither its state nor its telemetry",
    equipment="a GNSS simulator that follows each victim alone, and a model of the victim's filter",
    content="the sham: the same acts with unaltered fixes; gnss.drift at the same speed, without the model",
    realism={
        "position and velocity": "simulated: the truth with an offset, and the rate of the offset",
        "drag below the gates": "cited: covert capture evades the tests of the target's state estimator (Kerns et al., "
        "Unmanned Aircraft Capture and Control via GPS Spoofing, Journal of Field Robotics 2014)",
        "gates and gains": "cited: FuseVelPosNED and CovariancePrediction of AP_NavEKF3, reduced to one level axis and "
        "the climb rate, converged",
        "fix type, satellites, claimed accuracy": "assumed: unaltered, a seamless capture",
        "time of the fixes": "assumed: the receiver's interval and lag are as its parameters say",
    },
)
class PullOff(sky.FalseFixes):
    """Pulls GNSS fixes away from the truth as fast as the innovation gates of the victim's estimator accept.

    The fixes first agree with the truth. Then they move away with a velocity that a model of the filter accepts.
    """

    bearing_deg: sky.Number = sky.param("Direction of the offset, in degrees clockwise from north.", ge=0, le=360)
    aligned_s: sky.Number = sky.param(
        "Time for which the false fixes agree with the truth, in seconds.", default=5.0, ge=0, le=3_600
    )
    gate_fraction: sky.Number = sky.param(
        "Predicted innovation over the gate, for the velocity and for the position; above 1 the estimator rejects the "
        "fixes.",
        default=0.6, gt=0, le=3,
    )  # fmt: skip
    speed_mps: sky.Number = sky.param("Greatest speed of the offset, in m/s.", default=10.0, gt=0, le=100)
    distance_m: sky.Number | None = sky.param(
        "Distance from the truth in metres at which the fixes stop, within the gates; default: no stop.",
        default=None, gt=0, le=1_000_000,
    )  # fmt: skip
    pos_i_gate: sky.Number = sky.param("Assumed EK3_POS_I_GATE, in 1/100 sigma.", default=500.0, ge=100, le=1_000)
    vel_i_gate: sky.Number = sky.param("Assumed EK3_VEL_I_GATE, in 1/100 sigma.", default=500.0, ge=100, le=1_000)
    posne_m_nse: sky.Number = sky.param("Assumed EK3_POSNE_M_NSE, in metres.", default=0.5, ge=0.1, le=10)
    velne_m_nse: sky.Number = sky.param("Assumed EK3_VELNE_M_NSE, in m/s.", default=0.3, ge=0.05, le=5)
    accuracy_m: sky.Number = sky.param("Claimed horizontal accuracy, 1 sigma, in metres.", default=1.5, ge=0.01, le=100)
    speed_accuracy_mps: sky.Number = sky.param("Claimed speed accuracy, 1 sigma, in m/s.", default=0.2, ge=0.01, le=50)
    period_s: sky.Number = sky.param("Interval of fixes, in seconds; 0.2 is 5 Hz.", default=0.2, ge=0.05, le=1)
    lag_s: sky.Number = sky.param("Age of a fix when fused, in seconds, at most period_s.", default=0.12, ge=0, le=1)
    plan: PullPlan

    def find_problems(self) -> sky.Problems:
        if self.lag_s > self.period_s:
            yield sky.Problem("lag_s", f"{self.lag_s:g}", f"at most period_s, {self.period_s:g}")

    def prepare(self, context: sky.AttackContext) -> None:
        distance_m = inf if self.distance_m is None else self.distance_m
        duration_s = context.duration_ns / sky.NS_PER_S
        self.plan = plan_pull(self.assumed, self.gate_fraction, self.speed_mps, distance_m, duration_s)

    @property
    def assumed(self) -> FilterParameters:
        """The parameters of the victim's filter."""
        return FilterParameters(
            self.pos_i_gate, self.vel_i_gate, self.posne_m_nse, self.velne_m_nse, self.accuracy_m,
            self.speed_accuracy_mps, self.period_s, self.lag_s,
        )  # fmt: skip

    def shift(self, seconds: sky.Floats) -> Shift:
        offset, speed, phases = self.plan.motion(np.maximum(seconds - self.aligned_s, 0.0))
        direction_enu = np.array([sin(radians(self.bearing_deg)), cos(radians(self.bearing_deg)), 0.0])
        phases = np.where(seconds < self.aligned_s, ALIGNED, phases)
        return offset[:, None] * direction_enu, speed[:, None] * direction_enu, phases.astype(np.int64)
