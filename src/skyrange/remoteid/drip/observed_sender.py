"""What a DRIP receiver remembers of one sender address: pages, messages that wait for a Manifest, and evidence."""

from __future__ import annotations

from collections import Counter
from typing import Any, Final

from skyrange.codec.drip import Evidence
from skyrange.codec.f3411 import SIZE, MessageType
from skyrange.codec.f3411.encode import PACK_HEADER
from skyrange.remoteid.drip.reassembly import Reassembly
from skyrange.remoteid.drip.verdicts import Policy, Refusal

MAX_WAITING: Final = 8
"""Signed messages that are held until their key is known; the oldest makes room."""
MAX_HEARD: Final = 128
"""Messages that wait for a Manifest, and hashes held that wait for their message."""
DYNAMIC: Final = frozenset((MessageType.LOCATION, MessageType.SYSTEM))
"""Types whose content nobody knows long before, so that a signature proves possession of the key now (section 9.1)."""


class ObservedSender:
    """Mutable part of a track."""

    __slots__ = (
        "bad_s",
        "claimed",
        "confirmed_s",
        "counts",
        "covered",
        "first_s",
        "good_s",
        "heard",
        "last_s",
        "manifest",
        "manifest_s",
        "older_s",
        "pages",
        "replayed_s",
        "signed_off",
        "tag",
        "unsupported",
        "verified",
        "verified_at_s",
        "waiting",
    )  # fmt: skip

    def __init__(self, now_s: float) -> None:
        self.first_s = self.last_s = now_s
        self.pages = Reassembly()
        self.claimed: bytes | None = None
        self.tag: bytes | None = None
        self.heard: dict[bytes, tuple[float, bytes]] = {}  # in no Manifest yet, by hash
        self.covered: dict[bytes, float] = {}  # hashes in good Manifests, by their time
        self.waiting: list[tuple[Evidence, bytes, float]] = []  # with what is beside it, and when it was received
        self.manifest: bytes | None = None  # hash of the newest good Manifest
        self.manifest_s = 0.0  # when that was received
        self.older_s = 0.0  # when the one before that was
        self.signed_off = 0.0  # of what was heard since then, no Manifest was lost
        self.good_s: float | None = None
        self.bad_s: float | None = None
        self.replayed_s: float | None = None
        self.confirmed_s: float | None = None
        self.verified_at_s: float | None = None
        self.verified = 0
        self.unsupported = False
        self.counts: Counter[Refusal] = Counter()

    def find_unsigned(self, previous: bytes, heard_s: float, policy: Policy) -> tuple[int, bool]:
        """How many messages the owner of the key did not sign, and whether that contradicts it; they are forgotten.

        A Manifest holds what was sent before it, and may be under way while more is sent. So what was heard before the
        last but one is in one of these three, or the owner of the key did not send it. The chain of hashes (`previous`)
        tells whether a Manifest was lost.
        """
        if self.manifest is None or previous != self.manifest:
            self.signed_off = heard_s
        unsigned, is_forged = 0, False
        for hash_ in [hash_ for hash_, (at_s, _) in self.heard.items() if at_s < self.older_s]:
            at_s, body = self.heard.pop(hash_)
            if at_s >= self.signed_off:
                unsigned += 1
                is_forged = is_forged or (policy.full_coverage and is_dynamic(body))
        return unsigned, is_forged


def bound(held: dict[bytes, Any], limit: int) -> None:
    """Drop the oldest entries."""
    while len(held) > limit:
        del held[next(iter(held))]


def split_bodies(bodies: bytes) -> tuple[bytes, ...]:
    """The messages of 25 bytes in a row of them."""
    return tuple(bodies[at : at + SIZE] for at in range(0, len(bodies), SIZE))


def bodies_of(body: bytes) -> tuple[bytes, ...]:
    """The single messages of a message or pack."""
    return split_bodies(body[PACK_HEADER:]) if body[0] >> 4 == MessageType.MESSAGE_PACK else (body,)


def is_dynamic(body: bytes) -> bool:
    """Whether a message or pack holds a type of `DYNAMIC`."""
    return any(part[0] >> 4 in DYNAMIC for part in bodies_of(body))
