"""Jamming bursts: noise that jammers order of their radios, as emitters of the medium."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skyrange.codec.remote_id import noise_request
from skyrange.contracts.medium import EmitterTable
from skyrange.core.errors import DecodeError
from skyrange.core.time import NS_PER_MS, NS_PER_US, Time
from skyrange.radio.spectrum import NoiseBurst

MAX_BURSTS = 1_000
"""Bursts at once; further ones are not radiated."""
MAX_DBM = 90.0
RENEWAL_NS: Time = 100 * NS_PER_MS
"""Noise that the next order continues is expected to last this much longer; the order comes with a delay."""


@dataclass(slots=True)
class _Burst:
    """One burst, when it is on the air, and when it is for those who cannot go back to the time of the request."""

    radio: int
    start: Time
    end: Time
    known_start: Time
    known_end: Time
    request: noise_request.NoiseRequest

    @property
    def reactive(self) -> bool:
        """Whether it is noise only while a frame is on the air."""
        return self.request.turnaround_us not in (0, noise_request.CONTINUED)

    def continued_by(self, other: _Burst) -> bool:
        """Whether `other` is a later order of the same radio for the same band, which ends this one if it is known."""
        request, other_request = self.request, other.request
        same = self.radio == other.radio and request.bssid == other_request.bssid
        same &= (request.centre_khz, request.bandwidth_khz) == (other_request.centre_khz, other_request.bandwidth_khz)
        return same and bool(request.turnaround_us) and self.start < other.start


class JammingBursts:
    """The bursts that are on. Deep-copyable."""

    __slots__ = ("_bursts", "changed")

    def __init__(self) -> None:
        self._bursts: list[_Burst] = []
        self.changed = False
        """Whether the emitters have changed since they were last requested."""

    def request(self, now: Time, radio: int, at: Time, payload: bytes) -> bool:
        """Take, at `now`, the request of a burst that reached a radio at `at`; `False` for any other payload, and for
        one burst too many.
        """
        try:
            request = noise_request.unpack(payload)
        except DecodeError:
            return False
        if len(self._bursts) >= MAX_BURSTS or request.power_cdbm > MAX_DBM * 100:
            return False
        length = request.duration_us * NS_PER_US
        expected = RENEWAL_NS if request.turnaround_us == noise_request.CONTINUED else 0
        burst = _Burst(radio, at, at + length, now, now + length + expected, request)
        for earlier in self._bursts:
            if earlier.continued_by(burst):
                earlier.known_end = min(earlier.known_end, burst.known_start)
        self._bursts.append(burst)
        self.changed = True
        return True

    def bursts(self) -> list[NoiseBurst]:
        """Every burst that `emitters` did not forget, those of reactive jammers too, at the times when it is known."""
        return [
            NoiseBurst(
                burst.radio, burst.request.centre_khz / 1e3, burst.request.bandwidth_khz / 1e3,
                burst.request.power_cdbm / 100.0, burst.known_start, burst.known_end,
                burst.request.turnaround_us * NS_PER_US if burst.reactive else 0,
                burst.request.bssid if burst.reactive else b"", burst.request.follow_ms * NS_PER_MS,
            )
            for burst in self._bursts
        ]  # fmt: skip

    def emitters(self, now: Time) -> EmitterTable:
        """The emitters that are on or scheduled; those that have ended are forgotten.

        Reactive jammers are left out: they react to frames of control links, and a medium has none of these.
        """
        self.changed = False
        self._bursts = [burst for burst in self._bursts if burst.known_end > now]
        steady = [burst for burst in self._bursts if burst.end > now and not burst.reactive]
        orders = [burst.request for burst in steady]
        numbers = np.array([[b.centre_khz, b.bandwidth_khz, b.power_cdbm] for b in orders], dtype=np.float64)
        numbers = numbers.reshape(-1, 3)
        times = np.array([(b.radio, b.start, b.end) for b in steady], dtype=np.int64).reshape(-1, 3)
        return EmitterTable(
            times[:, 0], numbers[:, 0] / 1e3, numbers[:, 1] / 1e3, numbers[:, 2] / 100.0, times[:, 1], times[:, 2]
        )
