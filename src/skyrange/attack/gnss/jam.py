"""GNSS jamming: noise on GPS L1, under which receivers lose satellites, accuracy and, near the jammer, the fix."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

import skyrange.plugin as sky
from skyrange.attack.bases.gnss.emitter import AUTHENTIC_DBM, reach_m
from skyrange.attack.bases.gnss.fixes import FIX_2D
from skyrange.attack.bases.gnss.radiation import ANTENNA, Radiation
from skyrange.attack.bases.gnss.receiver_noise import LEAST_SATELLITES, effective_db_hz, loss_db
from skyrange.contracts.components import Ints
from skyrange.world.sensing import sensor_errors


def reach_of_jammer_m(power_dbm: float) -> float:
    """Distance in free space, at the height of the antenna, within which receivers lose their fix."""
    return reach_m(power_dbm, AUTHENTIC_DBM + loss_db(sensor_errors.GNSS_SATELLITES))


@sky.attack(
    "gnss.jam",
    technique="EX-0016.03",
    effect="the receiver has no fix, the estimator stops aiding, and the autopilot fails safe",
    knowledge="nothing",
    position="in line of sight of the antennas: for a loss of the fix "
    f"{reach_of_jammer_m(10.0):.0f} m at 10 dBm, {reach_of_jammer_m(20.0):.0f} m at 20 dBm in free space, from the "
    "height of the aircraft, and half of that from 30 degrees below",
    equipment="a noise or sweep generator for 1575.42 MHz, sold as a privacy device",
    budget="milliwatts, for as long as it acts",
    load="none, because the noise is the attack and takes no airtime of the range's links; the sham radiates none",
    content="none, because noise has no content",
    placement="the same jammer farther away or behind a building",
    realism={
        **ANTENNA,
        "C/N0": "simulated: noise power in free space and behind walls against −128.5 dBm (IS-GPS-200)",
        "satellites and loss of the fix": "cited: tracking to 28 dB-Hz (Ward in Kaplan, Understanding GPS, 1996), "
        "which is a J/S of about 35 dB; reacquisition 7 dB above it (u-blox SAM-M10Q)",
        "claimed accuracy and errors": "cited: code jitter by C/N0 (Kaplan and Hegarty, 2006, eq. 5.23); dilution "
        "assumed to grow with the root of the lost satellites",
        "spread of signal strengths": "assumed: ±5 dB over the satellites",
        "after the attack": "assumed: the fix is back at once",
    },
)
class GnssJam(Radiation):
    """Transmits noise on GPS L1, so that receivers near it lose accuracy, satellites and at last the fix.

    The noise is wide-band.
    """

    transmitter_m: sky.Enu = sky.place_param("Position of the jammer")
    power_dbm: sky.Number = sky.param(
        "Power radiated on GPS L1 (EIRP) in dBm, within the receivers' filter.", default=10.0, ge=-60, le=60
    )
    reacquire_s: sky.Number = sky.param(
        "Seconds to a new fix once the noise is weak enough; 1 is a hot start of a u-blox M10, 24 a cold start.",
        default=1.0, ge=0, le=120,
    )  # fmt: skip
    stream: ClassVar[str] = "attack.gnss_jam"
    first: ClassVar[bool] = True

    def prepare(self, context: sky.AttackContext) -> None:
        self.radiate(self.transmitter_m, self.power_dbm, context)
        self.shown = {"GNSS jammer": self.transmitter_m}

    def receive(self, rows: Ints, sensors: sky.Sensors) -> None:
        power = self.emitter.received_dbm(sensors.gnss_enu_m[rows])
        for row, jam_dbm in zip(rows.tolist(), power, strict=True):
            count = int(sensors.gnss_satellites[row])
            if sensors.gnss_fix[row] >= FIX_2D and count >= LEAST_SATELLITES:
                db_hz = effective_db_hz(np.array([jam_dbm]), count)[0]
                self.phases[row] = self.degrade(row, db_hz, sensors.gnss_accuracy[row])
