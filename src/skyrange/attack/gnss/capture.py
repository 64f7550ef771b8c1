"""GNSS capture: one antenna simulates one place, and all receivers in its power report that place."""

from __future__ import annotations

from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.gnss.emitter import SPEED_OF_LIGHT_MPS, emitter_at
from skyrange.attack.gnss.false_fixes import Rate
from skyrange.attack.gnss.takeover import CapturedReceivers, Requirements, SimulatedSignals, Takeover
from skyrange.contracts.params import Enu, Number
from skyrange.core.time import from_seconds


class Capture(Takeover):
    """A GNSS simulator with one antenna. It affects every aircraft by the power at its antenna."""

    transmitter_m: Enu = Field(
        description="Position of the transmitting antenna, [east_m, north_m, up_m] in metres from the origin or the "
        "attack's anchor."
    )
    at: Enu = Field(
        description="Simulated place at the start of the attack, [east_m, north_m, up_m] in metres from the origin or "
        "the attack's anchor."
    )
    velocity_mps: Rate = Field(
        default=(0.0, 0.0, 0.0),
        description="Simulated velocity, [east, north, up] in m/s, each from -500 to 500.",
    )
    power_dbm: Number = Field(
        default=-30.0,
        ge=-100,
        le=60,
        description="Power of each simulated signal (EIRP) in dBm; -30 captures up to 1 km away in free space.",
    )
    time_error_ns: Number = Field(
        default=0.0,
        ge=-1e9,
        le=1e9,
        description="Error of the simulator's time against GPS time, in nanoseconds.",
    )
    code_alignment_m: Number = Field(
        default=150.0,
        ge=0,
        le=100_000,
        description="Largest misalignment of code for a capture without loss of lock, in metres; 150 is half a C/A "
        "chip.",
    )
    doppler_alignment_mps: Number = Field(
        default=5.0,
        ge=0,
        le=1_000,
        description="Largest misalignment of Doppler for a capture without loss of lock, in m/s; 5 is the pull-in "
        "range of a frequency lock loop with 20 ms of integration (25 Hz).",
    )


def make(params: Capture, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for a transmitter inside a building."""
    delay_m = params.time_error_ns * 1e-9 * SPEED_OF_LIGHT_MPS
    fault = CapturedReceivers(
        f"{context.id}.gnss",
        tuple(sorted(context.vehicles)),
        emitter_at(params.transmitter_m, params.power_dbm, params.wall_loss_db, context),
        SimulatedSignals(params.at, params.velocity_mps, delay_m, leads=True),
        Requirements(
            params.advantage_db, params.code_alignment_m, params.doppler_alignment_mps, from_seconds(params.reacquire_s)
        ),
        context.schedule,
        context.sham,
    )
    shown = {"GNSS spoofer": params.transmitter_m, "simulated place": params.at}
    return Attack(faults=[fault], shown=shown, exclusive=fault.exclusive)


CAPTURE = AttackPlugin(
    Capture,
    make,
    "Captures all GNSS receivers in the power of one antenna, which then report one and the same simulated place.",
    technique="EX-0014.04",
    counterfactual="mute",
    surface=("gnss",),
    persists="acts",
    effect="several aircraft report one simulated place at once, some after a loss of lock, and leave their paths",
    threat=ThreatModel(
        knowledge="GPS time and the broadcast ephemerides; the place of a victim that it captures without loss of lock",
        position="in line of sight of the victims' antennas: 1 km at -30 dBm per signal",
        equipment="a software radio with a GPS signal simulator and one antenna",
        budget="microwatts per signal, for as long as it acts",
    ),
    controls=Controls(
        load="none, because a spoofed signal takes no airtime of the range's links",
        content="the sham: the same receivers are captured at the same times, with unaltered fixes",
        placement="the same simulated place from an antenna out of reach, or another place from the same antenna",
    ),
    realism={
        "who is captured": "cited: 2 dB over the authentic signals (Tippenhauer et al., CCS 2011), in free space and "
        "behind walls",
        "seamless capture or loss of lock": "cited: alignment in code and Doppler (Tippenhauer et al., CCS 2011; Kerns "
        "et al., 2014); the limits are parameters",
        "position and velocity": "simulated: those of the simulated place, without receiver noise",
        "time": "assumed: nothing in the range uses the receiver's clock at the scale of its error, below 1 ms",
        "satellites, claimed accuracy": "assumed: unaltered once captured, as of a sky that is simulated whole",
        "alarm of the receiver": "assumed: none",
        "after the attack": "assumed: the authentic fix is back at once",
    },
)
