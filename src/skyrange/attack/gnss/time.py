"""GNSS time spoofing: receivers report a wrong UTC with true positions."""

from __future__ import annotations

from typing import Final

import numpy as np

import skyrange.plugin as sky
from skyrange.attack.bases.gnss.fixes import fixes_since

ROLLOVER_S = 1024 * 604_800
"""After this time the week number of GPS L1 C/A repeats (IS-GPS-200, 6.2.4)."""
BEFORE_ALL: Final[sky.Time] = -(2**62)
"""A time before that of every fix."""


@sky.attack(
    "gnss.time",
    technique="EX-0014.01",
    persists="flight",
    effect="the clock of a disarmed autopilot is set ahead: mission items that wait for a time end early, and Remote "
    "ID has wrong time stamps",
    knowledge="the place of each victim, to align code and Doppler with the authentic signals",
    position="in sight of the victims' antennas",
    equipment="a GNSS simulator that alters the navigation message or delays all signals alike",
    budget="a signal some decibels above the authentic ones, before the victim is armed",
    content="the sham: the same acts with the true time",
    placement="the same offset on another aircraft, or after it is armed",
    realism={
        "time": "simulated: the truth with an offset; a receiver may refuse a jump that this one takes (cited: "
        "Nighswander et al., CCS 2012, where most receivers take it)",
        "clock of the autopilot": "cited: AP_RTC::set_utc_usec takes a later time of GNSS while disarmed from "
        "ArduPilot 4.5 on (pull request 24022 of June 2023, 4.5.0-dev); before, the first fix sets it for good, and "
        "the attack has to be there before it",
        "position and velocity": "assumed: true, because all pseudoranges share the error",
        "fix type, satellites, claimed accuracy": "assumed: unaltered, a seamless capture",
        "time of the fix in the estimator": "assumed: unaltered; after a jump back ArduPilot takes fixes for up to 2 s "
        "older (cited: AP_GPS_MAV.cpp, JitterCorrection.cpp), and EKF3 limits that to its fusion horizon",
    },
)
class FalseTime(sky.OnFixes):
    """Shifts the time of GNSS receivers and leaves their positions true.

    A spoofer alters time of week and week number in the authentic signals (Nighswander et al., GPS Software Attacks,
    CCS 2012), or delays all of them alike, so that the clock drifts (Shepard et al., Evaluation of the vulnerability of
    phasor measurement units to GPS spoofing attacks, International Journal of Critical Infrastructure Protection 2012).
    The clock of the victim is that of ArduPilot 4.5 or later.
    """

    slow = False

    vehicles: sky.Victims = sky.param("Aircraft whose receivers report a wrong time, such as ['blue/b1'].")
    offset_s: sky.Number = sky.param(
        "Offset of the time at the start, in seconds; positive is ahead.", default=0.0, ge=-ROLLOVER_S, le=ROLLOVER_S
    )
    drift_s_per_s: sky.Number = sky.param("Growth of the offset, in seconds per second.", default=0.0, ge=-100, le=100)
    since_boot: bool = sky.param(
        "Whether the spoofer acted already when the receivers were switched on: the fixes that they have at the start "
        "show the wrong time too, and a clock is set by it first. Otherwise the clocks have been set by the true time.",
        default=False,
    )
    offset_ns: sky.Time

    def find_problems(self) -> sky.Problems:
        if not (self.offset_s or self.drift_s_per_s):
            yield sky.Problem("offset_s", "0", "an offset or a drift other than 0")

    def prepare(self, context: sky.AttackContext) -> None:
        self.offset_ns = sky.from_seconds(self.offset_s)

    def on_sensors(self, now: sky.Time, sensors: sky.Sensors) -> list[sky.SensorAct]:
        """Shift the time of each fix by the offset of when it was measured. An act for each vehicle's first one."""
        start = self.schedule.start_ns
        if start > now:
            return []
        rows = fixes_since(BEFORE_ALL if self.since_boot else start, sensors)
        if not self.sham:
            grown_ns = np.rint(self.drift_s_per_s * np.maximum(sensors.gnss_time_ns[rows] - start, 0)).astype(np.int64)
            sensors.gnss_utc_error_ns[rows] += self.offset_ns + grown_ns
        return self.enter(rows, 0)
