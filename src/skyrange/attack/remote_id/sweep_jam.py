"""Sweeping jammer: noise on one channel after another, so that one transmitter disturbs several channels in turn."""

from __future__ import annotations

from pydantic import Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.remote_id.jam import make_jammer
from skyrange.contracts.params import Enu, Number, Params


class SweepJam(Params):
    """Noise that stays on each channel for a time, in the order given, again and again."""

    transmitter_m: Enu = Field(
        description="Position of the jammer, [east_m, north_m, up_m] in metres from the origin or the attack's anchor."
    )
    power_dbm: Number = Field(default=30.0, ge=-30, le=60, description="Radiated power (EIRP) in dBm.")
    centres_mhz: tuple[Number, ...] = Field(
        default=(2402.0, 2426.0, 2437.0, 2480.0),
        min_length=2,
        max_length=100,
        description="Centres of the channels in MHz, in the order of the sweep; default: the three advertising "
        "channels of Bluetooth and Wi-Fi channel 6.",
    )
    bandwidth_mhz: Number = Field(
        default=2.0, ge=0.1, le=500, description="Width of the noise in MHz; narrower noise is denser."
    )
    dwell_ms: Number = Field(default=5.0, ge=1, le=10_000, description="Time on each channel in milliseconds.")


def make(params: SweepJam, context: AttackContext) -> Attack:
    """The attack."""
    return make_jammer(
        context, params.transmitter_m, params.power_dbm, params.centres_mhz, params.bandwidth_mhz, params.dwell_ms
    )


SWEEP_JAM = AttackPlugin(
    SweepJam,
    make,
    "Transmits noise on one channel after another, so that one transmitter disturbs all of them in turn.",
    technique="T0814",
    counterfactual="mute",
    surface=("medium",),
    persists="acts",
    effect="receivers miss a share of the broadcasts on every channel, Bluetooth and Wi-Fi alike",
    threat=ThreatModel(
        knowledge="the channels of the band",
        position="within some hundred metres of the receivers, by power and walls",
        equipment="a tunable noise generator for 2.4 GHz with an amplifier",
        budget="all of the time, on one channel at a time, up to 60 dBm",
    ),
    controls=Controls(
        load="none, because the noise is the attack; the sham has the same bursts at −200 dBm",
        content="none, because noise has no content",
        placement="the same jammer on channels that nobody uses, or at another place",
    ),
    realism={
        "missed broadcasts": "simulated: power at each receiver against noise, interference and walls",
        "change of channel": "assumed: at once, and the first 0.1 ms of a dwell without noise",
    },
)
