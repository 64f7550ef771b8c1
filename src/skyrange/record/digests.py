"""Digests of a run: `frames`, `truth` and `events`, combined in one fingerprint.

`frames` and `truth` are sums modulo 2**128 of one hash per row, so they depend neither on the order of recording nor
on a division into shards. They distinguish runs. They do not protect against forgery, because rows with a given sum
can be searched for. `events` contains no times, so it is comparable between machines.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import blake2b
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyrange.core.compiled import compiled

Words = NDArray[np.uint64]

_MODULUS = 1 << 128
_8, _16, _24, _32, _40, _48, _56 = (np.uint64(bits) for bits in range(8, 57, 8))
_30, _27, _31, _33 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(33)
# One of the two words is mixed as in SplitMix64 (Steele, Lea & Flood, OOPSLA 2014, doi 10.1145/2660193.2660195, with
# the constants of Stafford's variant 13), the other as in MurmurHash3's fmix64 (Appleby, public domain).
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_S1, _S2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_F1, _F2 = np.uint64(0xFF51AFD7ED558CCD), np.uint64(0xC4CEB9FE1A85EC53)


@compiled
def _mix(a: np.uint64, b: np.uint64, word: np.uint64) -> tuple[np.uint64, np.uint64]:
    """Both hash words after one more word of input."""
    a = (a ^ word) + _GOLDEN
    a = (a ^ (a >> _30)) * _S1
    a = (a ^ (a >> _27)) * _S2
    a = a ^ (a >> _31)
    b = b + word * _S1 + _GOLDEN
    b = (b ^ (b >> _33)) * _F1
    b = (b ^ (b >> _33)) * _F2
    b = b ^ (b >> _33)
    return a, b


@compiled
def _sum_rows(words: Words) -> tuple[np.uint64, np.uint64]:
    """The sum modulo 2**128 of the rows' 128-bit hashes, as (high, low) words; `words` is (rows, columns)."""
    high = np.uint64(0)
    low = np.uint64(0)
    for row in range(words.shape[0]):
        a = _GOLDEN
        b = _F1
        for column in range(words.shape[1]):
            a, b = _mix(a, b, words[row, column])
        before = low
        low = low + b
        high = high + a
        if low < before:
            high = high + np.uint64(1)
    return high, low


def hash_rows(words: Words) -> int:
    """Sum modulo 2**128 of the hashes of the rows of `words`, shape (rows, columns) of uint64."""
    high, low = _sum_rows(np.ascontiguousarray(words, dtype=np.uint64))
    return (int(high) << 64) | int(low)


@compiled
def hash_bytes(data: NDArray[np.uint8], start: int, size: int) -> tuple[np.uint64, np.uint64]:
    """A two-word hash of `data[start : start + size]`, mixed like the rows, in words of eight bytes, little endian."""
    a = _GOLDEN ^ np.uint64(size)
    b = _F1 + np.uint64(size)
    at = start
    end = start + size
    while at + 8 <= end:  # written out so that the compiler makes it one load
        word = (
            np.uint64(data[at]) | np.uint64(data[at + 1]) << _8 | np.uint64(data[at + 2]) << _16
            | np.uint64(data[at + 3]) << _24 | np.uint64(data[at + 4]) << _32 | np.uint64(data[at + 5]) << _40
            | np.uint64(data[at + 6]) << _48 | np.uint64(data[at + 7]) << _56
        )  # fmt: skip
        at += 8
        a, b = _mix(a, b, word)
    if at < end:
        word = np.uint64(0)
        for place in range(end - at):
            word |= np.uint64(data[at + place]) << np.uint64(8 * place)
        a, b = _mix(a, b, word)
    return a, b


@dataclass(slots=True)
class EventChains:
    """Events by the vehicle that they concern: (time, source, kind), in order of recording."""

    about: dict[str, list[tuple[int, str, str]]] = field(default_factory=dict)

    def add(self, about: str, time_ns: int, source: str, kind: str) -> None:
        """Add one event."""
        self.about.setdefault(about, []).append((time_ns, source, kind))

    def hex(self) -> str:
        """The digest over all vehicles by id: of each, a hash chain over its event kinds by time, source and order."""
        whole = blake2b(digest_size=16)
        for about in sorted(self.about):
            chain = b""
            for _, _, kind in sorted(self.about[about], key=_time_and_source):
                chain = blake2b(chain + kind.encode(), digest_size=16).digest()
            whole.update(len(about.encode()).to_bytes(4, "little") + about.encode() + chain)
        return whole.hexdigest()


def _time_and_source(event: tuple[int, str, str]) -> tuple[int, str]:
    return event[0], event[1]


@dataclass(slots=True)
class Digests:
    """A run's digests while it is recorded: plain data, so copies are independent and shards can be added.

    The sum of the digests of two shards is the digest of the whole run, in either order, provided that no source
    notes events about one vehicle in both shards at the same time.
    """

    frames_sum: int = 0
    truth_sum: int = 0
    event_chains: EventChains = field(default_factory=EventChains)

    def add_frames(self, words: Words) -> None:
        """Add rows of frames, (n, columns) as `FrameEncoder` lays them out."""
        self.frames_sum = (self.frames_sum + hash_rows(words)) % _MODULUS

    def add_truth(self, words: Words) -> None:
        """Add rows of truth, (n, columns) as `truth_words` lays them out."""
        self.truth_sum = (self.truth_sum + hash_rows(words)) % _MODULUS

    def add_event(self, about: str, time_ns: int, source: str, kind: str) -> None:
        """Add an event; its time orders the events of one vehicle and is not hashed."""
        self.event_chains.add(about, time_ns, source, kind)

    def __add__(self, other: Digests) -> Digests:
        merged: dict[str, list[tuple[int, str, str]]] = {}
        for part in (self.event_chains.about, other.event_chains.about):
            for about, events in part.items():
                merged.setdefault(about, []).extend(events)
        return Digests(
            (self.frames_sum + other.frames_sum) % _MODULUS,
            (self.truth_sum + other.truth_sum) % _MODULUS,
            EventChains(merged),
        )

    def to_plain(self) -> dict[str, Any]:
        """The state as plain data, for another process."""
        return {"frames": self.frames_sum, "truth": self.truth_sum, "events": self.event_chains.about}

    @classmethod
    def from_plain(cls, data: Mapping[str, Any]) -> Digests:
        """The digests of which `to_plain` made `data`."""
        about = {
            name: [(int(at), str(who), str(kind)) for at, who, kind in rows] for name, rows in data["events"].items()
        }
        return cls(int(data["frames"]), int(data["truth"]), EventChains(about))

    @property
    def events(self) -> str:
        """32 hex digits: kinds of events and their order per vehicle, without times."""
        return self.event_chains.hex()

    @property
    def frames(self) -> str:
        """32 hex digits: every frame's identity, times, fate, payload, parent and causes."""
        return f"{self.frames_sum:032x}"

    @property
    def truth(self) -> str:
        """32 hex digits: the bit pattern of every recorded truth row."""
        return f"{self.truth_sum:032x}"

    @property
    def fingerprint(self) -> str:
        """32 hex digits: BLAKE2b over the three digests."""
        return combine_digests([self.events, self.frames, self.truth])

    def to_dict(self) -> dict[str, str]:
        """The manifest's `digests`."""
        return {
            "events": self.events,
            "frames": self.frames,
            "truth": self.truth,
            "fingerprint": self.fingerprint,
        }


def combine_digests(digests: Sequence[str]) -> str:
    """One digest over several, in their order: 32 hex digits."""
    return blake2b("\n".join(digests).encode(), digest_size=16).hexdigest()
