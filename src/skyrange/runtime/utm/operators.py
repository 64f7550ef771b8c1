"""Requests of operators to a USS: `approval` messages over HTTP, and what the USS tells them unasked."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final

from skyrange.contracts.mailboxes import Departure
from skyrange.core.ids import APPROVAL, Port, link_name
from skyrange.core.time import Time
from skyrange.runtime.utm.federation import ANSWER_S, Deliver
from skyrange.utm.messages import MAX_FRAME_BYTES, DecisionBody, Request, Response, decode_response, encode

REMEMBERED: Final = 1_000
"""Notices kept for each operator."""


@dataclass(frozen=True, slots=True)
class Notice:
    """What a USS has told an operator unasked."""

    at: Time
    body: DecisionBody


@dataclass(slots=True)
class _Waiting:
    version: int | None
    future: asyncio.Future[Response]


class Operators:
    """The operators of one USS."""

    def __init__(self, names: Iterable[str], deliver: Deliver, now: Callable[[], Time]) -> None:
        """`names` of the operators."""
        self.ports = {name: Port(APPROVAL, link_name(APPROVAL, name)) for name in names}
        self.notices: dict[str, deque[Notice]] = {name: deque(maxlen=REMEMBERED) for name in self.ports}
        self._operator_of = {port.link: name for name, port in self.ports.items()}
        self._deliver = deliver
        self._now = now
        self._open: dict[tuple[str, str], deque[_Waiting]] = {}

    async def ask(self, operator: str, request: Request) -> Response:
        """The answer to a request; 503 where the USS does not answer in time."""
        body = request.body
        version = None if request.method == "DELETE" else getattr(body, "version", None)
        payload = encode(request)
        if len(payload) > MAX_FRAME_BYTES:  # ASCII takes more than UTF-8
            return Response.error(413, request.path, f"{len(payload)} bytes; at most {MAX_FRAME_BYTES} are read")
        waiting = _Waiting(version, asyncio.get_running_loop().create_future())
        key = operator, request.path
        self._open.setdefault(key, deque()).append(waiting)
        try:
            self._deliver(self.ports[operator], payload, operator)
            async with asyncio.timeout(ANSWER_S):
                return await waiting.future
        except TimeoutError:
            return Response.error(503, request.path, "the service did not answer")
        finally:
            self._open[key].remove(waiting)
            if not self._open[key]:
                del self._open[key]

    def on_departure(self, departure: Departure) -> None:
        """The USS has answered a request, or tells something unasked."""
        operator = self._operator_of[departure.port.link]
        response = decode_response(departure.payload)
        body = response.body
        if isinstance(body, DecisionBody) and body.overruled:
            self.notices[operator].append(Notice(self._now(), body))
            return
        if isinstance(body, DecisionBody) and body.conflicts:
            self.notices[operator].append(Notice(self._now(), body))
        version = body.version if isinstance(body, DecisionBody) else None
        waiting = [
            open_request
            for open_request in self._open.get((operator, response.path), ())
            if not open_request.future.done()
        ]
        for open_request in waiting:
            if not isinstance(body, DecisionBody):
                open_request.future.set_result(response)
                return
            if (
                body.decision == "Ended" or open_request.version == version
            ):  # of one that came twice, the USS answers the first
                open_request.future.set_result(response)

    def is_operator_port(self, port: Port) -> bool:
        """Whether a port is that of an operator."""
        return port.link in self._operator_of
