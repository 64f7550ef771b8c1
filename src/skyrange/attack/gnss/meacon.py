"""GNSS meaconing: authentic signals are repeated with a delay, and receivers report the place of the repeater."""

from __future__ import annotations

import skyrange.plugin as sky
from skyrange.attack.gnss.takeover import AFTER_CAPTURE, WHO_IS_CAPTURED, SimulatedSignals, Takeover


@sky.attack(
    "gnss.meacon",
    effect="receivers lose lock, then report the place of the repeater's antenna at rest, with a delayed clock",
    knowledge="nothing: it needs neither codes nor ephemerides, so encrypted signals are repeated too",
    equipment="a GNSS antenna, an amplifier of some 100 dB and a second antenna, isolated from the first",
    load="none, because a repeated signal takes no airtime of the range's links",
    placement="the same repeater with its receiving antenna elsewhere",
    realism={
        **WHO_IS_CAPTURED,
        "loss of lock": "cited: the repeated code is misaligned by place, path and delay (Tippenhauer et al., CCS "
        "2011); half a C/A chip assumed as the limit",
        "position and velocity": "simulated: the place of the receiving antenna at rest, without receiver noise",
        "clock bias": "assumed: path and delay, below 1 ms, which nothing in the range uses",
        "satellites, claimed accuracy": "assumed: unaltered once captured",
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

    def prepare(self, context: sky.AttackContext) -> None:
        place = self.transmitter_m or self.at
        self.transmit(SimulatedSignals(self.at, (0.0, 0.0, 0.0), self.delay_ns, leads=False), place, context)
        self.shown = {"GNSS repeater": place, "its receiving antenna": self.at}
