"""What lets a process of the range in where others would be refused? Keys and a token, made for this range alone.

They reach a node in its orders: in a file that its owner alone can read, and to another machine under that machine's
own key. Links on the loopback are open, as they are in life; MAVLink knows no keys but those of its signatures.
"""

from __future__ import annotations

import secrets
from dataclasses import dataclass, field

import zmq

from skyrange.io.curve_keys import Keys


@dataclass(frozen=True, slots=True)
class Passes:
    """What a node shows."""

    desk: Keys
    """At the supervisor's control socket."""
    links: Keys
    """At ZeroMQ links that go from machine to machine: one pair, that all nodes have."""
    token: str = field(repr=False)
    """At an approval on another machine, as a bearer token."""


def issue(desk: bytes) -> Passes:
    """New ones for a range whose control socket has the public key `desk` (Z85)."""
    (public, secret), (shared, shared_secret) = zmq.curve_keypair(), zmq.curve_keypair()
    return Passes(
        Keys(public, secret, frozenset({desk})),
        Keys(shared, shared_secret, frozenset({shared})),
        secrets.token_urlsafe(24),
    )
