"""HTTP server with a limit on the time that a client may take, and on the size of bodies; `io.limited_listener` limits
the connections.

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


LINGER_S = 1.0
_NOT_HTTP = "UNKNOWN"
"""aiohttp's method of a request that it could not read."""
_LOG = logging.getLogger(__name__)
_LOG.addHandler(logging.NullHandler())
_LOG.propagate = False  # a flood of bad requests would fill the standard error


class LimitedServer(web.Server):
    """aiohttp's server, which counts connections that say nothing, or nothing that is HTTP."""

    def __init__(self, handler: Callable[[web.BaseRequest], Awaitable[web.StreamResponse]], patience_s: float) -> None:
        """`handler` answers each request that is HTTP."""
        self.not_http = 0
        self.silent = 0
        """Connections that ended without one complete header."""
        self._without_header: set[web.RequestHandler] = set()
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
        transport.set_write_buffer_limits(high=0)  # so that an answer is out, or its writing is not done
        self._without_header.add(handler)

    def connection_lost(self, handler: web.RequestHandler, exc: BaseException | None = None) -> None:
        """Called by aiohttp."""
        super().connection_lost(handler, exc)
        self.silent += handler in self._without_header
        self._without_header.discard(handler)

    def _make(self, message: Any, payload: Any, protocol: Any, writer: Any, task: Any) -> web.BaseRequest:
        self._without_header.discard(protocol)
        self.not_http += message.method == _NOT_HTTP
        return self._make_request(message, payload, protocol, writer, task)
