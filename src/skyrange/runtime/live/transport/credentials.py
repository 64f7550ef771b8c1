"""Credentials of one live range: CURVE key pairs and a bearer token, made when it starts and valid for it alone.

A node gets them in its configuration: in a file that only its owner can read, and on another machine under that
machine's own key. Links on the loopback are open, as in life; MAVLink has no keys but those of its signatures.
"""

from __future__ import annotations

import secrets
from dataclasses import dataclass, field

import zmq

from skyrange.io.zeromq.curve_keys import Keys


@dataclass(frozen=True, slots=True)
class Credentials:
    """What a node authenticates itself with."""

    control: Keys
    """For the supervisor's control socket."""
    links: Keys
    """For ZeroMQ links between machines: one pair, which all nodes have."""
    token: str = field(repr=False)
    """The bearer token for an approval on another machine."""


def issue_credentials(server: bytes) -> Credentials:
    """New credentials for a range whose control socket has the public key `server` (Z85)."""
    (public, secret), (shared, shared_secret) = zmq.curve_keypair(), zmq.curve_keypair()
    return Credentials(
        Keys(public, secret, frozenset({server})),
        Keys(shared, shared_secret, frozenset({shared})),
        secrets.token_urlsafe(24),
    )
