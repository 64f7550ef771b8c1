"""GNSS pull-off: the offset of fixes grows as fast as the innovation gates of the victim's estimator accept."""

from __future__ import annotations

from math import ceil, cos, inf, radians, sin
from typing import Final

import numpy as np

import skyrange.plugin as sky
from skyrange.attack.bases.fixes import Shift
from skyrange.attack.gnss.innovation_model import FilterParameters, converged
from skyrange.contracts.components import Ints

ALIGNED, PULLING, CRUISING, STOPPING = range(4)
"""Phases of a pull-off: no offset; velocity limited by a gate; at `speed_mps`; at the end of `distance_m`."""
STOP_S: Final = 8.0
"""Towards `distance_m` the speed is the remaining distance over this time, as far as the gates accept it."""
CLOSER: Final = 0.2
"""Share of the remaining way to the position gate that one fix may take."""
_REACHED: Final = 0.95
_SETTLED_MPS: Final = 1e-6


@sky.attack(
    "gnss.pull_off",
    technique="EX-0014.04",
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

    bearing_deg: sky.Number = sky.param(
        "Direction in which the fixes move away, in degrees clockwise from north.", ge=0, le=360
    )
    aligned_s: sky.Number = sky.param(
        "Time for which the false fixes agree with the truth, in seconds.", default=5.0, ge=0, le=3_600
    )
    gate_fraction: sky.Number = sky.param(
        "Predicted innovation over the gate, for the velocity and for the position; above 1 the estimator rejects the "
        "fixes.",
        default=0.6, gt=0, le=3,
    )  # fmt: skip
    speed_mps: sky.Number = sky.param(
        "Speed at which the fixes no longer accelerate, in m/s.", default=10.0, gt=0, le=100
    )
    distance_m: sky.Number | None = sky.param(
        "Distance from the truth in metres at which they stop, within the gates; default: no stop.",
        default=None, gt=0, le=1_000_000,
    )  # fmt: skip
    pos_i_gate: sky.Number = sky.param(
        "EK3_POS_I_GATE that the attacker assumes, in 1/100 sigma.", default=500.0, ge=100, le=1_000
    )
    vel_i_gate: sky.Number = sky.param(
        "EK3_VEL_I_GATE that the attacker assumes, in 1/100 sigma.", default=500.0, ge=100, le=1_000
    )
    posne_m_nse: sky.Number = sky.param(
        "EK3_POSNE_M_NSE that the attacker assumes, in metres.", default=0.5, ge=0.1, le=10
    )
    velne_m_nse: sky.Number = sky.param(
        "EK3_VELNE_M_NSE that the attacker assumes, in m/s.", default=0.3, ge=0.05, le=5
    )
    accuracy_m: sky.Number = sky.param(
        "Horizontal accuracy that the receiver claims, one sigma, in metres.", default=1.5, ge=0.01, le=100
    )
    speed_accuracy_mps: sky.Number = sky.param(
        "Speed accuracy that the receiver claims, one sigma, in m/s.", default=0.2, ge=0.01, le=50
    )
    period_s: sky.Number = sky.param(
        "Interval of the receiver's fixes, in seconds; 0.2 is 5 Hz.", default=0.2, ge=0.05, le=1
    )
    lag_s: sky.Number = sky.param(
        "Age of a fix when it is fused, in seconds, at most period_s.", default=0.12, ge=0, le=1
    )
    offset_at_m: sky.Floats
    """Offset, speed and phase of each fix from `aligned_s` on, `period_s` apart; after the last the speed stays."""
    speed_at_mps: sky.Floats
    phase_at: Ints

    def find_problems(self) -> sky.Problems:
        if self.lag_s > self.period_s:
            yield sky.Problem("lag_s", f"{self.lag_s:g}", f"at most period_s, {self.period_s:g}")

    def prepare(self, context: sky.AttackContext) -> None:
        self.plan(context.duration_ns)

    @property
    def assumed(self) -> FilterParameters:
        """The parameters of the victim's filter."""
        return FilterParameters(
            self.pos_i_gate, self.vel_i_gate, self.posne_m_nse, self.velne_m_nse, self.accuracy_m,
            self.speed_accuracy_mps, self.period_s, self.lag_s,
        )  # fmt: skip

    def shift(self, seconds: sky.Floats) -> Shift:
        """Between two fixes the speed changes linearly, so position and velocity agree at the time of any fix."""
        last = len(self.offset_at_m) - 1
        since = np.maximum(seconds - self.aligned_s, 0.0)
        row = np.minimum(since / self.period_s, last).astype(np.int64)
        further = np.minimum(row + 1, last)
        into_s = since - row * self.period_s
        change = (self.speed_at_mps[further] - self.speed_at_mps[row]) / self.period_s
        speed = self.speed_at_mps[row] + change * into_s
        offset = self.offset_at_m[row] + 0.5 * (self.speed_at_mps[row] + speed) * into_s
        way = np.array([sin(radians(self.bearing_deg)), cos(radians(self.bearing_deg)), 0.0])
        phases = np.where(seconds < self.aligned_s, ALIGNED, self.phase_at[further])
        return offset[:, None] * way, speed[:, None] * way, phases.astype(np.int64)

    def plan(self, duration_ns: sky.Time) -> None:
        """Choose offsets and speeds for an attack that lasts at most `duration_ns`."""
        model = converged(self.assumed)
        position_m = self.gate_fraction * model.position_gate_m
        velocity_mps = self.gate_fraction * model.velocity_gate_mps
        distance_m = inf if self.distance_m is None else self.distance_m
        period_s = self.period_s
        offsets, speeds, phases, from_m = [0.0], [0.0], [PULLING], 0.0
        for _ in range(max(1, ceil(duration_ns / sky.NS_PER_S / period_s))):
            offset, speed, phase = offsets[-1], speeds[-1], phases[-1]
            speed_limit = min(self.speed_mps, max((distance_m - offset) / STOP_S, -self.speed_mps))
            # the innovation of position grows slowly: the steps to its gate become shorter
            error_m, error_mps = float(model.error[0]), float(model.error[1])
            wanted = error_mps + speed_limit - model.speed_once_level(velocity_mps)
            most = (error_m + from_m + CLOSER * (position_m - from_m) - offset) / period_s
            least = (error_m + from_m - CLOSER * (position_m + from_m) - offset) / period_s
            most = min(most, error_mps + velocity_mps)
            least = max(least, error_mps - velocity_mps)
            chosen = min(max(wanted, least), most)
            if speed_limit < self.speed_mps:
                phase = STOPPING
            elif chosen >= _REACHED * self.speed_mps:
                phase = max(phase, CRUISING)
            offset += 0.5 * (speed + chosen) * period_s
            from_m = offset - error_m
            model.fuse(offset, chosen)
            offsets.append(offset)
            speeds.append(chosen)
            phases.append(phase)
            if phase != PULLING and distance_m == inf and abs(chosen - error_mps) < _SETTLED_MPS:
                break
        self.offset_at_m, self.speed_at_mps = np.array(offsets), np.array(speeds)
        self.phase_at = np.array(phases, dtype=np.int64)
