"""GNSS jamming: noise on GPS L1, under which receivers lose satellites, accuracy and, near the jammer, the fix."""

from __future__ import annotations

from math import sqrt
from typing import Final

import numpy as np

import skyrange.plugin as sky
from skyrange.attack.bases.fixes import ALL, FIX_2D, UNALTERED
from skyrange.attack.gnss.emitter import FIX_NONE, Emitter, emitter_at
from skyrange.attack.gnss.receiver_noise import (
    LEAST_SATELLITES,
    REACQUISITION_DB,
    TRACKING_DB_HZ,
    code_jitter_m,
    effective_db_hz,
)
from skyrange.contracts.components import Ints

STREAM: Final = "attack.gnss_jam"
NOTICEABLE: Final = 1.05
"""A fix with all satellites and less than this times its usual error is left as it is."""
DEGRADED, LOST = range(2)
"""Phases of a receiver."""


@sky.attack(
    "gnss.jam",
    technique="EX-0016.03",
    effect="the receiver has no fix, the estimator stops aiding, and the autopilot fails safe",
    knowledge="nothing",
    position="in line of sight of the antennas: about 1.5 km at 10 dBm, 5 km at 20 dBm in free space",
    equipment="a noise or sweep generator for 1575.42 MHz, sold as a privacy device",
    budget="milliwatts, for as long as it acts",
    load="none, because the noise is the attack and takes no airtime of the range's links; the sham radiates none",
    content="none, because noise has no content",
    placement="the same jammer farther away or behind a building",
    realism={
        "C/N0": "simulated: noise power in free space and behind walls against −128.5 dBm (IS-GPS-200)",
        "satellites and loss of the fix": "cited: tracking to 28 dB-Hz (Ward in Kaplan, Understanding GPS, 1996), "
        "which is a J/S of about 35 dB; reacquisition 7 dB above it (u-blox SAM-M10Q)",
        "claimed accuracy and errors": "cited: code jitter by C/N0 (Kaplan and Hegarty, 2006, eq. 5.23); dilution "
        "assumed to grow with the root of the lost satellites",
        "spread of signal strengths": "assumed: ±5 dB over the satellites",
        "after the attack": "assumed: the fix is back at once",
    },
)
class GnssJam(sky.OnReceivers):
    """Transmits noise on GPS L1, so that receivers near it lose accuracy, satellites and at last the fix.

    Wide-band noise on GPS L1 from one place. It affects every aircraft by the power at its antenna. A receiver that has
    lost its fix needs stronger signals to find satellites again than it needs to keep them.
    """

    transmitter_m: sky.Enu = sky.param(
        "Position of the jammer, [east_m, north_m, up_m] in metres from the origin or the attack's anchor."
    )
    power_dbm: sky.Number = sky.param(
        "Power radiated on GPS L1 (EIRP) in dBm, within the receivers' filter.", default=10.0, ge=-60, le=60
    )
    wall_loss_db: sky.Number = sky.param(
        "Loss in dB where a building of the city blocks the line of sight.", default=30.0, ge=0, le=100
    )
    reacquire_s: sky.Number = sky.param(
        "Time in seconds that a receiver needs for a new fix once the noise has become weak enough; 1 is a hot start "
        "of a u-blox M10, 24 a cold start.",
        default=1.0, ge=0, le=120,
    )  # fmt: skip
    emitter: Emitter
    chance: sky.Chance
    clear_since: Ints
    """(n,) Since when each that has lost its fix finds enough satellites, ns; -1 if it does not."""
    error_mps: sky.Floats
    """(n, 3) Added to velocities."""

    def prepare(self, context: sky.AttackContext) -> None:
        """Place the jammer. Raises `InputError` for one inside a building."""
        self.emitter = emitter_at(self.transmitter_m, self.power_dbm, self.wall_loss_db, context)
        self.chance = context.chance
        self.clear_since = np.full(len(self.vehicles), -1, dtype=np.int64)
        self.error_mps = np.zeros((len(self.vehicles), 3))

    def build(self, context: sky.AttackContext) -> sky.Attack:
        """See `AltersSensors`."""
        return sky.Attack(sensor_hooks=super().build(context).sensor_hooks, shown={"GNSS jammer": self.transmitter_m})

    def receive(self, rows: Ints, sensors: sky.Sensors) -> None:
        power = self.emitter.received_dbm(sensors.gnss_enu_m[rows])
        for row, jam_dbm in zip(rows.tolist(), power, strict=True):
            count = int(sensors.gnss_satellites[row])
            if sensors.gnss_fix[row] >= FIX_2D and count >= LEAST_SATELLITES:
                db_hz = effective_db_hz(np.array([jam_dbm]), count)[0]
                self.phases[row] = self._degrade(row, int(self.seen[row]), db_hz, sensors.gnss_accuracy[row])

    def alter(self, sensors: sky.Sensors) -> None:
        """See `OnReceivers`."""
        super().alter(sensors)
        sensors.gnss_vel_enu_mps += self.error_mps

    def _degrade(self, row: int, time: sky.Time, db_hz: sky.Floats, accuracy: sky.Floats) -> int:
        """What one receiver makes of its satellites; returns its phase."""
        lost = self.phases[row] == LOST
        kept = db_hz[db_hz >= TRACKING_DB_HZ + (REACQUISITION_DB if lost else 0.0)]
        enough = len(kept) >= LEAST_SATELLITES
        if lost and enough:
            if self.clear_since[row] < 0:
                self.clear_since[row] = time
            enough = time - int(self.clear_since[row]) >= sky.from_seconds(self.reacquire_s)
        elif lost:
            self.clear_since[row] = -1
        self.offset[row], self.error_mps[row], self.scale[row] = 0.0, 0.0, 1.0
        self.satellites[row], self.fix[row] = len(kept), FIX_NONE
        if not enough:
            return LOST
        self.clear_since[row] = -1
        self.fix[row] = ALL
        clean = code_jitter_m(float(effective_db_hz(np.array([-np.inf]), len(db_hz)).mean()))
        extra_m2 = code_jitter_m(float(kept.mean())) ** 2 - clean**2
        share = sqrt(1.0 + max(extra_m2, 0.0) / max(float(accuracy[0]), 0.1) ** 2) * sqrt(len(db_hz) / len(kept))
        if len(kept) == len(db_hz) and share < NOTICEABLE:
            return UNALTERED
        self.scale[row] = share
        horizontal, vertical, speed = accuracy * sqrt(share * share - 1.0)
        errors = self._deviates(row, time) * np.array([horizontal, horizontal, vertical, speed, speed, speed])
        self.offset[row], self.error_mps[row] = errors[:3], errors[3:]
        return DEGRADED

    def _deviates(self, row: int, time: sky.Time) -> sky.Floats:
        """Six deviates of mean 0 and variance 1, each the sum of three uniforms."""
        who = sky.hash64(self.vehicles[row])
        return np.array([2.0 * (sum(self.chance.uniform4(STREAM, who, time, k)[:3]) - 1.5) for k in range(6)])
