"""Noise bursts of jammers as radios of control links meet them, in a receiver's band."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from skyrange.contracts.medium import Ints, RadioTable
from skyrange.core import elementary
from skyrange.core.time import Time
from skyrange.radio.control_link.interference import BurstAtReceiver
from skyrange.radio.control_link.propagation import Propagation
from skyrange.radio.control_link.wifi_link import Transmitter
from skyrange.radio.control_link.wifi_rates import PREAMBLE_DBM
from skyrange.radio.phy import filter_overlap
from skyrange.radio.spectrum import NoiseBurst


class NoiseAtRadios:
    """The noise bursts of jammers at some radios, in a receiver's band."""

    def __init__(
        self,
        bursts: Sequence[NoiseBurst],
        propagation: Propagation,
        radios: RadioTable,
        rows: Sequence[int],
        *,
        centre_mhz: float,
        width_mhz: float,
        now: Time,
    ) -> None:
        self._bursts = [
            burst
            for burst in bursts
            if burst.to_ns > now and filter_overlap(burst.centre_mhz, burst.width_mhz, centre_mhz, width_mhz) > 0.0
        ]
        self._column = {row: column for column, row in enumerate(rows)}
        self._gains = np.zeros((0, len(rows)))
        if self._bursts:
            jammers: Ints = np.repeat(np.array([burst.radio for burst in self._bursts]), len(rows))
            victims: Ints = np.tile(np.array(rows), len(self._bursts))
            self._gains = propagation.gains_db(radios, jammers, victims, centre_mhz, now).reshape(-1, len(rows))
        self._shares = [filter_overlap(b.centre_mhz, b.width_mhz, centre_mhz, width_mhz) for b in self._bursts]

    def at(self, sender: int, receiver: int, power_dbm: float = math.inf) -> list[BurstAtReceiver]:
        """The bursts for frames of `power_dbm` from the row `sender` to the row `receiver`.

        A reactive jammer that does not hear such a frame is left out.
        """
        received = []
        for place, burst in enumerate(self._bursts):
            sent_db, received_db = self._gains[place, self._column[sender]], self._gains[place, self._column[receiver]]
            if burst.turnaround_ns and power_dbm + sent_db < PREAMBLE_DBM:
                continue
            in_filter_dbm = burst.power_dbm + 10.0 * elementary.log10(self._shares[place])
            received.append(
                BurstAtReceiver(
                    burst.from_ns,
                    burst.to_ns,
                    burst.turnaround_ns,
                    elementary.exp10(0.1 * (in_filter_dbm + received_db)),
                    in_filter_dbm + sent_db,
                )
            )
        return received

    def between(self, sender: Transmitter, receiver: Transmitter) -> list[BurstAtReceiver]:
        """The same for two radios of a Wi-Fi link."""
        return self.at(sender.row, receiver.row, sender.power_dbm)
