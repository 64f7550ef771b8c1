"""Authentication pages of a fleet: signed, split and spread over time, beside the ordinary broadcasts.

Pages are frames of their own and pay their airtime. Over Bluetooth 4 each page is an advertisement, with a parity page
for each message; the other transports carry all pages of a message in one pack, without parity (RFC 9575, section 6.2).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

from skyrange.codec.drip import encode_sam, since_2019_s, split_with_parity
from skyrange.codec.f3411 import Authentication, MessagePack, encode
from skyrange.codec.remote_id.link_payload import Transport
from skyrange.contracts.frames import Ints
from skyrange.core.time import NEVER, Time
from skyrange.remoteid.broadcast_profiles import TRANSPORTS, Broadcast
from skyrange.remoteid.drip.sender import PAGE_NS, Kind, Sender


class DuePage(NamedTuple):
    """A frame with one page, or with the pack of all pages of a message."""

    row: int
    at_ns: Time
    transport: int
    counter: int
    """Message counter over Bluetooth 4; the counter of packs is that of the transport."""
    body: bytes


class _Queue:
    """The frames of one aircraft that wait; those of Manifests first, because what they sign grows old."""

    __slots__ = ("counter", "links", "manifests", "next_ns", "repeats", "sender")

    def __init__(self, sender: Sender, repeats: int) -> None:
        self.sender = sender
        self.repeats = repeats
        self.manifests: deque[tuple[int, int, bytes]] = deque()
        self.links: deque[tuple[int, int, bytes]] = deque()
        self.next_ns: Time = 0
        self.counter = 0

    @property
    def is_empty(self) -> bool:
        return not (self.manifests or self.links)


class AuthenticationPages:
    """The senders of all aircraft of a broadcaster that have keys. Deep-copyable."""

    def __init__(self, broadcasts: Sequence[Broadcast]) -> None:
        """Raises `ValueError` if none has a key."""
        self._transports = [
            [int(kind) for name in broadcast.transports for kind in TRANSPORTS[name]] for broadcast in broadcasts
        ]
        self._queues = {
            row: _Queue(
                Sender(
                    broadcast.credentials.registration,
                    legacy=Transport.BT4 in self._transports[row],
                    rates=broadcast.credentials.rates,
                    seed=broadcast.credentials.seed,
                ),
                broadcast.credentials.repeats,
            )
            for row, broadcast in enumerate(broadcasts)
            if broadcast.credentials is not None
        }
        if not self._queues:
            raise ValueError("no aircraft has a key")
        self._fresh: dict[int, Time] = {}
        """When each aircraft that has broadcast since `sign` did so."""

    @property
    def next_ns(self) -> Time:
        """When the next page is due; `NEVER` if none waits."""
        return min((queue.next_ns for queue in self._queues.values() if not queue.is_empty), default=NEVER)

    def sent(self, row: int, at_ns: Time, body: bytes) -> None:
        """An ordinary message or pack of an aircraft is broadcast at `at_ns`."""
        queue = self._queues.get(row)
        if queue is not None:
            queue.sender.sent(body)
            self._fresh[row] = at_ns

    def sign(self, now: Time, clocks_us: Ints, next_ns: Ints) -> None:
        """Make the messages that are due for the aircraft that have just broadcast.

        `clocks_us` (n,) is the UTC of each aircraft, in µs since 1970; without it (-1) an aircraft signs nothing.
        `next_ns` (n,) is when each makes its next ordinary broadcast: what would become overdue until then is sent now,
        so that the longest times of RFC 9575, section 6.3, are kept.
        """
        for row, sent_ns in sorted(self._fresh.items()):
            clock_us = clocks_us.item(row)
            if clock_us < 0:
                continue
            queue, clock_s = self._queues[row], max(0.0, since_2019_s(clock_us * 1000))
            if queue.is_empty:
                queue.next_ns = max(queue.next_ns, now + PAGE_NS)
            for kind in queue.sender.due(next_ns.item(row)):
                message = encode_sam(queue.sender.message(kind, max(now, sent_ns), clock_s))
                waiting = queue.manifests if kind is Kind.MANIFEST else queue.links
                for transport in self._transports[row]:
                    legacy = transport == Transport.BT4
                    pages = split_with_parity(message, int(clock_s), parity=legacy)
                    times = queue.repeats if legacy else 1
                    waiting.extend((transport, queue.counter, body) for body in _bodies(pages, legacy=legacy) * times)
                    if legacy:
                        queue.counter = (queue.counter + 1) % 256
        self._fresh.clear()

    def take(self, now: Time, until: Time) -> list[DuePage]:
        """The frames that are due before `until`, in the order of the aircraft."""
        due_pages: list[DuePage] = []
        for row, queue in self._queues.items():
            while not queue.is_empty and queue.next_ns < until:
                at_ns = max(queue.next_ns, now)
                waiting = queue.manifests or queue.links
                due_pages.append(DuePage(row, at_ns, *waiting.popleft()))
                queue.next_ns = at_ns + PAGE_NS
        return due_pages


def _bodies(pages: Sequence[Authentication], *, legacy: bool) -> list[bytes]:
    return [encode(page) for page in pages] if legacy else [encode(MessagePack(tuple(pages)))]
