"""Requests of operators to a flight approval: read, checked, answered once each, and put in order where they compete.

A request that comes again, because its answer may have been lost, gets the same answer without another decision. Bad
bytes are counted, noted and answered with 400; requests in the name of others with 403.

Without a policy of order an approval decides each request when it arrives: first come, first served.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from typing import Final, NamedTuple

from skyrange.contracts.mailboxes import Arrival, Outbox, Turn
from skyrange.core.errors import DecodeError
from skyrange.core.ids import FrameId, Port, operator_of
from skyrange.core.time import Time
from skyrange.core.whole_numbers import worth_noting
from skyrange.utm.intent_states import IntentState
from skyrange.utm.messages import PATH, EndBody, ErrorBody, Request, Response, decode_request, encode

REMEMBERED: Final = 4_096
"""Answers kept per operator for requests that come again; older ones would be decided anew."""


@dataclass(frozen=True, slots=True)
class OpenRequest:
    """A request that awaits its answer."""

    operator: str
    request: Request
    payload: bytes
    digest: bytes
    """What tells it from other requests for the same intent."""
    cause: FrameId


class RequestBook:
    """The requests of some operators, each on its own port. Deep-copyable."""

    def __init__(self, ports: Sequence[tuple[str, Port]]) -> None:
        """`ports`: (operator, port) of each."""
        self.bad_frames: dict[str, int] = {operator: 0 for operator, _ in ports}
        """Requests per operator that were not understood."""
        self._operator_of = {port.link: operator for operator, port in ports}
        self._port_of = dict(ports)
        self._owners: dict[str, str] = {}
        """Of the intents that are held, or asked for."""
        self._held: set[str] = set()
        """Intents that were accepted and have not ended."""
        self.accepted = dict.fromkeys(self.bad_frames, 0)
        """Intents of each operator that were accepted so far, those that have ended included."""
        self._answers: dict[str, dict[str, tuple[bytes, bytes]]] = {operator: {} for operator, _ in ports}
        self._open: dict[tuple[str, str], bytes] = {}

    @property
    def operators(self) -> Container[str]:
        """Whose requests these are."""
        return self._port_of

    def restore(self, operator: str, intent: str) -> None:
        """An intent is that of an operator, as was decided before a restart."""
        self._owners[intent] = operator
        self._hold(operator, intent)

    def read(self, arrival: Arrival, out: Outbox) -> OpenRequest | None:
        """The request in a frame, if it is to be decided; otherwise it is answered here, or will be."""
        operator = self._operator_of[arrival.port.link]
        try:
            request = decode_request(arrival.payload)
        except DecodeError as error:
            self._refuse(operator, arrival, Response.error(400, PATH, str(error)), out)
            return None
        body = request.body
        if self._owners.get(body.id, operator) != operator:
            message = f"operator {operator!r} names {body.id}, an intent of another operator"
        elif body.operator != operator or operator_of(body.vehicle) != operator:
            message = f"operator {operator!r} asks for {body.vehicle!r} of {body.operator!r}"
        else:
            message = ""
        if message:
            self._refuse(operator, arrival, Response.error(403, request.path, message), out)
            return None
        digest = blake2b(arrival.payload, digest_size=16).digest()
        open_request = OpenRequest(operator, request, arrival.payload, digest, arrival.ref)
        known = self._answers[operator].get(body.id)
        if known is not None and known[0] == open_request.digest:
            out.send(arrival.port, known[1], (arrival.ref,))
            return None
        if self._open.get((operator, body.id)) == open_request.digest:
            return None
        self._open[operator, body.id] = open_request.digest
        self._owners[body.id] = operator
        return open_request

    def answer(self, open_request: OpenRequest, payload: bytes, out: Outbox, *, accepted: bool = False) -> None:
        """Send the frame of an answer, and remember it. `accepted` says whether the intent is held now."""
        operator, intent = open_request.operator, open_request.request.body.id
        if self._open.get((operator, intent)) == open_request.digest:
            del self._open[operator, intent]
        if accepted:
            self._hold(operator, intent)
        elif isinstance(open_request.request.body, EndBody):
            self._held.discard(intent)
        if intent not in self._held and (operator, intent) not in self._open:
            self._owners.pop(intent, None)  # whoever asks for it next may have it
        answers = self._answers[operator]
        answers.pop(intent, None)
        answers[intent] = (open_request.digest, payload)
        if len(answers) > REMEMBERED:
            forgotten = next(iter(answers))
            del answers[forgotten]
        out.send(self._port_of[operator], payload, (open_request.cause,))

    def _hold(self, operator: str, intent: str) -> None:
        if intent not in self._held:
            self._held.add(intent)
            self.accepted[operator] += 1

    def retract(self, turn: Turn, operator: str, intent: str, payload: bytes) -> None:
        """Send the frame of a response that nobody asked for, and forget the answer that it takes back."""
        self._answers[operator].pop(intent, None)
        turn.send(self._port_of[operator], payload)

    def _refuse(self, operator: str, arrival: Arrival, response: Response, out: Outbox) -> None:
        count = self.bad_frames[operator] = self.bad_frames[operator] + 1
        if worth_noting(count):
            reason = response.body.message if isinstance(response.body, ErrorBody) else ""
            out.note("decision.approval_bad_request", operator, {"count": count, "reason": reason}, (arrival.ref,))
        out.send(arrival.port, encode(response), (arrival.ref,))


class WaitingRequest(NamedTuple):
    """What a policy knows of a request that waits."""

    operator: str
    arrived_ns: Time
    accepted: int
    """How many intents of the operator were accepted so far, those that have ended included."""
    tie: bytes
    """Digest of the request, which favours nobody."""


RequestOrder = Callable[[Sequence[WaitingRequest]], int]
"""A policy: the number of the request, of one or more that wait in order of arrival, that is decided next."""


def least_served(waiting: Sequence[WaitingRequest]) -> int:
    """Prefer the operator with the fewest accepted intents; of equal ones, the earliest request."""
    return min(range(len(waiting)), key=lambda row: (waiting[row].accepted, waiting[row].arrived_ns, waiting[row].tie))


class RequestQueue:
    """Requests for airspace that wait for others to compete with. Deep-copyable.

    The first one opens a window of time. At its end all that wait are decided, in the order of the policy.
    """

    def __init__(self, order: RequestOrder, window_ns: Time) -> None:
        self._order = order
        self._window_ns = window_ns
        self._waiting: list[tuple[Time, OpenRequest]] = []
        self.due: Time | None = None
        """When the window ends."""

    def add(self, now: Time, open_request: OpenRequest) -> bool:
        """Let a request wait; False for one that does not claim airspace for a later flight, which cannot wait."""
        body = open_request.request.body
        if isinstance(body, EndBody) or body.state is not IntentState.ACCEPTED:
            return False
        if not self._waiting:
            self.due = now + self._window_ns
        self._waiting.append((now, open_request))
        return True

    def take(self, now: Time, accepted: Mapping[str, int]) -> OpenRequest | None:
        """The next request, if the window is over. `accepted`: how many intents of each operator were accepted."""
        if self.due is None or now < self.due:
            return None
        rows = [
            WaitingRequest(open_request.operator, at, accepted[open_request.operator], open_request.digest)
            for at, open_request in self._waiting
        ]
        return self._remove(self._order(rows))

    def take_earlier(self, intent: str) -> OpenRequest | None:
        """The request for an intent that waits while another one for it arrives."""
        for row, (_, open_request) in enumerate(self._waiting):
            if open_request.request.body.id == intent:
                return self._remove(row)
        return None

    def _remove(self, row: int) -> OpenRequest:
        _, open_request = self._waiting.pop(row)
        if not self._waiting:
            self.due = None
        return open_request
