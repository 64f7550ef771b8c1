"""GNSS capture: one antenna simulates one place, and all receivers in its power report that place."""

from __future__ import annotations

import skyrange.plugin as sky
from skyrange.attack.bases.gnss.fixes import Rate
from skyrange.attack.bases.gnss.takeover import (
    AFTER_CAPTURE,
    ALL_CONSTELLATIONS,
    WHO_IS_CAPTURED,
    Constellations,
    SimulatedSignals,
    Takeover,
)


@sky.attack(
    "gnss.capture",
    effect="several aircraft report one simulated place at once, some after a loss of lock, and leave their paths",
    knowledge="GPS time and the broadcast ephemerides; the place of a victim that it captures without loss of lock",
    equipment="a software radio with one antenna and a simulator for each constellation; gps-sdr-sim has GPS alone",
    placement="the same simulated place from an antenna out of reach, or another place from the same antenna",
    realism={
        **WHO_IS_CAPTURED,
        "alignment": "cited: in code and Doppler (Tippenhauer et al., CCS 2011; Kerns et al., 2014); the limits are "
        "parameters",
        "position and velocity": "simulated: those of the simulated place",
        "time": "assumed: nothing in the range uses the receiver's clock at the scale of its error, below 1 ms",
        **AFTER_CAPTURE,
    },
)
class Capture(Takeover):
    """Captures all GNSS receivers in the power of one antenna, which then report one and the same simulated place."""

    transmitter_m: sky.Enu = sky.place_param("Position of the transmitting antenna")
    at: sky.Enu = sky.place_param("Simulated place at the start of the attack")
    constellations: Constellations = sky.param(
        "Constellations that it simulates: gps, galileo, glonass, beidou. A receiver of all four believes the greater "
        "number of satellites.",
        default=ALL_CONSTELLATIONS,
    )  # fmt: skip
    velocity_mps: Rate = sky.param(
        "Simulated velocity, [east, north, up] in m/s, each from -500 to 500.", default=(0.0, 0.0, 0.0)
    )
    time_error_ns: sky.Number = sky.param(
        "Error of the simulator's time against GPS time, in nanoseconds.", default=0.0, ge=-1e9, le=1e9
    )
    code_alignment_m: sky.Number = sky.param(
        "Largest misalignment of code for a capture without loss of lock, in metres; 150 is half a C/A chip.",
        default=150.0, ge=0, le=100_000,
    )  # fmt: skip
    doppler_alignment_mps: sky.Number = sky.param(
        "Largest misalignment of Doppler for a capture without loss of lock, in m/s; 5 is the pull-in range of a "
        "frequency lock loop with 20 ms of integration (25 Hz).",
        default=5.0, ge=0, le=1_000,
    )  # fmt: skip

    def prepare(self, context: sky.AttackContext) -> None:
        signals = SimulatedSignals(self.at, self.velocity_mps, self.time_error_ns, leads=True)
        self.transmit(signals, self.transmitter_m, context)
        self.shown = {"GNSS spoofer": self.transmitter_m, "simulated place": self.at}
