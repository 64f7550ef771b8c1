"""GNSS meaconing: authentic signals are repeated with a delay, and receivers report the place of the repeater."""

from __future__ import annotations

import skyrange.plugin as sky
from skyrange.attack.gnss.emitter import SPEED_OF_LIGHT_MPS
from skyrange.attack.gnss.takeover import AFTER_CAPTURE, WHO_IS_CAPTURED, SimulatedSignals, Takeover


@sky.attack(
    "gnss.meacon",
    technique="EX-0014.04",
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
    """Repeats the authentic GNSS signals, so that receivers in its power report the place of its own antenna, at rest.

    A repeater of all GNSS signals. It affects every aircraft by the power at its antenna.
    """

    at: sky.Enu = sky.param(
        "Position of the antenna that receives, [east_m, north_m, up_m] in metres from the origin or the attack's "
        "anchor: the place that captured receivers report."
    )
    transmitter_m: sky.Enu | None = sky.param(
        "Position of the antenna that transmits, [east_m, north_m, up_m] in metres; default: that of the antenna that "
        "receives.",
        default=None,
    )
    power_dbm: sky.Number = sky.param(
        "Power of each repeated signal (EIRP) in dBm; -30 captures up to 1 km away in free space.",
        default=-30.0, ge=-100, le=60,
    )  # fmt: skip
    delay_ns: sky.Number = sky.param(
        "Delay in cables and amplifiers, in nanoseconds; 100 is 30 m of path.", default=100.0, ge=0, le=1e9
    )
    code_alignment_m: float = 150.0
    doppler_alignment_mps: float = 5.0
    """As the defaults of `gnss.capture`; a repeater can align with nobody."""

    def prepare(self, context: sky.AttackContext) -> None:
        """Place the antennas. Raises `InputError` for one that transmits inside a building."""
        place = self.transmitter_m or self.at
        delay_m = self.delay_ns * 1e-9 * SPEED_OF_LIGHT_MPS
        self.transmit(SimulatedSignals(self.at, (0.0, 0.0, 0.0), delay_m, leads=False), place, self.power_dbm, context)
        self.shown = {"GNSS repeater": place, "its receiving antenna": self.at}
