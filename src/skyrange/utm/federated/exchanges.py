"""Exchanges of requests and responses on `uss` links: the side that asks, the side that answers, and where peers are.

A request that is not answered is sent again with the same bytes; who answers knows it again, and repeats its response
without acting twice.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import blake2b
from types import MappingProxyType
from typing import Any, Final, Protocol

from uas_standards.astm.f3548.v21.api import OperationID
from uas_standards.astm.f3548.v21.constants import Scope

from skyrange.codec.f3548.frames import UssRequest, UssResponse, encode
from skyrange.codec.f3548.operations import check_request, check_response, find_operation, path_of
from skyrange.contracts.mailboxes import Arrival, Outbox, Turn
from skyrange.core.errors import DecodeError
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import NEVER, NS_PER_MS, Time
from skyrange.core.whole_numbers import worth_noting
from skyrange.utm.contract import make_uuid
from skyrange.utm.federated.tokens import Claims, TokenChecker, TokenError

TIMEOUT_NS: Final = 1_500 * NS_PER_MS
"""After which a request is sent again, as the ground station does."""
MAX_TRIES: Final = 4
REMEMBERED: Final = 4_096
"""Responses kept for each link."""

Refs = tuple[FrameId, ...]
Body = Mapping[str, Any]
NOTHING: Final[Mapping[str, str]] = MappingProxyType({})
"""Parameters of an operation that has none."""


@dataclass(slots=True)
class Call:
    """A request that awaits its response."""

    exchange: int
    operation: OperationID
    receiver: str
    """The name of the service that is asked."""
    port: Port
    payload: bytes
    causes: Refs
    due: Time
    tries: int = 1


@dataclass(frozen=True, slots=True)
class Reply:
    """The response to a call, its body checked."""

    call: Call
    status: int
    body: dict[str, Any]
    ref: FrameId


class WrongReplyError(DecodeError):
    """A response that the standard does not have for its request."""

    def __init__(self, call: Call, problem: str) -> None:
        super().__init__(problem)
        self.call = call


@dataclass(slots=True)
class Caller:
    """The requests of one agent, whose causes are those of the turn in which they are sent. Deep-copyable."""

    _calls: dict[int, Call] = field(default_factory=dict)
    _count: int = 0

    @property
    def due(self) -> Time:
        """When `repeat_overdue` has something to do."""
        return min((call.due for call in self._calls.values()), default=NEVER)

    def call(
        self,
        turn: Turn,
        peer: Peer,
        operation: OperationID,
        *,
        token: str,
        parameters: Mapping[str, str] = NOTHING,
        body: Body | None = None,
    ) -> int:
        """Send a request; returns the number of its exchange."""
        self._count += 1
        method, path = path_of(operation, **parameters)
        frame = UssRequest.model_construct(
            exchange=self._count, method=method, path=path, token=token, body=None if body is None else dict(body)
        )
        call = Call(self._count, operation, peer.name, peer.port, encode(frame), turn.causes, turn.now + TIMEOUT_NS)
        self._calls[call.exchange] = call
        turn.send(peer.port, call.payload)
        return call.exchange

    def read(self, arrival: Arrival, response: UssResponse) -> Reply | None:
        """The reply in a response; `None` where nobody waits for it. Raises `WrongReplyError` for a wrong body, which
        ends the exchange as the end of an HTTP response does.
        """
        call = self._calls.get(response.exchange)
        if call is None or call.port != arrival.port:
            return None
        del self._calls[call.exchange]
        try:
            body = check_response(call.operation, response.status, response.body)
        except DecodeError as error:
            raise WrongReplyError(call, str(error)) from error
        return Reply(call, response.status, body, arrival.ref)

    def repeat_overdue(self, turn: Turn) -> list[Call]:
        """Send again what was not answered; returns the calls that are given up."""
        given_up = []
        for call in [call for call in self._calls.values() if call.due <= turn.now]:
            if call.tries >= MAX_TRIES:
                del self._calls[call.exchange]
                given_up.append(call)
                continue
            call.tries += 1
            call.due = turn.now + TIMEOUT_NS
            turn.caused_by(*call.causes).send(call.port, call.payload)
        return given_up


@dataclass(frozen=True, slots=True)
class IncomingRequest:
    """A request that is to be answered."""

    port: Port
    exchange: int
    digest: bytes
    """What tells it from other requests."""
    operation: OperationID
    parameters: Mapping[str, str]
    body: Mapping[str, Any]
    claims: Claims
    ref: FrameId

    def has(self, scope: Scope) -> bool:
        """Whether the token has a scope."""
        return scope.value in self.claims.scopes


@dataclass(slots=True)
class Server:
    """The requests to one agent: read and checked, and answered once each. Deep-copyable.

    Bad bytes are counted and noted at the 1st, 2nd, 4th, 8th … (`decision.uss_bad_request` about the agent).
    """

    name: str
    tokens: TokenChecker
    serves: Mapping[OperationID, frozenset[Scope]]
    """The operations that it has, each with the scopes of which a token has to have one."""
    bad_requests: int = 0
    _answers: dict[str, dict[bytes, bytes | None]] = field(default_factory=dict)
    """Responses by link and digest of the request; None while it is open."""

    def read(self, turn: Turn, arrival: Arrival, request: UssRequest) -> IncomingRequest | None:
        """What is asked, if it is to be decided; otherwise it is answered here, or will be."""
        answers = self._answers.setdefault(arrival.port.link, {})
        digest = blake2b(arrival.payload, digest_size=16).digest()
        if digest in answers:
            known = answers[digest]
            if known is not None:
                turn.send(arrival.port, known)
            return None
        operation = find_operation(request.method, request.path)
        if operation is None or operation.id not in self.serves:
            status = 400 if request.path.endswith("/") else 404  # a parameter is empty, or there is no such resource
            self.refuse(
                arrival, request.exchange, status, f"{request.method} {request.path[:128]} is unknown", turn.out
            )
            return None
        try:
            claims = self.tokens.check(turn.now, request.token)
            body = check_request(operation.id, request.body)
        except TokenError as error:
            self.refuse(arrival, request.exchange, 401, str(error), turn.out)
            return None
        except DecodeError as error:
            self.refuse(arrival, request.exchange, 400, str(error), turn.out)
            return None
        needed = sorted(scope.value for scope in self.serves[operation.id])
        if not claims.scopes.intersection(needed):
            self.refuse(arrival, request.exchange, 403, f"it needs the scope {' or '.join(needed)}", turn.out)
            return None
        answers[digest] = None
        return IncomingRequest(
            arrival.port, request.exchange, digest, operation.id, operation.parameters, body, claims, arrival.ref
        )

    def answer(self, request: IncomingRequest, status: int, body: Body | None, out: Outbox) -> None:
        """Send the response, and remember it."""
        payload = _response(request.exchange, status, body)
        answers = self._answers[request.port.link]
        answers[request.digest] = payload
        if len(answers) > REMEMBERED:
            del answers[next(iter(answers))]
        out.send(request.port, payload, (request.ref,))

    def refuse(self, arrival: Arrival, exchange: int, status: int, message: str, out: Outbox) -> None:
        """Answer a request that is not to be decided, and count it; it changes nothing."""
        self.count_bad(message, arrival.ref, out)
        out.send(arrival.port, _response(exchange, status, {"message": message}), (arrival.ref,))

    def count_bad(self, reason: str, ref: FrameId, out: Outbox) -> None:
        """Count a frame that nobody can answer, or that was refused."""
        self.bad_requests += 1
        if worth_noting(self.bad_requests):
            out.note("decision.uss_bad_request", self.name, {"count": self.bad_requests, "reason": reason}, (ref,))


def file_report(turn: Turn, kind: str, request: IncomingRequest) -> dict[str, Any]:
    """Note a problem that another service reports; returns the body of the answer, with the id of the report."""
    problem = str(request.body["exchange"].get("problem") or "")[:256]
    turn.note(kind, request.claims.uss, {"problem": problem})
    return {**request.body, "report_id": make_uuid(f"report {request.claims.uss} {turn.now} {request.exchange}")}


def _response(exchange: int, status: int, body: Body | None) -> bytes:
    frame = UssResponse.model_construct(exchange=exchange, status=status, body=None if body is None else dict(body))
    return encode(frame)


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
