"""GNSS time spoofing: receivers report a wrong UTC with true positions.

A spoofer that sends the authentic signals with altered time of week and week number leaves the position true, because
all pseudoranges share the error (Nighswander et al., GPS Software Attacks, CCS 2012, which shifts the date of
receivers); one that delays all signals alike makes the clock drift (Shepard et al., Evaluation of the vulnerability of
phasor measurement units to GPS spoofing attacks, International Journal of Critical Infrastructure Protection 2012).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from pydantic import Field, model_validator

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.gnss.emitter import FIX_2D
from skyrange.attack.victims import Victims, check_vehicles
from skyrange.contracts.components import SensorAct, Sensors
from skyrange.contracts.links import Schedule
from skyrange.contracts.params import Number, Params, refuse
from skyrange.core.errors import Problem
from skyrange.core.time import Time, from_seconds

ROLLOVER_S = 1024 * 604_800
"""After this time the week number of GPS L1 C/A repeats (IS-GPS-200, 6.2.4)."""


class FalseTime(Params):
    """The UTC of the receivers is ahead of the true one, or behind it. Positions and velocities stay true."""

    vehicles: Victims = Field(description="Aircraft whose receivers report a wrong time, such as ['blue/b1'].")
    offset_s: Number = Field(
        default=0.0,
        ge=-ROLLOVER_S,
        le=ROLLOVER_S,
        description="Offset of the reported time at the start of the attack, in seconds; positive is ahead; at most "
        "1024 weeks.",
    )
    drift_s_per_s: Number = Field(
        default=0.0, ge=-100, le=100, description="Growth of the offset, in seconds per second."
    )

    @model_validator(mode="after")
    def _shifts(self) -> FalseTime:
        if not (self.offset_s or self.drift_s_per_s):
            raise refuse(Problem("offset_s", "0", "an offset or a drift other than 0"))
        return self


@dataclass(slots=True)
class FalseUtc:
    """A fault by which the receivers of its vehicles report a wrong UTC.

    The offset of a fix is that of the time at which the fix was measured, as in `false_fixes.FalseFixes`.
    """

    name: str
    vehicles: Sequence[str]
    offset_ns: Time
    drift: float
    schedule: Schedule
    sham: bool
    _told: list[bool] = field(init=False)

    def __post_init__(self) -> None:
        self._told = [False] * len(self.vehicles)

    def on_sensors(self, now: Time, sensors: Sensors) -> Sequence[SensorAct]:
        """Shift the time of the fixes. Returns an act for each vehicle whose first fix it shifts."""
        start = self.schedule.start_ns
        if start > now:
            return []
        rows = np.flatnonzero((sensors.gnss_time_ns >= start) & (sensors.gnss_fix >= FIX_2D))
        if not self.sham:
            grown_ns = np.rint(self.drift * (sensors.gnss_time_ns[rows] - start)).astype(np.int64)
            sensors.gnss_utc_error_ns[rows] += self.offset_ns + grown_ns
        acts = []
        for row in rows.tolist():
            if not self._told[row]:
                self._told[row] = True
                acts.append(SensorAct(self.vehicles[row], "gnss"))
        return acts


def make(params: FalseTime, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for aircraft that are not in the scenario."""
    check_vehicles(context, params.vehicles)
    fault = FalseUtc(
        f"{context.id}.gnss",
        params.vehicles,
        from_seconds(params.offset_s),
        params.drift_s_per_s,
        context.schedule,
        context.sham,
    )
    return Attack(faults=[fault])


GNSS_TIME = AttackPlugin(
    FalseTime,
    make,
    "Shifts the time of GNSS receivers and leaves their positions true.",
    technique="EX-0014.01",
    counterfactual="mute",
    surface=("gnss",),
    persists="flight",
    effect="the clock of a disarmed autopilot is set ahead: mission items that wait for a time end early, and Remote "
    "ID has wrong time stamps",
    threat=ThreatModel(
        knowledge="the place of each victim, to align code and Doppler with the authentic signals",
        position="in sight of the victims' antennas",
        equipment="a GNSS simulator that alters the navigation message or delays all signals alike",
        budget="a signal some decibels above the authentic ones, before the victim is armed",
    ),
    controls=Controls(
        load="none, because a spoofed signal takes no airtime of the range's links",
        content="the sham: the same acts with the true time",
        placement="the same offset on another aircraft, or after it is armed",
    ),
    realism={
        "time": "simulated: the truth with an offset; a receiver may refuse a jump that this one takes (cited: "
        "Nighswander et al., CCS 2012, where most receivers take it)",
        "position and velocity": "assumed: true, because all pseudoranges share the error",
        "fix type, satellites, claimed accuracy": "assumed: unaltered, a seamless capture",
        "time of the fix in the estimator": "assumed: unaltered; after a jump back ArduPilot takes fixes for up to 2 s "
        "older (cited: AP_GPS_MAV.cpp, JitterCorrection.cpp), and EKF3 limits that to its fusion horizon",
    },
)
