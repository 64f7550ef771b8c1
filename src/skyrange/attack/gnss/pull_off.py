"""GNSS pull-off: the offset of fixes grows as fast as the innovation gates of the victim's estimator accept."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, cos, inf, radians, sin
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.gnss.false_fixes import falsify_fixes
from skyrange.attack.gnss.innovation_model import FilterParameters, converged
from skyrange.attack.victims import Victims
from skyrange.contracts.components import Floats
from skyrange.contracts.params import Number, Params, refuse
from skyrange.core.errors import Problem
from skyrange.core.time import NS_PER_S, Time

ALIGNED, PULLING, CRUISING, STOPPING = range(4)
"""Phases of a pull-off: no offset; velocity limited by a gate; at `speed_mps`; at the end of `distance_m`."""
STOP_S: Final = 8.0
"""Towards `distance_m` the speed is the remaining distance over this time, as far as the gates accept it."""
CLOSER: Final = 0.2
"""Share of the remaining way to the position gate that one fix may take."""
_REACHED: Final = 0.95
_SETTLED_MPS: Final = 1e-6


class PullOff(Params):
    """The fixes first agree with the truth. Then they move away with a velocity that a model of the filter accepts."""

    vehicles: Victims = Field(description="Aircraft whose GNSS fixes are falsified, such as ['blue/b1'].")
    bearing_deg: Number = Field(
        ge=0, le=360, description="Direction in which the fixes move away, in degrees clockwise from north."
    )
    aligned_s: Number = Field(
        default=5.0, ge=0, le=3_600, description="Time for which the false fixes agree with the truth, in seconds."
    )
    gate_fraction: Number = Field(
        default=0.6,
        gt=0,
        le=3,
        description="Predicted innovation over the gate, for the velocity and for the position; above 1 the estimator "
        "rejects the fixes.",
    )
    speed_mps: Number = Field(
        default=10.0, gt=0, le=100, description="Speed at which the fixes no longer accelerate, in m/s."
    )
    distance_m: Number | None = Field(
        default=None,
        gt=0,
        le=1_000_000,
        description="Distance from the truth in metres at which they stop, within the gates; default: no stop.",
    )
    pos_i_gate: Number = Field(
        default=500.0, ge=100, le=1_000, description="EK3_POS_I_GATE that the attacker assumes, in 1/100 sigma."
    )
    vel_i_gate: Number = Field(
        default=500.0, ge=100, le=1_000, description="EK3_VEL_I_GATE that the attacker assumes, in 1/100 sigma."
    )
    posne_m_nse: Number = Field(
        default=0.5, ge=0.1, le=10, description="EK3_POSNE_M_NSE that the attacker assumes, in metres."
    )
    velne_m_nse: Number = Field(
        default=0.3, ge=0.05, le=5, description="EK3_VELNE_M_NSE that the attacker assumes, in m/s."
    )
    accuracy_m: Number = Field(
        default=1.5, ge=0.01, le=100, description="Horizontal accuracy that the receiver claims, one sigma, in metres."
    )
    speed_accuracy_mps: Number = Field(
        default=0.2, ge=0.01, le=50, description="Speed accuracy that the receiver claims, one sigma, in m/s."
    )
    period_s: Number = Field(
        default=0.2, ge=0.05, le=1, description="Interval of the receiver's fixes, in seconds; 0.2 is 5 Hz."
    )
    lag_s: Number = Field(
        default=0.12, ge=0, le=1, description="Age of a fix when it is fused, in seconds, at most period_s."
    )

    @model_validator(mode="after")
    def _fused_before_the_next(self) -> PullOff:
        if self.lag_s > self.period_s:
            raise refuse(Problem("lag_s", f"{self.lag_s:g}", f"at most period_s, {self.period_s:g}"))
        return self

    @property
    def assumed(self) -> FilterParameters:
        """The parameters of the victim's filter."""
        return FilterParameters(
            self.pos_i_gate, self.vel_i_gate, self.posne_m_nse, self.velne_m_nse, self.accuracy_m,
            self.speed_accuracy_mps, self.period_s, self.lag_s,
        )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class PullOffTrack:
    """A track through tabled offsets and speeds, `period_s` apart; after the last the speed stays.

    Between two rows the speed changes linearly, so position and velocity agree at the time of any fix.
    """

    direction: tuple[float, float, float]
    aligned_s: float
    period_s: float
    offset_m: Floats
    speed_mps: Floats
    phase: NDArray[np.int64]

    def at(self, seconds: Floats) -> tuple[Floats, Floats, NDArray[np.int64]]:
        """See `false_fixes.Track`."""
        since = np.maximum(seconds - self.aligned_s, 0.0)
        row = np.minimum(since / self.period_s, len(self.offset_m) - 1).astype(np.int64)
        further = np.minimum(row + 1, len(self.offset_m) - 1)
        into_s = since - row * self.period_s
        change = (self.speed_mps[further] - self.speed_mps[row]) / self.period_s
        speed = self.speed_mps[row] + change * into_s
        offset = self.offset_m[row] + 0.5 * (self.speed_mps[row] + speed) * into_s
        way = np.array(self.direction)
        phases = np.where(seconds < self.aligned_s, ALIGNED, self.phase[further])
        return offset[:, None] * way, speed[:, None] * way, phases.astype(np.int64)


def pull_off_track(params: PullOff, duration_ns: Time) -> PullOffTrack:
    """The track of a pull-off that lasts at most `duration_ns`."""
    model = converged(params.assumed)
    position_m = params.gate_fraction * model.position_gate_m
    velocity_mps = params.gate_fraction * model.velocity_gate_mps
    distance_m = inf if params.distance_m is None else params.distance_m
    period_s = params.period_s
    offsets, speeds, phases, from_m = [0.0], [0.0], [PULLING], 0.0
    for _ in range(max(1, ceil(duration_ns / NS_PER_S / period_s))):
        offset, speed, phase = offsets[-1], speeds[-1], phases[-1]
        speed_limit = min(params.speed_mps, max((distance_m - offset) / STOP_S, -params.speed_mps))
        # the innovation of position grows slowly: the steps to its gate become shorter
        error_m, error_mps = float(model.error[0]), float(model.error[1])
        wanted = error_mps + speed_limit - model.speed_once_level(velocity_mps)
        most = (error_m + from_m + CLOSER * (position_m - from_m) - offset) / period_s
        least = (error_m + from_m - CLOSER * (position_m + from_m) - offset) / period_s
        most = min(most, error_mps + velocity_mps)
        least = max(least, error_mps - velocity_mps)
        chosen = min(max(wanted, least), most)
        if speed_limit < params.speed_mps:
            phase = STOPPING
        elif chosen >= _REACHED * params.speed_mps:
            phase = max(phase, CRUISING)
        offset += 0.5 * (speed + chosen) * period_s
        from_m = offset - error_m
        model.fuse(offset, chosen)
        offsets.append(offset)
        speeds.append(chosen)
        phases.append(phase)
        if phase != PULLING and distance_m == inf and abs(chosen - error_mps) < _SETTLED_MPS:
            break
    return PullOffTrack(
        (sin(radians(params.bearing_deg)), cos(radians(params.bearing_deg)), 0.0),
        params.aligned_s,
        period_s,
        np.array(offsets),
        np.array(speeds),
        np.array(phases, dtype=np.int64),
    )


def make(params: PullOff, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for aircraft that are not in the scenario."""
    return falsify_fixes(params.vehicles, pull_off_track(params, context.duration_ns), context)


PULL_OFF = AttackPlugin(
    PullOff,
    make,
    "Pulls GNSS fixes away from the truth as fast as the innovation gates of the victim's estimator accept.",
    technique="EX-0014.04",
    counterfactual="mute",
    surface=("gnss",),
    persists="acts",
    effect="the aircraft accelerates away from its path, and its estimator accepts every fix and reports no glitch",
    threat=ThreatModel(
        knowledge="the place of each victim, to align code and Doppler; noises, gates and claimed accuracy of its "
        "estimator, which open autopilots publish as defaults; neither its state nor its telemetry",
        position="in sight of the victims' antennas",
        equipment="a GNSS simulator that follows each victim alone, and a model of the victim's filter",
        budget="a signal some decibels above the authentic ones, for as long as it acts",
    ),
    controls=Controls(
        load="none, because a spoofed signal takes no airtime of the range's links",
        content="the sham: the same acts with unaltered fixes; gnss.drift at the same speed, without the model",
        placement="the same offset on another aircraft",
    ),
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
