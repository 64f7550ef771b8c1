"""Hashes of messages that trusted keys have signed: who signed each last, and when that was received."""

from __future__ import annotations

from typing import Final, NamedTuple

from skyrange.remoteid.drip.verification.observed_sender import bound

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
        held = self._by_hash.get(hash_)
        if held is not None and held.vnb_s >= signed.vnb_s:
            return held
        self._by_hash.pop(hash_, None)
        self._by_hash[hash_] = signed
        bound(self._by_hash, MAX_SIGNED)
        return signed
