"""HTTP server with a limit on the number of connections, the time that a client may take, and the size of bodies.

aiohttp itself answers bytes that are not HTTP with 400, bounds lines, headers and pipelined requests, and closes a
connection that sends no complete header within `patience_s`.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from typing import Any

import aiohttp
from aiohttp import web


async def read_bounded(content: aiohttp.StreamReader, announced: int | None, limit: int) -> bytes | None:
    """A complete body, or `None` if it is longer than `limit` bytes; not much more than that is read."""
    if announced is not None and announced > limit:
        return None
    body = bytearray()
    async for chunk in content.iter_any():
        body += chunk
        if len(body) > limit:
            return None
    return bytes(body)


MAX_CONNECTIONS = 128
LINGER_S = 1.0
_NOT_HTTP = "UNKNOWN"
"""aiohttp's method of a request that it could not read."""
_LOG = logging.getLogger(__name__)
_LOG.addHandler(logging.NullHandler())
_LOG.propagate = False  # a flood of bad requests would fill the standard error


class LimitedServer(web.Server):
    """aiohttp's server with at most `MAX_CONNECTIONS` at a time: above it the oldest silent one is closed,
    or the new one; all are counted.
    """

    def __init__(self, handler: Callable[[web.BaseRequest], Awaitable[web.StreamResponse]], patience_s: float) -> None:
        """`handler` answers each request that is HTTP."""
        self.refused = 0
        self.not_http = 0
        self.silent = 0
        """Connections that ended without one complete header."""
        self._without_header: dict[web.RequestHandler, asyncio.Transport] = {}
        super().__init__(
            handler,
            request_factory=self._make,
            keepalive_timeout=patience_s,
            lingering_time=LINGER_S,
            auto_decompress=False,
            access_log=None,
            logger=_LOG,
        )

    def connection_made(self, handler: web.RequestHandler, transport: asyncio.Transport) -> None:
        """Called by aiohttp."""
        super().connection_made(handler, transport)
        if len(self.connections) > MAX_CONNECTIONS:
            self.refused += 1
            oldest = next(iter(self._without_header), None)
            if oldest is None:
                transport.abort()
                return
            self._without_header.pop(oldest).abort()  # a client is silent for a moment only
        transport.set_write_buffer_limits(high=0)  # so that an answer is out, or its writing is not done
        self._without_header[handler] = transport

    def connection_lost(self, handler: web.RequestHandler, exc: BaseException | None = None) -> None:
        """Called by aiohttp."""
        super().connection_lost(handler, exc)
        if self._without_header.pop(handler, None) is not None:
            self.silent += 1

    def _make(self, message: Any, payload: Any, protocol: Any, writer: Any, task: Any) -> web.BaseRequest:
        self._without_header.pop(protocol, None)
        self.not_http += message.method == _NOT_HTTP
        return self._make_request(message, payload, protocol, writer, task)
