"""Interference at one receiver of a control link: noise bursts with times, and the power of noise at an instant."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

from skyrange.core import elementary
from skyrange.core.time import Time


class BurstAtReceiver(NamedTuple):
    """A noise burst as one direction of a link meets it."""

    from_ns: Time
    to_ns: Time
    turnaround_ns: Time
    """As `NoiseBurst.turnaround_ns`."""
    receiver_mw: float
    """Power in the receiver's filter."""
    sender_dbm: float
    """Power at the sender, which defers to it."""


class Interference:
    """Thermal noise and the bursts that one direction of a link meets until the next update."""

    __slots__ = ("bursts", "noise_mw")

    def __init__(self, noise_dbm: float) -> None:
        self.noise_mw: float = elementary.exp10(0.1 * noise_dbm)
        self.bursts: list[BurstAtReceiver] = []

    def steady_mw(self, at: Time) -> float:
        """Noise at an instant, without that of reactive jammers."""
        total: float = self.noise_mw
        for burst in self.bursts:
            if not burst.turnaround_ns and burst.from_ns <= at < burst.to_ns:
                total += burst.receiver_mw
        return total

    def pieces(self, start: Time, end: Time) -> list[tuple[float, float]]:
        """The noise during a frame from `start` to `end`, in pieces: (share of the frame, power in mW)."""
        if not self.bursts:
            return [(1.0, self.noise_mw)]
        spans = []
        for burst in self.bursts:
            begin = max(burst.from_ns, start + burst.turnaround_ns)
            finish = min(burst.to_ns, end)
            if begin < finish:
                spans.append((begin, finish, burst.receiver_mw))
        cuts = sorted({start, end, *(span[0] for span in spans), *(span[1] for span in spans)})
        pieces = []
        for left, right in pairwise(cuts):
            power = self.noise_mw + math.fsum(mw for begin, finish, mw in spans if begin <= left and right <= finish)
            pieces.append(((right - left) / (end - start), power))
        return pieces

    def idle_from(self, at: Time, busy_dbm: float) -> Time:
        """The first instant from `at` on at which no burst makes the sender's channel busy."""
        moved = True
        while moved:
            moved = False
            for burst in self.bursts:
                if not burst.turnaround_ns and burst.sender_dbm >= busy_dbm and burst.from_ns <= at < burst.to_ns:
                    at, moved = burst.to_ns, True
        return at
