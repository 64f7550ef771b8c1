"""GNSS meaconing: authentic signals are repeated with a delay, and receivers report the place of the repeater."""

from __future__ import annotations

from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.gnss.emitter import SPEED_OF_LIGHT_MPS, emitter_at
from skyrange.attack.gnss.takeover import CapturedReceivers, Requirements, SimulatedSignals, Takeover
from skyrange.contracts.params import Enu, Number
from skyrange.core.time import from_seconds


class Meacon(Takeover):
    """A repeater of all GNSS signals. It affects every aircraft by the power at its antenna."""

    at: Enu = Field(
        description="Position of the antenna that receives, [east_m, north_m, up_m] in metres from the origin or the "
        "attack's anchor: the place that captured receivers report."
    )
    transmitter_m: Enu | None = Field(
        default=None,
        description="Position of the antenna that transmits, [east_m, north_m, up_m] in metres; default: that of the "
        "antenna that receives.",
    )
    power_dbm: Number = Field(
        default=-30.0,
        ge=-100,
        le=60,
        description="Power of each repeated signal (EIRP) in dBm; -30 captures up to 1 km away in free space.",
    )
    delay_ns: Number = Field(
        default=100.0,
        ge=0,
        le=1e9,
        description="Delay in cables and amplifiers, in nanoseconds; 100 is 30 m of path.",
    )


HALF_CHIP_M = 150.0
DOPPLER_MPS = 5.0
"""Largest misalignments without loss of lock, as the defaults of `gnss.capture`; a repeater can align with nobody."""


def make(params: Meacon, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for a transmitter inside a building."""
    place = params.transmitter_m or params.at
    delay_m = params.delay_ns * 1e-9 * SPEED_OF_LIGHT_MPS
    fault = CapturedReceivers(
        f"{context.id}.gnss",
        tuple(sorted(context.vehicles)),
        emitter_at(place, params.power_dbm, params.wall_loss_db, context),
        SimulatedSignals(params.at, (0.0, 0.0, 0.0), delay_m, leads=False),
        Requirements(params.advantage_db, HALF_CHIP_M, DOPPLER_MPS, from_seconds(params.reacquire_s)),
        context.schedule,
        context.sham,
    )
    shown = {"GNSS repeater": place, "its receiving antenna": params.at}
    return Attack(faults=[fault], shown=shown, exclusive=fault.exclusive)


MEACON = AttackPlugin(
    Meacon,
    make,
    "Repeats the authentic GNSS signals, so that receivers in its power report the place of its own antenna, at rest.",
    technique="EX-0014.04",
    counterfactual="mute",
    surface=("gnss",),
    persists="acts",
    effect="receivers lose lock, then report the place of the repeater's antenna at rest, with a delayed clock",
    threat=ThreatModel(
        knowledge="nothing: it needs neither codes nor ephemerides, so encrypted signals are repeated too",
        position="in line of sight of the victims' antennas: 1 km at -30 dBm per signal",
        equipment="a GNSS antenna, an amplifier of some 100 dB and a second antenna, isolated from the first",
        budget="microwatts per signal, for as long as it acts",
    ),
    controls=Controls(
        load="none, because a repeated signal takes no airtime of the range's links",
        content="the sham: the same receivers are captured at the same times, with unaltered fixes",
        placement="the same repeater with its receiving antenna elsewhere",
    ),
    realism={
        "who is captured": "cited: 2 dB over the authentic signals (Tippenhauer et al., CCS 2011), in free space and "
        "behind walls",
        "loss of lock": "cited: the repeated code is misaligned by place, path and delay (Tippenhauer et al., CCS "
        "2011); half a C/A chip assumed as the limit",
        "position and velocity": "simulated: the place of the receiving antenna at rest, without receiver noise",
        "clock bias": "assumed: path and delay, below 1 ms, which nothing in the range uses",
        "satellites, claimed accuracy": "assumed: unaltered once captured",
        "alarm of the receiver": "assumed: none",
        "after the attack": "assumed: the authentic fix is back at once",
    },
)
