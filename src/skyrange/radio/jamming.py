"""Jamming bursts: noise that jammers order of their radios, as emitters of the medium."""

from __future__ import annotations

import numpy as np

from skyrange.codec.remote_id import noise_request
from skyrange.contracts.medium import EmitterTable
from skyrange.core.errors import DecodeError
from skyrange.core.time import NS_PER_US, Time
from skyrange.radio.spectrum import NoiseBurst

MAX_BURSTS = 1_000
"""Bursts at once; further ones are not radiated."""
MAX_DBM = 90.0


class JammingBursts:
    """The bursts that are on. Deep-copyable."""

    __slots__ = ("_bursts", "changed")

    def __init__(self) -> None:
        self._bursts: list[tuple[int, Time, Time, noise_request.NoiseRequest]] = []
        self.changed = False
        """Whether the emitters have changed since they were last requested."""

    def request(self, radio: int, at: Time, payload: bytes) -> bool:
        """Take the request of a burst that reached a radio; `False` for any other payload, and for
        one burst too many.
        """
        try:
            burst = noise_request.unpack(payload)
        except DecodeError:
            return False
        if len(self._bursts) >= MAX_BURSTS or burst.power_cdbm > MAX_DBM * 100:
            return False
        self._bursts.append((radio, at, at + burst.duration_us * NS_PER_US, burst))
        self.changed = True
        return True

    def bursts(self) -> list[NoiseBurst]:
        """Every burst that `emitters` did not forget, those of reactive jammers too."""
        return [
            NoiseBurst(
                radio, b.centre_khz / 1e3, b.bandwidth_khz / 1e3, b.power_cdbm / 100.0, start, end,
                b.turnaround_us * NS_PER_US,
            )
            for radio, start, end, b in self._bursts
        ]  # fmt: skip

    def emitters(self, now: Time) -> EmitterTable:
        """The emitters that are on or scheduled; those that have ended are forgotten.

        Reactive jammers are left out: they react to frames of control links, and a medium has none of these.
        """
        self.changed = False
        self._bursts = [burst for burst in self._bursts if burst[2] > now]
        steady = [burst for burst in self._bursts if not burst[3].turnaround_us]
        numbers = np.array([[b.centre_khz, b.bandwidth_khz, b.power_cdbm] for *_, b in steady], dtype=np.float64)
        numbers = numbers.reshape(-1, 3)
        times = np.array([burst[:3] for burst in steady], dtype=np.int64).reshape(-1, 3)
        return EmitterTable(
            times[:, 0], numbers[:, 0] / 1e3, numbers[:, 1] / 1e3, numbers[:, 2] / 100.0, times[:, 1], times[:, 2]
        )
