"""Reactive jammers that follow an access point to the channel to which it has gone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from skyrange.contracts.medium import Floats
from skyrange.core.time import Time
from skyrange.radio.control_link.propagation import Propagation
from skyrange.radio.control_link.wifi_link import Transmitter
from skyrange.radio.control_link.wifi_rates import PREAMBLE_DBM
from skyrange.radio.phy.channels import centre_mhz
from skyrange.radio.phy.waveforms import OFDM
from skyrange.radio.spectrum import NoiseBurst


class FollowingJammers:
    """The channels on which such jammers are, by radio and access point. Deep-copyable.

    A jammer whose access point has left scans, and finds it when it has been on its new channel for the jammer's search
    time, if it hears it there with -82 dBm. An access point that leaves sooner is not found.
    """

    def __init__(self, stations: Sequence[Transmitter]) -> None:
        self._stations = {station.address: station for station in stations}
        self._centres: dict[tuple[int, bytes], float] = {}

    def tune(
        self,
        now: Time,
        bursts: Sequence[NoiseBurst],
        propagation: Mapping[float, Propagation],
        pos: Floats,
        vel: Floats,
    ) -> Sequence[NoiseBurst]:
        """The bursts, those of jammers that follow on the channel where they are now."""
        if not any(burst.bssid for burst in bursts):
            return bursts
        return [self._tune(now, burst, propagation, pos, vel) if burst.bssid else burst for burst in bursts]

    def _tune(
        self, now: Time, burst: NoiseBurst, propagation: Mapping[float, Propagation], pos: Floats, vel: Floats
    ) -> NoiseBurst:
        key = burst.radio, burst.bssid
        at = self._centres.setdefault(key, burst.centre_mhz)
        station = self._stations.get(burst.bssid)
        if station is not None and now - station.channel_since >= burst.follow_ns:
            centre = centre_mhz(OFDM, station.channel)
            if centre != at:
                rows = np.array([burst.radio]), np.array([station.row])
                gain = propagation[centre].gains_db(pos, vel, *rows, centre, now).item()
                if station.power_dbm + gain >= PREAMBLE_DBM:
                    at = self._centres[key] = centre
        return burst._replace(centre_mhz=at)
