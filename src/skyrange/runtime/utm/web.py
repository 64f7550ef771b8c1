"""HTTP of a UTM service: requests are read, bounded and routed to its agent, its operators or its other interfaces."""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final
from urllib.parse import parse_qsl

import aiohttp
from aiohttp import web

from skyrange.codec.f3548.frames import MAX_FRAME_BYTES
from skyrange.core.errors import DecodeError
from skyrange.core.secrets import is_same_secret
from skyrange.core.time import Time
from skyrange.core.whole_numbers import worth_noting
from skyrange.io.http.limited_server import LimitedServer, read_bounded
from skyrange.runtime.utm import flight_planning
from skyrange.runtime.utm.federation import Inbound, parse_body, parse_path
from skyrange.runtime.utm.flight_planning import FlightPlanning, answer_version
from skyrange.runtime.utm.operators import Operators
from skyrange.runtime.utm.tokens import Authorization
from skyrange.utm.federated.tokens import TokenChecker, TokenError
from skyrange.utm.messages import PATH, Request, decode_request_body

PATIENCE_S: Final = 10.0
"""How long a client may take for a header or a body."""
METHODS: Final = ("GET", "POST", "PUT", "DELETE")
HEALTH: Final = "/healthy"
TOKEN: Final = "/token"  # noqa: S105 - a path
_Answer = tuple[int, dict[str, Any] | None]
_LOG: Final = logging.getLogger(__name__)


@dataclass(slots=True)
class Routes:
    """What a service has."""

    checker: TokenChecker | None = None
    now: Callable[[], Time] = lambda: 0
    prefixes: tuple[str, ...] = ()
    """Paths of the agent."""
    inbound: Inbound | None = None
    operators: Operators | None = None
    secrets: Mapping[str, str] = field(default_factory=dict)
    """Bearer tokens of operators, by operator."""
    planning: FlightPlanning | None = None
    authorization: Authorization | None = None


class WebService:
    """The HTTP side of one service."""

    def __init__(self, routes: Routes) -> None:
        """Requests for other paths than those of `routes` get 404."""
        self._routes = routes
        self._failed = 0
        self.server = LimitedServer(self._handle, PATIENCE_S)

    async def _handle(self, request: web.BaseRequest) -> web.StreamResponse:
        try:
            path = parse_path(request.raw_path if request.raw_path.startswith("/") else request.path)
            async with asyncio.timeout(PATIENCE_S):
                content = await read_bounded(request.content, request.content_length, MAX_FRAME_BYTES)
            if content is None:
                return _response(413, {"message": f"a body has at most {MAX_FRAME_BYTES} bytes"})
            status, body = await self._answer(request, path, content)
        except DecodeError as error:
            return _response(400, {"message": str(error)})
        except TimeoutError:
            return _response(408, {"message": "the body did not come in time"})
        except (OSError, aiohttp.ClientError, web.RequestPayloadError) as error:
            return _response(400, {"message": str(error)[:256]})
        except Exception as error:
            self._failed += 1
            if worth_noting(self._failed):
                words = f"{request.method[:16]} {request.path[:128]!a}: 500, {self._failed} so far"
                _LOG.error("%s", words, exc_info=error)
            return _response(500, {"message": "the service failed at this request; its log says why"})
        return _response(status, body)

    async def _answer(self, request: web.BaseRequest, path: str, content: bytes) -> _Answer:
        routes, method = self._routes, request.method
        authorization = request.headers.get("Authorization", "")
        if method not in METHODS:
            return 405, {"message": f"{method[:16]} is not a method of this service"}
        if path == HEALTH:
            return 200, {"status": "ok"}
        if routes.inbound is not None and path.startswith(routes.prefixes):
            response = await routes.inbound.ask(method, path, _bearer(authorization), parse_body(content))
            return response.status, response.body
        if routes.authorization is not None and path == TOKEN:
            return routes.authorization.answer(_fields(request, content), authorization)
        if routes.operators is not None and path.startswith(PATH):
            return await self._ask_operator(routes.operators, method, path, _bearer(authorization), content)
        if routes.planning is not None and path.startswith((flight_planning.PREFIX, flight_planning.VERSIONING_PREFIX)):
            return await self._test(routes.planning, request, path, _bearer(authorization), content)
        return 404, {"message": f"{method} {path[:128]} is unknown"}

    async def _ask_operator(self, operators: Operators, method: str, path: str, token: str, content: bytes) -> _Answer:
        """Pass the request of an operator on."""
        matching = [name for name, secret in self._routes.secrets.items() if is_same_secret(token, secret)]
        if not matching:
            return 401, {"message": "the bearer token of an operator is needed"}
        if method not in ("PUT", "DELETE"):
            return 405, {"message": "an operational intent is PUT, and ended by DELETE"}
        request: Request = decode_request_body(method, path, content)
        response = await operators.ask(matching[0], request)
        return response.status, response.body.model_dump(mode="json", exclude_none=True)

    async def _test(
        self, planning: FlightPlanning, request: web.BaseRequest, path: str, token: str, content: bytes
    ) -> _Answer:
        """Answer a request of an automated test."""
        assert self._routes.checker is not None
        try:
            scopes = self._routes.checker.check(self._routes.now(), token).scopes
        except TokenError as error:
            return 401, {"message": str(error)}
        if path.startswith(flight_planning.VERSIONING_PREFIX):
            return answer_version(path.removeprefix(flight_planning.VERSIONING_PREFIX), scopes)
        below = path.removeprefix(flight_planning.PREFIX)
        return await planning.answer(request.method, below, request.query, parse_body(content), scopes)


def _fields(request: web.BaseRequest, content: bytes) -> Mapping[str, str]:
    """The fields of a form, or of the query of a request that has none. Raises `DecodeError`."""
    if request.method != "POST":
        return {name: value for name, value in request.query.items() if name != "client_secret"}  # no secrets in URLs
    if request.content_type != "application/x-www-form-urlencoded":
        raise DecodeError("a form is needed (application/x-www-form-urlencoded)")
    try:
        return dict(parse_qsl(content.decode(), max_num_fields=32))
    except ValueError as error:
        raise DecodeError(f"the form cannot be read: {error}"[:200]) from error


def _bearer(header: str) -> str:
    kind, _, token = header.partition(" ")
    return token.strip() if kind.lower() == "bearer" else ""


def _response(status: int, body: dict[str, Any] | None) -> web.Response:
    if body is None:
        return web.Response(status=status)
    text = json.dumps(body, allow_nan=False, separators=(",", ":"))
    return web.Response(status=status, body=text.encode(), content_type="application/json")
