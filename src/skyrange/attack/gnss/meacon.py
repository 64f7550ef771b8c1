"""GNSS meaconing: authentic signals are repeated with a delay, and receivers report the place of the repeater."""

from __future__ import annotations

import numpy as np

import skyrange.plugin as sky
from skyrange.attack.bases.gnss.emitter import AUTHENTIC_DBM, emitter_at
from skyrange.attack.bases.gnss.takeover import AFTER_CAPTURE, DEFAULT_DBM, WHO_IS_CAPTURED, SimulatedSignals, Takeover


@sky.attack(
    "gnss.meacon",
    effect="receivers lose lock, then report the place of the repeater's antenna at rest, with a delayed clock",
    knowledge="nothing: it needs neither codes nor ephemerides, so encrypted signals are repeated too",
    equipment="a GNSS antenna, an amplifier and a second antenna, isolated from the first by more than its gain, which "
    f"is {DEFAULT_DBM - AUTHENTIC_DBM:.0f} dB at {DEFAULT_DBM:g} dBm",
    placement="the same repeater with its receiving antenna elsewhere",
    realism={
        **WHO_IS_CAPTURED,
        "alignment": "cited: the repeated code is misaligned by place, path and delay (Tippenhauer et al., CCS 2011); "
        "half a C/A chip assumed as the limit",
        "position and velocity": "simulated: the place of the receiving antenna at rest",
        "clock bias": "assumed: path and delay, below 1 ms, which nothing in the range uses",
        "gain": "simulated: below the isolation of its antennas (the condition of oscillation)",
        **AFTER_CAPTURE,
    },
)
class Meacon(Takeover):
    """Repeats the authentic GNSS signals, so that receivers in its power report the place of its own antenna, at
    rest.
    """

    at: sky.Enu = sky.place_param("Position of the receiving antenna, which captured receivers report")
    transmitter_m: sky.Enu | None = sky.place_param(
        "Position of the transmitting antenna, by default that of the receiving one", default=None
    )
    delay_ns: sky.Number = sky.param("Delay in cables and amplifiers; 100 ns is 30 m.", default=100.0, ge=0, le=1e9)
    isolation_db: sky.Number | None = sky.param(
        "Isolation of the receiving antenna from the transmitting one in dB, by directivity and shields; by default "
        "the loss on the way between them, at least 0.5 m.",
        default=None, ge=0, le=200,
    )  # fmt: skip

    def prepare(self, context: sky.AttackContext) -> None:
        """See `Acting`. Raises `InputError` for a gain at its own antenna that is not below its isolation."""
        place = self.transmitter_m or self.at
        self._check_gain(place, context)
        self.transmit(SimulatedSignals(self.at, (0.0, 0.0, 0.0), self.delay_ns, leads=False), place, context)
        self.shown = {"GNSS repeater": place, "its receiving antenna": self.at}

    def _check_gain(self, place: sky.Place, context: sky.AttackContext) -> None:
        """Raise `InputError` for a repeater that would hear itself louder than the satellites."""
        emitter = emitter_at(place, self.power_dbm, self.wall_loss_db, context)
        isolation_db = self.isolation_db
        if isolation_db is None:
            isolation_db = float(emitter.loss_db(np.array([self.at]))[0])
        gain_db = self.power_dbm - AUTHENTIC_DBM
        if gain_db >= isolation_db:
            expected = f"less than {AUTHENTIC_DBM + isolation_db:.1f}, because a repeater oscillates whose gain, here "
            expected += f"{gain_db:.1f} dB, reaches the isolation of its antennas, here {isolation_db:.1f} dB"
            hint = "Lower power_dbm, move transmitter_m away from at, or state isolation_db"
            raise sky.InputError.one(context.id, "power_dbm", self.power_dbm, expected, hint)
