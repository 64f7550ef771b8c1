"""Verification of Remote ID by many receivers: a verdict on each sender that each of them hears.

A receiver asks `believes` before it acts on a track. Verdicts are told when they change (`changes`), so that a record
shows when a sender became trusted.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Final, NamedTuple

from skyrange.codec.drip import EntityTag, since_2019_s
from skyrange.contracts.alerts import Scalar
from skyrange.core.errors import DecodeError
from skyrange.core.ids import FrameId
from skyrange.core.time import NS_PER_S, NS_PER_US, Time, to_seconds
from skyrange.core.whole_numbers import worth_noting
from skyrange.remoteid.drip.verification.observed_sender import is_located
from skyrange.remoteid.drip.verification.observer import Observer
from skyrange.remoteid.drip.verification.verdicts import (
    Acceptance,
    Judged,
    Track,
    Trust,
    Verification,
    Verified,
    accepts,
)

_US_PER_S: Final = NS_PER_S // NS_PER_US
MAX_EARLY: Final = 256
"""Broadcasts that a receiver holds until its clock is set; the oldest make room."""
MAX_TOLD: Final = 256
"""Changes that one receiver tells one by one; then only the 512th, 1024th …: a bound for floods."""


class VerdictChange(NamedTuple):
    """A sender's state has changed at a receiver."""

    row: int
    """Of the receiver."""
    address: int
    """48 bits."""
    state: Trust
    was: Trust | None
    """`None`: it was not heard before."""
    tag: bytes | None
    first_ns: Time
    """When it was first heard."""
    at_ns: Time
    """When what changed it was received."""
    number: int
    """Changes at this receiver so far."""
    cause: FrameId | None

    @property
    def data(self) -> dict[str, Scalar]:
        """What the record says of it."""
        return {
            "address": f"{self.address:012x}",
            "tag": printable_tag(self.tag),
            "state": str(self.state),
            "was": str(self.was or ""),
            "first_s": to_seconds(self.first_ns),
            "at_s": to_seconds(self.at_ns),
            "count": self.number,
        }


class _Broadcast(NamedTuple):
    at_ns: Time
    address: int
    counter: int
    body: bytes
    cause: FrameId | None


class _Sender:
    __slots__ = ("first_ns", "state")

    def __init__(self, first_ns: Time) -> None:
        self.first_ns = first_ns
        self.state: Trust | None = None


class Verifier:
    """The observers of many receivers. Deep-copyable; what one receiver concludes depends on no other."""

    def __init__(self, receivers: Sequence[Verification | None]) -> None:
        """`None`: a receiver that does not verify, and believes everything."""
        self._receivers = tuple(receivers)
        self._observers = {
            row: Observer(receiver.anchors, receiver.judges)
            for row, receiver in enumerate(receivers)
            if receiver is not None
        }
        self._clocks_us = [-1] * len(receivers)
        """UTC minus range time, in µs."""
        self._senders: dict[int, dict[int, _Sender]] = {row: {} for row in self._observers}
        self._early: dict[int, deque[_Broadcast]] = {row: deque(maxlen=MAX_EARLY) for row in self._observers}
        """Received before the clock was set."""
        self._told = [0] * len(receivers)
        self._changes: list[VerdictChange] = []

    @property
    def rows(self) -> tuple[int, ...]:
        """The receivers that verify."""
        return tuple(self._observers)

    def filters(self, row: int) -> bool:
        """Whether a receiver verifies and does not believe everybody."""
        verification = self._receivers[row]
        return verification is not None and verification.acceptance is not Acceptance.ACCEPT

    def set_clock(self, row: int, now: Time, clock_us: int) -> None:
        """Tell what a receiver takes for UTC now, in µs since 1970; -1 (unknown) changes nothing.

        What it received before its clock was set is judged when it is set, by the times of reception.
        """
        if clock_us >= 0:
            self._clocks_us[row] = clock_us - now // 1000
            early = self._early.get(row)
            while early:
                self._take(row, early.popleft())

    def receive(
        self, row: int, at_ns: Time, address: bytes, counter: int, body: bytes, cause: FrameId | None = None
    ) -> Judged:
        """Take a broadcast that a receiver decoded; one that does not verify ignores it."""
        if row not in self._observers:
            return Judged()
        return self._take(row, _Broadcast(at_ns, int.from_bytes(address, "big"), counter, body, cause))

    def review(self, now: Time) -> None:
        """Judge all senders again, because verdicts end."""
        for row, senders in self._senders.items():
            clock_s = self._clock_s(row, now)
            if clock_s is not None:
                for address in list(senders):
                    self._judge(row, address, now, clock_s, None)

    def changes(self) -> list[VerdictChange]:
        """The changes since the last call, without those beyond the bound."""
        changes, self._changes = self._changes, []
        return changes

    def track(self, row: int, address: int, now: Time) -> Track | None:
        """What a receiver holds of a sender; `None` if nothing."""
        observer, clock_s = self._observers.get(row), self._clock_s(row, now)
        return None if observer is None or clock_s is None else observer.track(address, clock_s)

    def trust(self, row: int, address: int, now: Time) -> Trust:
        """The state of a sender at a receiver."""
        track = self.track(row, address, now)
        return Trust.NONE if track is None else track.state

    def believes(self, row: int, address: int, now: Time) -> bool:
        """Whether a receiver's policy is to act on what a sender says; one that does not verify believes everybody."""
        verification = self._receivers[row]
        return verification is None or accepts(verification.acceptance, self.trust(row, address, now))

    def disbelieves(self, row: int, now: Time, address: int) -> bool:
        """Whether a receiver's policy is to ignore all that a sender says, also what is verified of it."""
        return not self.believes(row, address, now) and self.trust(row, address, now) is not Trust.CONTRADICTED

    def acts_on(self, row: int, address: int, now: Time, judged: Judged) -> bool:
        """Whether a receiver's policy is to act on a broadcast when it receives it.

        Of an address that several use, it acts on what is verified alone: `release`.
        """
        return not self.filters(row) or (not judged.is_replayed and self.believes(row, address, now))

    def release(self, row: int, now: Time, judged: Judged) -> list[tuple[Verified, Time]]:
        """What is verified by a broadcast of addresses that several use: of each the newest Location, and when it was
        received.

        Messages wait for their Manifest, so these were not acted on before.
        """
        newest: dict[int, Verified] = {}
        if self.filters(row):
            for verified in judged.verified:
                earlier = newest.get(verified.address)
                if is_located(verified.body) and (earlier is None or verified.heard_s >= earlier.heard_s):
                    newest[verified.address] = verified
        clock_s = self._clock_s(row, now)
        if clock_s is None:
            return []
        return [
            # to the µs, which is more than seconds since 2019 resolve
            (verified, now - max(0, round((clock_s - verified.heard_s) * _US_PER_S)) * NS_PER_US)
            for verified in newest.values()
            if self.trust(row, verified.address, now) is Trust.CONTRADICTED
        ]

    def _take(self, row: int, heard: _Broadcast) -> Judged:
        clock_s = self._clock_s(row, heard.at_ns)
        if clock_s is None:
            self._early[row].append(heard)
            return Judged()
        judged = self._observers[row].receive(heard.address, heard.counter, heard.body, clock_s)
        self._judge(row, heard.address, heard.at_ns, clock_s, heard.cause)
        return judged

    def _clock_s(self, row: int, at_ns: Time) -> float | None:
        verification, offset_us = self._receivers[row], self._clocks_us[row]
        if verification is None or offset_us < 0:
            return None
        return since_2019_s(offset_us * 1000) + at_ns / NS_PER_S + verification.clock_error_s

    def _judge(self, row: int, address: int, now: Time, clock_s: float, cause: FrameId | None) -> None:
        senders = self._senders[row]
        track = self._observers[row].track(address, clock_s)
        if track is None:
            senders.pop(address, None)
            return
        sender = senders.get(address)
        if sender is None:
            sender = senders[address] = _Sender(now)
        if track.state is sender.state:
            return
        self._told[row] = count = self._told[row] + 1
        if count <= MAX_TOLD or worth_noting(count):
            tag, first_ns = track.tag, sender.first_ns
            change = VerdictChange(row, address, track.state, sender.state, tag, first_ns, now, count, cause)
            self._changes.append(change)
        sender.state = track.state


def printable_tag(tag: bytes | None) -> str:
    """A tag as the IPv6 address that it is; "" for none."""
    if tag is None:
        return ""
    try:
        return EntityTag.parse(tag).address
    except DecodeError:
        return tag.hex()
