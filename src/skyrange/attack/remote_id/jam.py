"""Jamming: noise in a band, continuous or pulsed, from a transmitter of the attacker."""

from __future__ import annotations

import skyrange.plugin as sky


@sky.attack(
    "remote_id.jam",
    effect="receivers near the transmitter miss broadcasts, and senders defer",
    knowledge="the channel in use",
    equipment="a noise generator for 2.4 GHz with an amplifier",
    budget="airtime by duty, up to 60 dBm",
    placement="the same jammer on another channel or at another place",
)
class Jam(sky.Jamming):
    """Transmits noise over the band, so that receivers miss broadcasts.

    The noise has an even power density over the band.
    """

    centre_mhz: sky.Number = sky.param("Centre in MHz; 2437 is Wi-Fi channel 6.", default=2437.0, ge=100, le=8000)
    bandwidth_mhz: sky.Number = sky.param("Width of the band in MHz.", default=20.0, ge=0.1, le=500)
    period_ms: sky.Number = sky.param("Time from burst to burst, in milliseconds.", default=100.0, ge=1, le=10_000)
    duty: sky.Number = sky.param("Share of time in which it transmits; 1 is continuous.", default=1.0, gt=0, le=1)

    def noise(self) -> sky.Noise:
        return sky.Noise([self.centre_mhz], self.bandwidth_mhz, self.period_ms, self.duty)
