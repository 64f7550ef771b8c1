"""Peers of a USS: where the requests to another service go, by its base URL."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from skyrange.core.ids import Port


@dataclass(frozen=True, slots=True)
class Peer:
    """Another service of the federation."""

    name: str
    """As tokens for it name their receiver."""
    port: Port


class Directory(Protocol):
    """The services that a USS can reach."""

    @property
    def ports(self) -> Sequence[Port]:
        """The ports that are known from the beginning."""
        ...

    def find(self, base_url: str) -> Peer | None:
        """The USS at a base URL; `None` for one that cannot be reached, and for the USS itself."""
        ...


class KnownPeers:
    """The directory of a federation whose members are fixed. Deep-copyable."""

    def __init__(self, peers: Mapping[str, Peer]) -> None:
        """`peers`: the other USSs by base URL."""
        self._peers = dict(sorted(peers.items()))

    @property
    def ports(self) -> Sequence[Port]:
        """The ports of all, in the order of their base URLs."""
        return tuple(peer.port for peer in self._peers.values())

    def find(self, base_url: str) -> Peer | None:
        """The USS at a base URL."""
        return self._peers.get(base_url)
