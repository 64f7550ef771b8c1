"""Sweeping jammer: noise on one channel after another, so that one transmitter disturbs several channels in turn."""

from __future__ import annotations

from skyrange.attack.bases.transmission import Jamming, Noise
from skyrange.attack.contract import ThreatModel
from skyrange.attack.declaration import attack
from skyrange.attack.presets import NEAR_RECEIVERS, noise_controls
from skyrange.contracts.params import Number
from skyrange.contracts.plugins.fields import param


@attack(
    "remote_id.sweep_jam",
    technique="T0814",
    counterfactual="mute",
    surface=("medium",),
    persists="acts",
    effect="receivers miss a share of the broadcasts on every channel, Bluetooth and Wi-Fi alike",
    threat=ThreatModel(
        knowledge="the channels of the band",
        position=NEAR_RECEIVERS,
        equipment="a tunable noise generator for 2.4 GHz with an amplifier",
        budget="all of the time, on one channel at a time, up to 60 dBm",
    ),
    controls=noise_controls(placement="the same jammer on channels that nobody uses, or at another place"),
    realism={
        "missed broadcasts": "simulated: power at each receiver against noise, interference and walls",
        "change of channel": "assumed: at once, and the first 0.1 ms of a dwell without noise",
    },
)
class SweepJam(Jamming):
    """Transmits noise on one channel after another, so that one transmitter disturbs all of them in turn.

    It stays on each channel for a time, in the order given, again and again.
    """

    centres_mhz: tuple[Number, ...] = param(
        "Centres of the channels in MHz, in the order of the sweep; default: the three advertising channels of "
        "Bluetooth and Wi-Fi channel 6.",
        default=(2402.0, 2426.0, 2437.0, 2480.0), min_length=2, max_length=100,
    )  # fmt: skip
    bandwidth_mhz: Number = param("Width of the noise in MHz; narrower noise is denser.", default=2.0, ge=0.1, le=500)
    dwell_ms: Number = param("Time on each channel in milliseconds.", default=5.0, ge=1, le=10_000)

    def noise(self) -> Noise:
        """A burst for each stay on a channel."""
        return Noise(self.centres_mhz, self.bandwidth_mhz, self.dwell_ms)
