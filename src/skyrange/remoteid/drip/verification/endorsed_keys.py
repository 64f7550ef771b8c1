"""Keys that a DRIP receiver trusts, by configuration or by Links, and the messages that these keys have signed."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Final, NamedTuple

from skyrange.codec.drip import EntityTag, Link, link_hash
from skyrange.core.errors import DecodeError
from skyrange.remoteid.drip.registry import Anchor, Level, child_level, verify
from skyrange.remoteid.drip.verification.observed_sender import bound
from skyrange.remoteid.drip.verification.verdicts import Policy, Refusal

MAX_KEYS: Final = 4096
"""Keys held. Only registered parties fill this."""
MAX_ORPHANS: Final = 64
"""Links held whose parent is not known yet; the oldest makes room."""
MAX_REFUSED: Final = 1024
"""Links with wrong signatures that are remembered, so that none is verified twice."""


class EndorsedKey(NamedTuple):
    """A key and the time within which it is trusted."""

    key: bytes
    level: Level
    vnb_s: float
    vna_s: float
    link: bytes
    """Hash of the Link that endorsed it; b"" of an anchor."""


class LinkVerdict(NamedTuple):
    """What became of a Link."""

    refusal: Refusal | None = None
    is_false: bool = False
    """Whether it speaks against its sender."""
    endorsed: bytes | None = None
    """The tag whose key is trusted by it."""


_IGNORED: Final = LinkVerdict()


class EndorsedKeys:
    """The keys of one receiver, by their tags."""

    __slots__ = ("_keys", "_orphans", "_policy", "_refused")

    def __init__(self, anchors: Iterable[Anchor], policy: Policy) -> None:
        endless = float("inf")
        self._policy = policy
        self._keys = {anchor.tag: EndorsedKey(anchor.key, anchor.level, 0.0, endless, b"") for anchor in anchors}
        self._orphans: dict[bytes, tuple[Link, int]] = {}  # with the sender's address
        self._refused: dict[bytes, None] = {}

    def valid(self, tag: bytes, now_s: float) -> EndorsedKey | None:
        """The key of a tag, if it is trusted now."""
        known, skew_s = self._keys.get(tag), self._policy.clock_skew_s
        return known if known is not None and known.vnb_s - skew_s <= now_s <= known.vna_s + skew_s else None

    def take(self, link: Link, address: int, now_s: float, affords: Callable[[], bool]) -> LinkVerdict:
        """Judge a Link from `address`; `affords` takes a verification from the budget.

        One whose parent is not known is held (`orphans_of`).
        """
        digest = link_hash(link)
        held_key = self._keys.get(link.child)
        if (held_key is not None and held_key.link in (digest, b"")) or digest in self._refused:
            return _IGNORED  # known already, or an anchor
        try:
            child, parent = EntityTag.parse(link.child), EntityTag.parse(link.parent)
        except DecodeError:
            return LinkVerdict(Refusal.MALFORMED, is_false=True)
        if not child.commits_to(link.child_key):
            return LinkVerdict(Refusal.UNBOUND_KEY, is_false=True)
        skew_s = self._policy.clock_skew_s
        if not link.vnb_s - skew_s <= now_s <= link.vna_s + skew_s:
            return LinkVerdict(Refusal.LINK_OUT_OF_TIME)
        authority = self.valid(link.parent, now_s)
        if authority is None:
            self._orphans[digest] = (link, address)
            bound(self._orphans, MAX_ORPHANS)
            return _IGNORED
        level = child_level(authority.level, parent, child)
        if level is None:
            return LinkVerdict(Refusal.NO_AUTHORITY, is_false=True)
        if not affords():
            return LinkVerdict(Refusal.OVER_BUDGET)
        if not verify(authority.key, link.signature, link.signed):
            self._refused[digest] = None
            bound(self._refused, MAX_REFUSED)
            return LinkVerdict(Refusal.WRONG_SIGNATURE, is_false=True)
        if link.child not in self._keys and len(self._keys) >= MAX_KEYS:
            return LinkVerdict(Refusal.NO_ROOM)
        until_s = min(float(link.vna_s), authority.vna_s)
        if held_key is None or until_s > held_key.vna_s:
            self._keys[link.child] = EndorsedKey(link.child_key, level, float(link.vnb_s), until_s, digest)
        return LinkVerdict(endorsed=link.child)

    def orphans_of(self, tag: bytes) -> list[tuple[Link, int]]:
        """The Links that waited for the key of `tag`, with the addresses of their senders; they are held no longer."""
        return [
            self._orphans.pop(digest)
            for digest in [digest for digest, (link, _) in self._orphans.items() if link.parent == tag]
        ]


MAX_SIGNED: Final = 4096
"""Hashes held: 64 senders with a message a second for a minute. The one signed longest ago makes room."""


class Signed(NamedTuple):
    """The newest signature of a message."""

    tag: bytes
    vnb_s: int
    """When it was signed, by the signer's clock."""
    heard_s: float
    """When the signature was first received, by the receiver's."""


class SignedMessages:
    """The signed messages that one receiver knows, whatever address they came from."""

    __slots__ = ("_by_hash",)

    def __init__(self) -> None:
        self._by_hash: dict[bytes, Signed] = {}

    def __contains__(self, hash_: object) -> bool:
        """Whether a message was signed."""
        return hash_ in self._by_hash

    def find(self, hash_: bytes) -> Signed | None:
        """The newest signature of a message; `None` for none."""
        return self._by_hash.get(hash_)

    def take(self, hash_: bytes, signed: Signed) -> Signed:
        """Hold a signature unless a newer one, or a copy of it, is held already; returns the one that is held."""
        held_signature = self._by_hash.get(hash_)
        if held_signature is not None and held_signature.vnb_s >= signed.vnb_s:
            return held_signature
        self._by_hash.pop(hash_, None)
        self._by_hash[hash_] = signed
        bound(self._by_hash, MAX_SIGNED)
        return signed
