"""What a DRIP receiver remembers of one sender address: pages, messages that wait for a Manifest, and evidence.

Pages arrive one by one, some of them never, some of them forged.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Container
from typing import Any, Final

from skyrange.codec.drip import Evidence, join_with_parity
from skyrange.codec.f3411 import SIZE, Authentication, MessageType
from skyrange.codec.f3411.encode import PACK_HEADER
from skyrange.core.errors import DecodeError
from skyrange.remoteid.drip.verification.verdicts import Policy, Refusal

HOLD_S: Final = 30.0
"""Pages of a message that is not complete are dropped after this: the counter comes round after 256 messages, and a
message sent one page a second takes 11 s at most.
"""
MAX_OPEN: Final = 8
"""Messages of one sender that are held at once; the oldest makes room."""


class Reassembly:
    """The open messages of one sender, by their message counter (F3411; RFC 9575, section 5.2)."""

    __slots__ = ("_done", "_open", "conflicts", "dropped", "restored")

    def __init__(self) -> None:
        self._open: dict[int, tuple[float, dict[int, Authentication]]] = {}
        self._done: dict[int, tuple[float, Authentication]] = {}
        self.conflicts = 0
        """Pages that replaced a different page of the same number."""
        self.dropped = 0
        """Messages that were never complete."""
        self.restored = 0
        """Pages that the parity replaced."""

    @property
    def is_waiting(self) -> bool:
        """Whether a message has begun."""
        return bool(self._open)

    def add(self, counter: int, page: Authentication, now_s: float) -> bytes | None:
        """The data of a message that this page completes, each message once; `None` while pages are missing."""
        self._expire(now_s)
        done = self._done.get(counter)
        if done is not None and (page.page or page == done[1]):
            return None
        if done is not None:
            del self._done[counter]  # another message under a counter that came round
        begun = self._open.get(counter)
        if begun is None:
            if len(self._open) >= MAX_OPEN:
                del self._open[min(self._open, key=lambda key: self._open[key][0])]
                self.dropped += 1
            begun = self._open[counter] = (now_s, {})
        pages = begun[1]
        if page.page in pages and pages[page.page] != page:
            self.conflicts += 1
        pages[page.page] = page
        try:
            data, replaced = join_with_parity(pages)
        except DecodeError:
            return None
        del self._open[counter]
        self.restored += replaced is not None
        self._done[counter] = (now_s, pages.get(0, page))
        return data

    def _expire(self, now_s: float) -> None:
        for counter in [key for key, (begun_s, _) in self._open.items() if now_s - begun_s > HOLD_S]:
            del self._open[counter]
            self.dropped += 1
        for counter in [key for key, (done_s, _) in self._done.items() if now_s - done_s > HOLD_S]:
            del self._done[counter]


MAX_WAITING: Final = 8
"""Signed messages that are held until their key is known; the oldest makes room."""
MAX_HEARD: Final = 128
"""Messages of a sender that wait for a Manifest."""
MAX_CLAIMS: Final = 8
"""Tags that Basic IDs of one sender claim; the one claimed longest ago makes room."""
MAX_CHAINS: Final = 4
"""Tags whose Manifests are followed at one address; the one heard longest ago makes room."""
DYNAMIC: Final = frozenset((MessageType.LOCATION, MessageType.SYSTEM))
"""Types whose content nobody knows long before, so that a signature proves possession of the key now (section 9.1)."""


class ManifestChain:
    """The Manifests of one tag from one address."""

    __slots__ = ("manifest", "manifest_s", "older_s", "signed_off")

    def __init__(self) -> None:
        self.manifest: bytes | None = None  # hash of the newest good one
        self.manifest_s = 0.0  # when that was received
        self.older_s = 0.0  # when the one before that was
        self.signed_off = 0.0  # of what was heard since then, none was lost

    def add(self, manifest: bytes, heard_s: float) -> None:
        """Take a good Manifest, by its hash."""
        self.manifest = manifest
        self.older_s, self.manifest_s = self.manifest_s, heard_s


class ObservedSender:
    """Mutable part of a track."""

    __slots__ = (
        "bad_s",
        "chains",
        "claims",
        "confirmed_s",
        "counts",
        "first_s",
        "good_s",
        "heard",
        "last_s",
        "pages",
        "replayed_s",
        "tag",
        "unsupported",
        "verified",
        "verified_at_s",
        "waiting",
    )  # fmt: skip

    def __init__(self, now_s: float) -> None:
        self.first_s = self.last_s = now_s
        self.pages = Reassembly()
        self.claims: dict[bytes, None] = {}  # the newest last
        self.tag: bytes | None = None
        self.heard: dict[bytes, tuple[float, bytes]] = {}  # in no Manifest yet, by hash
        self.waiting: list[tuple[Evidence, bytes, float]] = []  # with what is beside it, and when it was received
        self.chains: dict[bytes, ManifestChain] = {}  # by tag; the newest last
        self.good_s: float | None = None
        self.bad_s: float | None = None
        self.replayed_s: float | None = None
        self.confirmed_s: float | None = None
        self.verified_at_s: float | None = None
        self.verified = 0
        self.unsupported = False
        self.counts: Counter[Refusal] = Counter()

    @property
    def claimed(self) -> bytes | None:
        """The tag that it claimed last."""
        return next(reversed(self.claims), None)

    def claim(self, tag: bytes) -> None:
        """Take in the tag of a Basic ID."""
        self.claims.pop(tag, None)
        self.claims[tag] = None
        bound(self.claims, MAX_CLAIMS)

    def chain(self, tag: bytes) -> ManifestChain:
        """The Manifests of a tag, which becomes the one heard last."""
        chain = self.chains.pop(tag, None) or ManifestChain()
        self.chains[tag] = chain
        bound(self.chains, MAX_CHAINS)
        return chain

    def is_shared(self, tag: bytes, heard_s: float, policy: Policy) -> bool:
        """Whether another tag than this one signs Manifests under this address."""
        return any(who != tag and heard_s - chain.manifest_s <= policy.fresh_s for who, chain in self.chains.items())

    def find_unsigned(
        self, chain: ManifestChain, previous: bytes, heard_s: float, policy: Policy, signed: Container[bytes]
    ) -> tuple[int, bool]:
        """How many messages the owner of the key did not sign, and whether that contradicts it; they are forgotten.

        A Manifest holds what was sent before it, and may be under way while more is sent. So what was heard before the
        last but one is in one of these three, or the owner of the key did not send it. The chain of hashes (`previous`)
        tells whether a Manifest was lost. What was ever `signed` (hashes) is a repetition, and contradicts nobody.
        """
        if chain.manifest is None or previous != chain.manifest:
            chain.signed_off = heard_s
        alive = [
            known_chain
            for known_chain in self.chains.values()
            if known_chain is chain or heard_s - known_chain.manifest_s <= policy.fresh_s
        ]
        before_s, since_s = (
            min(known_chain.older_s for known_chain in alive),
            max(known_chain.signed_off for known_chain in alive),
        )
        unsigned, is_forged = 0, False
        for hash_ in [hash_ for hash_, (at_s, _) in self.heard.items() if at_s < before_s]:
            at_s, body = self.heard.pop(hash_)
            if at_s >= since_s and hash_ not in signed:
                unsigned += 1
                is_forged = is_forged or (policy.full_coverage and is_dynamic(body))
        return unsigned, is_forged


def bound(entries: dict[bytes, Any], limit: int) -> None:
    """Drop the oldest entries."""
    while len(entries) > limit:
        del entries[next(iter(entries))]


def split_bodies(bodies: bytes) -> tuple[bytes, ...]:
    """The messages of 25 bytes in a row of them."""
    return tuple(bodies[at : at + SIZE] for at in range(0, len(bodies), SIZE))


def bodies_of(body: bytes) -> tuple[bytes, ...]:
    """The single messages of a message or pack."""
    return split_bodies(body[PACK_HEADER:]) if body[0] >> 4 == MessageType.MESSAGE_PACK else (body,)


def is_dynamic(body: bytes) -> bool:
    """Whether a message or pack holds a type of `DYNAMIC`."""
    return any(part[0] >> 4 in DYNAMIC for part in bodies_of(body))


def is_located(body: bytes) -> bool:
    """Whether a message or pack holds a Location."""
    return any(part[0] >> 4 == MessageType.LOCATION for part in bodies_of(body))
