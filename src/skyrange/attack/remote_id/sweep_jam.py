"""Sweeping jammer: noise on one channel after another, so that one transmitter disturbs several channels in turn."""

from __future__ import annotations

import skyrange.plugin as sky
from skyrange.attack.bases.transmission import MISSED_BROADCASTS


@sky.attack(
    "remote_id.sweep_jam",
    effect="receivers miss a share of the broadcasts on every channel, Bluetooth and Wi-Fi alike",
    knowledge="the channels of the band",
    equipment="a tunable noise generator for 2.4 GHz with an amplifier",
    budget="all of the time, on one channel at a time, up to 60 dBm",
    placement="the same jammer on channels that nobody uses, or at another place",
    realism={
        **MISSED_BROADCASTS,
        "change of channel": "assumed: at once, and the first 0.1 ms of a dwell without noise",
    },
)
class SweepJam(sky.Jamming):
    """Transmits noise on one channel after another, so that one transmitter disturbs all of them in turn."""

    centres_mhz: tuple[sky.Number, ...] = sky.param(
        "Centres in MHz, in the order of the sweep; default: Bluetooth's advertising channels and Wi-Fi channel 6.",
        default=(2402.0, 2426.0, 2437.0, 2480.0), min_length=2, max_length=100,
    )  # fmt: skip
    bandwidth_mhz: sky.Number = sky.param("Width of the noise in MHz; narrower is denser.", default=2.0, ge=0.1, le=500)
    dwell_ms: sky.Number = sky.param("Time on each channel in milliseconds.", default=5.0, ge=1, le=10_000)

    def noise(self) -> sky.Noise:
        return sky.Noise(self.centres_mhz, self.bandwidth_mhz, self.dwell_ms)
