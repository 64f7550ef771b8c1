"""Addresses and credentials of the links between processes: ports +10 for each aircraft or operator, keys, a token.

CURVE key pairs and the bearer token are made when a live range starts, and are valid for it alone. A node gets them in
its configuration: in a file that only its owner can read, and on another machine under that machine's own key. Links on
the loopback are open, as in life; MAVLink has no keys but those of its signatures.
"""

from __future__ import annotations

import errno
import secrets
import socket
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal

import zmq

from skyrange.contracts.links import LinkEnds, LinkSpec
from skyrange.core.errors import InputError, Problem
from skyrange.io.zeromq.curve_keys import Keys
from skyrange.runtime.live.deployment import LOOPBACK, Deployment

STEP: Final = 10
LOOPBACK_S: Final = 2.0
"""Seconds in which loopback has to connect."""
TransportKind = Literal["udp", "tcp", "zmq", "http"]


@dataclass(frozen=True, slots=True)
class Kind:
    """Transport of links of one kind: the first port, and the role whose end listens there."""

    transport: TransportKind
    port: int
    listens: str


KINDS: Final[Mapping[str, Kind]] = {
    "gcs": Kind("udp", 14555, "gcs"),
    "log": Kind("tcp", 14551, "proxy"),
    "autopilot": Kind("tcp", 5760, "autopilot"),
    "rid_data": Kind("zmq", 14558, "proxy"),
    "rid_up": Kind("zmq", 14556, "oracle"),
    "rid_down": Kind("zmq", 14557, "oracle"),
    "scan": Kind("zmq", 14559, "oracle"),
    "oracle": Kind("zmq", 30000, "oracle"),
    "approval": Kind("http", 18080, "approval"),
}
"""By the link's kind. The proxy serves the companion as a MAVLink router does, the autopilot the proxy as SITL does;
the end with many peers listens; a ground station waits for its aircraft."""


@dataclass(frozen=True, slots=True)
class Crossing:
    """One link between two processes."""

    link: LinkEnds
    transport: TransportKind
    listener: str
    """The endpoint that listens."""
    address: tuple[str, int]


def crossings(links: Sequence[LinkSpec], planned: Deployment, offset: int = 0) -> list[Crossing]:
    """The addresses of those of `links` that are between two processes; grouping moves no port.

    The n-th link of a kind has that kind's first port + 10 n + `offset`, on the loopback while both ends are on one
    machine, else at the listener's address. Raises `InputError` if a port would be out of range.
    """
    places: dict[str, int] = {}
    numbered: dict[str, int] = {}
    for spec in links:
        name = spec.name.partition(":")[0]
        places[spec.name] = numbered.get(name, 0)
        numbered[name] = places[spec.name] + 1
    result, problems = [], []
    for spec in planned.crossing(links):
        kind = KINDS[spec.name.partition(":")[0]]
        port = kind.port + STEP * places[spec.name] + offset
        listener = next(end for end in (spec.a, spec.b) if end.rpartition(".")[2] == kind.listens)
        if not 1 <= port <= 65_535:
            problems.append(
                Problem(spec.name, f"port {port}", "a port from 1 to 65535", "Choose another --port-offset.")
            )
        hosts = {planned.host(spec.a), planned.host(spec.b)}
        host = planned.host(listener) if len(hosts) > 1 else LOOPBACK
        result.append(Crossing(LinkEnds(spec.name, spec.a, spec.b), kind.transport, listener, (host, port)))
    if problems:
        raise InputError("live", problems)
    return result


def check_own_addresses(base: str) -> None:
    """Raise `InputError` unless loopback carries bytes, and `base`, where the range is started, is this machine's."""
    try:
        with socket.create_server((LOOPBACK, 0)) as listener:
            socket.create_connection(listener.getsockname(), LOOPBACK_S).close()
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        hint = "The processes of a range need it: `ip link set lo up`."
        raise InputError.one("live", LOOPBACK, reason, "a loopback interface that is up", hint) from None
    try:
        with socket.socket(socket.AF_INET6 if ":" in base else socket.AF_INET, socket.SOCK_DGRAM) as tried:
            tried.bind((base, 0))
    except OSError as error:
        reason = f"{base}: {(error.strerror or str(error)).lower()}"
        hint = "Start the range on the machine that hosts.world names."
        raise InputError.one("live", "hosts.world", reason, "an address of this machine", hint) from None


def check_free(places: Sequence[Crossing]) -> None:
    """Raise `InputError` with every address that is in use, is not this machine's, or belongs to two links."""
    problems = []
    owners: dict[tuple[str, tuple[str, int]], str] = {}
    for crossing in places:
        family = "udp" if crossing.transport == "udp" else "tcp"
        other = owners.setdefault((family, crossing.address), crossing.link.name)
        where = f"{crossing.link.name} at {crossing.address[0]}:{crossing.address[1]}/{family}"
        hint = "Move all ports with --port-offset, or end what uses it."
        if other != crossing.link.name:
            problems.append(Problem(where, f"taken by {other}", "an address of its own", hint))
            continue
        kind = socket.SOCK_DGRAM if family == "udp" else socket.SOCK_STREAM
        with socket.socket(socket.AF_INET6 if ":" in crossing.address[0] else socket.AF_INET, kind) as tried:
            if family == "tcp":
                tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                tried.bind(crossing.address)
            except OSError as error:
                if error.errno == errno.EADDRNOTAVAIL:
                    hint = "Start the range on the machine that hosts.world names."
                problems.append(Problem(where, error.strerror or str(error), "an address that is free", hint))
    if problems:
        raise InputError("live", problems)


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
