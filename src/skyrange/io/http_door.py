"""Who may hold a connection to an HTTP end, and for how long? aiohttp's server, with limits on both.

aiohttp itself answers what is not HTTP with 400, bounds lines, headers and pipelined requests, and closes a
connection that brings no whole header within `patience_s`.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from typing import Any

from aiohttp import web

MOST_CONNECTIONS = 128
LINGER_S = 1.0
_NOT_HTTP = "UNKNOWN"
"""aiohttp's method of a request that it could not read."""
_LOG = logging.getLogger(__name__)
_LOG.addHandler(logging.NullHandler())
_LOG.propagate = False  # a flood of bad requests would fill the standard error


class LimitedServer(web.Server):
    """At most `MOST_CONNECTIONS` at a time. Who comes then is turned away; who says nothing is closed and counted."""

    def __init__(self, handler: Callable[[web.BaseRequest], Awaitable[web.StreamResponse]], patience_s: float) -> None:
        """`handler` answers each request that is HTTP."""
        self.turned_away = 0
        self.not_http = 0
        self.silent = 0
        """Connections that ended without one whole header."""
        self._mute: set[web.RequestHandler] = set()
        super().__init__(
            handler,
            request_factory=self._hear,
            keepalive_timeout=patience_s,
            lingering_time=LINGER_S,
            auto_decompress=False,
            access_log=None,
            logger=_LOG,
        )

    def connection_made(self, handler: web.RequestHandler, transport: asyncio.Transport) -> None:
        """Called by aiohttp."""
        super().connection_made(handler, transport)
        if len(self.connections) > MOST_CONNECTIONS:
            self.turned_away += 1
            transport.abort()
            return
        transport.set_write_buffer_limits(high=0)  # so that an answer is out, or its writing is not done
        self._mute.add(handler)

    def connection_lost(self, handler: web.RequestHandler, exc: BaseException | None = None) -> None:
        """Called by aiohttp."""
        super().connection_lost(handler, exc)
        if handler in self._mute:
            self._mute.discard(handler)
            self.silent += 1

    def _hear(self, message: Any, payload: Any, protocol: Any, writer: Any, task: Any) -> web.BaseRequest:
        self._mute.discard(protocol)
        self.not_http += message.method == _NOT_HTTP
        return self._make_request(message, payload, protocol, writer, task)
