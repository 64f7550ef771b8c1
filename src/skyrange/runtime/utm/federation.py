"""Exchanges of a service with the federation over HTTP: requests of others, and its own to the DSS and other USSs."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Mapping
from typing import Any, Final
from urllib.parse import unquote, urlsplit

import aiohttp
from pydantic import ValidationError

from skyrange.codec.f3548.frames import MAX_FRAME_BYTES, UssRequest, UssResponse, decode, encode
from skyrange.codec.json_errors import describe
from skyrange.codec.strict_json import MAX_DEPTH, parse_json, parse_json_object
from skyrange.contracts.mailboxes import Departure
from skyrange.core.errors import DecodeError
from skyrange.core.ids import Port, endpoint, link_name
from skyrange.io.http.limited_server import read_bounded
from skyrange.runtime.utm.tokens import TokenClient, parse_request
from skyrange.utm.federated.exchanges import Peer

ANSWER_S: Final = 15.0
"""How long a request of another service waits: a USS may ask the DSS and every peer before it answers."""
CALL_S: Final = 6.0
"""How long a request to another service waits for its response; the agent gives up after as long."""
MAX_OPEN: Final = 1_024
"""Requests of others that wait at a time."""
UNAVAILABLE: Final = 503
_BODY_DEPTH: Final = MAX_DEPTH - 1
"""A frame has the body one level deeper."""

Deliver = Callable[[Port, bytes, str], None]
"""`deliver(port, payload, sender)` gives the agent a frame."""


class OpenDirectory:
    """Every USS that can be called by its base URL, or those of a list."""

    def __init__(self, name: str, base_url: str, allowed: frozenset[str]) -> None:
        """`name` and `base_url` are those of the USS that has the directory; `allowed` is empty for all."""
        self._endpoint = endpoint("approval", name)
        self._own = base_url
        self._allowed = allowed
        self.ports: tuple[Port, ...] = ()

    def find(self, base_url: str) -> Peer | None:
        """The USS at a base URL."""
        url = base_url.rstrip("/")
        if url == self._own or (self._allowed and url not in self._allowed):
            return None
        try:
            parts = urlsplit(url)
            host = parts.hostname
        except ValueError:
            return None
        if parts.scheme not in ("http", "https") or not host:
            return None
        return Peer(host, Port(self._endpoint, link_name("uss", url)))


class Inbound:
    """Requests of other services to the agent: each becomes a frame, and the response frame answers it."""

    def __init__(self, port: Port, deliver: Deliver) -> None:
        """Requests arrive at `port`, at which the agent answers."""
        self.port = port
        self._deliver = deliver
        self._open: dict[int, asyncio.Future[UssResponse]] = {}
        self._count = 0

    async def ask(self, method: str, path: str, token: str, body: dict[str, Any] | None) -> UssResponse:
        """The agent's response to a request; 503 where it does not answer in time.

        Raises `DecodeError` for a request that no frame can carry.
        """
        if len(self._open) >= MAX_OPEN:
            return _unavailable(0, "too many requests are open")
        self._count += 1
        try:
            frame = UssRequest(exchange=self._count, method=method, path=path, token=token, body=body)  # type: ignore[arg-type]
        except ValidationError as error:
            raise describe(error) from error
        payload = encode(frame)
        if len(payload) > MAX_FRAME_BYTES:  # ASCII takes more than UTF-8
            message = f"the request is too long: {len(payload)} bytes, at most {MAX_FRAME_BYTES}"
            return UssResponse(exchange=frame.exchange, status=413, body={"message": message})
        future: asyncio.Future[UssResponse] = asyncio.get_running_loop().create_future()
        self._open[frame.exchange] = future
        try:
            self._deliver(self.port, payload, "http")
            async with asyncio.timeout(ANSWER_S):
                return await future
        except TimeoutError:
            return _unavailable(frame.exchange, "the service did not answer")
        finally:
            del self._open[frame.exchange]

    def on_departure(self, departure: Departure) -> None:
        """The agent has answered a request."""
        response = decode(departure.payload)
        future = self._open.get(response.exchange)
        if isinstance(response, UssResponse) and future is not None and not future.done():
            future.set_result(response)


class Outbound:
    """Requests of the agent to other services: each frame becomes an HTTP request, and its response a frame."""

    def __init__(
        self, session: aiohttp.ClientSession, tokens: TokenClient, urls: Mapping[str, str], deliver: Deliver
    ) -> None:
        """`urls`: base URLs by link, for those that are not the URL themselves (`OpenDirectory`)."""
        self._session = session
        self._tokens = tokens
        self._urls = dict(urls)
        self._deliver = deliver
        self._open: dict[tuple[str, int], asyncio.Task[None]] = {}

    def on_departure(self, departure: Departure) -> None:
        """Make the request of a frame, unless it is the repetition of one that is open."""
        request = decode(departure.payload)
        key = departure.port.link, request.exchange
        if not isinstance(request, UssRequest) or key in self._open:
            return
        task = asyncio.get_running_loop().create_task(self._request(departure.port, request))
        self._open[key] = task
        task.add_done_callback(lambda _: self._open.pop(key, None))

    def close(self) -> None:
        """Make no more requests."""
        for task in list(self._open.values()):
            task.cancel()

    async def _request(self, port: Port, request: UssRequest) -> None:
        base = self._urls.get(port.link) or port.link.split(":", 1)[1]
        try:
            async with asyncio.timeout(CALL_S):
                response = await self._call(base, request)
        except (aiohttp.ClientError, OSError, TimeoutError, ValueError, DecodeError) as error:
            response = _unavailable(request.exchange, str(error) or type(error).__name__)
        payload = encode(response)
        if len(payload) > MAX_FRAME_BYTES:
            payload = encode(_unavailable(request.exchange, "the response is too long"))
        self._deliver(port, payload, base)

    async def _call(self, base: str, request: UssRequest) -> UssResponse:
        wanted = parse_request(request.token)
        token = await self._tokens.get(*wanted)
        headers = {"Authorization": f"Bearer {token}", "Accept": "application/json"}
        json_body = None if request.body is None else json.dumps(request.body, allow_nan=False).encode()
        if json_body is not None:
            headers["Content-Type"] = "application/json"
        async with self._session.request(
            request.method, base + request.path, data=json_body, headers=headers, allow_redirects=False
        ) as response:
            if response.status == 401:
                self._tokens.forget(*wanted)
            content = await read_bounded(response.content, response.content_length, MAX_FRAME_BYTES)
            return UssResponse(exchange=request.exchange, status=response.status, body=_body(response.status, content))


def _body(status: int, content: bytes | None) -> dict[str, Any] | None:
    """The body of a response; text where an error has no JSON."""
    if not content:
        return None if content is not None else {"message": "the response is too long"}
    try:
        data = parse_json(content, _BODY_DEPTH)
    except DecodeError:
        data = None
    if isinstance(data, dict):
        return data
    return {"message": content[:256].decode(errors="replace")} if status >= 400 else {}


def _unavailable(exchange: int, message: str) -> UssResponse:
    return UssResponse(exchange=exchange, status=UNAVAILABLE, body={"message": message[:256]})


def parse_body(content: bytes) -> dict[str, Any] | None:
    """The JSON object of a request, `None` for an empty body. Raises `DecodeError`."""
    if not content:
        return None
    return parse_json_object(content, _BODY_DEPTH)


def parse_path(raw: str) -> str:
    """The path of a request target, without its query. Raises `DecodeError`."""
    path = unquote(raw.partition("?")[0])
    if not path.startswith("/") or len(path) > 512 or not path.isprintable():
        raise DecodeError("a path of at most 512 printable characters is needed")
    return path
