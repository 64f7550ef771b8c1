"""Exchanges of requests and responses on `uss` links: the side that asks, and the side that answers.

A request that is not answered is sent again with the same bytes; who answers knows it again, and repeats its response
without acting twice.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from hashlib import blake2b
from typing import Any, Final

from uas_standards.astm.f3548.v21.api import OperationID
from uas_standards.astm.f3548.v21.constants import Scope

from skyrange.codec.f3548.frames import UssRequest, UssResponse, encode
from skyrange.codec.f3548.operations import check_request, check_response, find_operation, path_of
from skyrange.contracts.mailboxes import Arrival, Outbox
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
    """The requests of one agent. Deep-copyable."""

    _calls: dict[int, Call] = field(default_factory=dict)
    _count: int = 0

    @property
    def due(self) -> Time:
        """When `on_time` has something to do."""
        return min((call.due for call in self._calls.values()), default=NEVER)

    def call(
        self,
        now: Time,
        receiver: str,
        port: Port,
        token: str,
        operation: OperationID,
        parameters: Mapping[str, str],
        body: Body | None,
        causes: Refs,
        out: Outbox,
    ) -> int:
        """Send a request; returns the number of its exchange."""
        self._count += 1
        method, path = path_of(operation, **parameters)
        frame = UssRequest.model_construct(
            exchange=self._count, method=method, path=path, token=token, body=None if body is None else dict(body)
        )
        call = Call(self._count, operation, receiver, port, encode(frame), causes, now + TIMEOUT_NS)
        self._calls[call.exchange] = call
        out.send(port, call.payload, causes)
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

    def on_time(self, now: Time, out: Outbox) -> list[Call]:
        """Send again what was not answered; returns the calls that are given up."""
        given_up = []
        for call in [one for one in self._calls.values() if one.due <= now]:
            if call.tries >= MAX_TRIES:
                del self._calls[call.exchange]
                given_up.append(call)
                continue
            call.tries += 1
            call.due = now + TIMEOUT_NS
            out.send(call.port, call.payload, call.causes)
        return given_up


@dataclass(frozen=True, slots=True)
class Asked:
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

    def read(self, now: Time, arrival: Arrival, request: UssRequest, out: Outbox) -> Asked | None:
        """What is asked, if it is to be decided; otherwise it is answered here, or will be."""
        answers = self._answers.setdefault(arrival.port.link, {})
        digest = blake2b(arrival.payload, digest_size=16).digest()
        if digest in answers:
            known = answers[digest]
            if known is not None:
                out.send(arrival.port, known, (arrival.ref,))
            return None
        operation = find_operation(request.method, request.path)
        if operation is None or operation.id not in self.serves:
            status = 400 if request.path.endswith("/") else 404  # a parameter is empty, or there is no such resource
            self.refuse(arrival, request.exchange, status, f"{request.method} {request.path[:128]} is unknown", out)
            return None
        try:
            claims = self.tokens.check(now, request.token)
            body = check_request(operation.id, request.body)
        except TokenError as error:
            self.refuse(arrival, request.exchange, 401, str(error), out)
            return None
        except DecodeError as error:
            self.refuse(arrival, request.exchange, 400, str(error), out)
            return None
        needed = sorted(scope.value for scope in self.serves[operation.id])
        if not claims.scopes.intersection(needed):
            self.refuse(arrival, request.exchange, 403, f"it needs the scope {' or '.join(needed)}", out)
            return None
        answers[digest] = None
        return Asked(
            arrival.port, request.exchange, digest, operation.id, operation.parameters, body, claims, arrival.ref
        )

    def answer(self, asked: Asked, status: int, body: Body | None, out: Outbox) -> None:
        """Send the response, and remember it."""
        payload = _response(asked.exchange, status, body)
        answers = self._answers[asked.port.link]
        answers[asked.digest] = payload
        if len(answers) > REMEMBERED:
            del answers[next(iter(answers))]
        out.send(asked.port, payload, (asked.ref,))

    def refuse(self, arrival: Arrival, exchange: int, status: int, message: str, out: Outbox) -> None:
        """Answer a request that is not to be decided, and count it; it changes nothing."""
        self.count_bad(message, arrival.ref, out)
        out.send(arrival.port, _response(exchange, status, {"message": message}), (arrival.ref,))

    def count_bad(self, reason: str, ref: FrameId, out: Outbox) -> None:
        """Count a frame that nobody can answer, or that was refused."""
        self.bad_requests += 1
        if worth_noting(self.bad_requests):
            out.note("decision.uss_bad_request", self.name, {"count": self.bad_requests, "reason": reason}, (ref,))


def file_report(kind: str, now: Time, asked: Asked, out: Outbox) -> dict[str, Any]:
    """Note a problem that another service reports; returns the body of the answer, with the id of the report."""
    problem = str(asked.body["exchange"].get("problem") or "")[:256]
    out.note(kind, asked.claims.uss, {"problem": problem}, (asked.ref,))
    return {**asked.body, "report_id": make_uuid(f"report {asked.claims.uss} {now} {asked.exchange}")}


def _response(exchange: int, status: int, body: Body | None) -> bytes:
    frame = UssResponse.model_construct(exchange=exchange, status=status, body=None if body is None else dict(body))
    return encode(frame)
