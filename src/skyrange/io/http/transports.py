"""HTTP transport of the `approval` link: a server for the approval, a client for a ground station.

A request frame is an HTTP request and a response frame its response, so that `curl` can file an operational
intent and a foreign service can decide. HTTP guarantees no order among concurrent requests, and neither do these
transports. Each HTTP message of a peer becomes a frame. A lost message is counted, and no frame is made up for it:
the ground station repeats its request in its own time.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass

import aiohttp
from aiohttp import web
from yarl import URL

from skyrange.codec.mavlink.deframer import Piece
from skyrange.core.errors import DecodeError
from skyrange.core.secrets import is_same_secret
from skyrange.core.whole_numbers import worth_noting
from skyrange.io.addresses import OnNote, check_guarded, format_address, ignore_note, with_address
from skyrange.io.http import frames as http_frames
from skyrange.io.http.frames import JSON_TYPE, MAX_BYTES
from skyrange.io.http.limited_server import LimitedServer, read_bounded
from skyrange.io.limited_listener import LimitedListener, listen
from skyrange.io.mavlink.transports import LOOPBACK, Address, OnPiece

ANSWER_S = 10.0
"""How long a request waits for its response; a ground station has repeated it six times by then."""
PATIENCE_S = 10.0
"""How long a client may take for a header, for a body, and for reading its response."""
CLIENT_S = ANSWER_S + 5.0
"""Long enough to receive a server's 504."""
MAX_OPEN = 256
"""Requests that wait for their responses at one transport."""
METHODS = ("PUT", "POST", "DELETE")
"""A POST is taken as a PUT of the same path: many clients make it more easily (`curl --json`)."""
_REMEDY = "Give it a token."


@dataclass(slots=True)
class Counts:
    """Messages so far."""

    frames: int = 0
    """Received messages that became frames."""
    garbage: int = 0
    """Received messages that are no frame: not HTTP, not JSON, another method, too long, too slow."""
    sent: int = 0
    overflowed: int = 0
    """Above `MAX_OPEN`: of a server requests refused, of a client frames not sent."""
    unasked: int = 0
    """Frames that answer no open request."""
    unfit: int = 0
    """Frames that HTTP cannot carry."""
    refused: int = 0
    """Messages without the right token."""
    lost: int = 0
    """Requests without a response: of a server answered with 504, of a client not answered at all."""


@dataclass(slots=True, eq=False)
class _OpenRequest:
    path: str
    answer: asyncio.Future[http_frames.Response]


class HttpServerTransport:
    """The approval's side: received requests become frames, response frames answer them."""

    def __init__(
        self, on_piece: OnPiece, token: str | None, on_note: OnNote, answer_s: float, patience_s: float
    ) -> None:
        """Called by `open`."""
        self._on_piece = on_piece
        self._on_note = on_note
        self._token = token
        self._answer_s = answer_s
        self._patience_s = patience_s
        self._counts = Counts()
        self._open: list[_OpenRequest] = []
        self._limited = LimitedServer(self._serve, patience_s)
        self._listener: LimitedListener | None = None
        self._ending: asyncio.Task[None] | None = None
        self._address: Address = ("", 0)

    @classmethod
    async def open(
        cls,
        on_piece: OnPiece,
        local: Address = (LOOPBACK, 0),
        *,
        token: str | None = None,
        on_note: OnNote = ignore_note,
        answer_s: float = ANSWER_S,
        patience_s: float = PATIENCE_S,
    ) -> HttpServerTransport:
        """Listen at `local` (port 0: any free one), for clients with `token` as their bearer token (RFC 6750).

        Raises `OSError` with an address that cannot be had, `InputError` with one beyond loopback without a token.
        """
        check_guarded("HTTP", local, guarded=token is not None, remedy=_REMEDY)
        end = cls(on_piece, token, on_note, answer_s, patience_s)
        try:
            end._listener = await listen(end._limited, *local)
        except OSError as error:
            raise with_address(local, error) from error
        end._address = end._listener.address[:2]
        return end

    @property
    def counts(self) -> Counts:
        """Messages so far."""
        server = self._limited
        counts = self._counts
        return Counts(
            counts.frames,
            counts.garbage + server.not_http + server.silent,
            counts.sent,
            counts.overflowed + (0 if self._listener is None else self._listener.displaced),
            counts.unasked,
            counts.unfit,
            counts.refused,
            counts.lost,
        )

    @property
    def address(self) -> Address:
        """The address at which it listens."""
        return self._address

    def send(self, payload: bytes) -> bool:
        """Answer the oldest open request of the frame's path; returns `False`, and counts it, if there is none.

        An error may name another path than its request did, for instance if that could not be read. It answers the
        oldest open request of all, since the service answers in order.
        """
        try:
            response = http_frames.read_response(payload)
        except DecodeError:
            self._counts.unfit += 1
            return False
        open_request = next((request for request in self._open if request.path == response.path), None)
        if open_request is None and response.status >= 400 and self._open:
            open_request = self._open[0]
        if open_request is None:
            self._counts.unasked += 1
            return False
        self._open.remove(open_request)
        open_request.answer.set_result(response)
        self._counts.sent += 1
        return True

    def close(self) -> None:
        """Give the port back, and end the connections after what was sent has gone out; open requests get a 503."""
        if self._listener is None or not self._listener.is_open:
            return
        self._listener.close()
        body = http_frames.error_body("the service has ended")
        for request in self._open:
            request.answer.set_result(http_frames.Response(503, request.path, body))
        self._open.clear()
        self._limited.pre_shutdown()
        self._ending = asyncio.get_running_loop().create_task(self._limited.shutdown(1.0))

    # --- one request -----------------------------------------------------------------------------

    async def _serve(self, request: web.BaseRequest) -> web.StreamResponse:
        response = await self._answer(request)
        try:
            async with asyncio.timeout(self._patience_s):
                await response.prepare(request)
                await response.write_eof()
        except TimeoutError:
            self._counts.garbage += 1
            if request.transport is not None:
                request.transport.abort()
            raise ConnectionResetError("the client does not read") from None
        return response

    async def _answer(self, request: web.BaseRequest) -> web.Response:
        if self._token is not None and not is_same_secret(
            request.headers.get("Authorization", ""), f"Bearer {self._token}"
        ):
            self._counts.refused += 1
            if worth_noting(self._counts.refused):
                self._on_note("refused", f"{request.remote} without the token, {self._counts.refused} so far")
            return _error(401, "a bearer token is needed", {"WWW-Authenticate": "Bearer"})
        refusal, frame, path = await self._read(request)
        if refusal is not None:
            self._counts.garbage += 1
            return refusal
        if len(self._open) >= MAX_OPEN or self._listener is None or not self._listener.is_open:
            self._counts.overflowed += 1
            return _error(503, "too many requests are open", {"Retry-After": "1"})
        loop = asyncio.get_running_loop()
        waiting = _OpenRequest(path, loop.create_future())
        self._open.append(waiting)
        self._counts.frames += 1
        self._on_piece(Piece(frame, garbage=False))
        # not asyncio.timeout, which would cancel what `send` may be about to set
        done, _ = await asyncio.wait([waiting.answer], timeout=self._answer_s)
        if not done:
            self._open.remove(waiting)
            self._counts.lost += 1
            return _error(504, "the service did not answer")
        answer = waiting.answer.result()
        # the path that the frame names, where it is another than was asked for (RFC 9110, 8.7)
        where = {} if answer.path == path else {"Content-Location": http_frames.quoted(answer.path)}
        return web.Response(status=answer.status, body=answer.body, content_type=JSON_TYPE, headers=where)

    async def _read(self, request: web.BaseRequest) -> tuple[web.Response | None, bytes, str]:
        """An error response, or else the frame and its path."""
        path = request.path
        if request.method not in METHODS:
            allowed = {"Allow": ", ".join(METHODS)}
            return _error(405, "an operational intent is PUT, and ended by DELETE", allowed), b"", path
        # a web page may send other types to loopback behind its reader's back, and this one not
        if request.content_type != JSON_TYPE or "Content-Encoding" in request.headers:
            return _error(415, f"the body has to be {JSON_TYPE}, not encoded"), b"", path
        try:
            if request.query_string or http_frames.quoted(path) == "":
                raise DecodeError("path: expected no query")
            async with asyncio.timeout(self._patience_s):
                body = await read_bounded(request.content, request.content_length, MAX_BYTES)
            if body is None:
                return _error(413, f"at most {MAX_BYTES} bytes"), b"", path
            frame = http_frames.request_frame("DELETE" if request.method == "DELETE" else "PUT", path, body)
        except TimeoutError:
            return _error(408, "the body did not come in time"), b"", path
        except (DecodeError, OSError, aiohttp.ClientError, web.RequestPayloadError) as error:
            return _error(400, str(error)), b"", path
        return (None, frame, path) if len(frame) <= MAX_BYTES else (_error(413, "too long"), b"", path)


class HttpClientTransport:
    """A ground station's side: request frames become requests, their responses become frames."""

    def __init__(self, on_piece: OnPiece, on_note: OnNote, base: URL, session: aiohttp.ClientSession) -> None:
        """Called by `open`."""
        self.counts = Counts()
        self._on_piece = on_piece
        self._on_note = on_note
        self._base = base
        self._session = session
        self._requests: set[asyncio.Task[None]] = set()
        self._ending: asyncio.Task[None] | None = None

    @classmethod
    async def open(
        cls,
        on_piece: OnPiece,
        remote: Address,
        *,
        token: str | None = None,
        on_note: OnNote = ignore_note,
        answer_s: float = CLIENT_S,
    ) -> HttpClientTransport:
        """A client for requests to `remote`, which need not be there yet: each request connects by itself.

        Raises `InputError` with an address beyond loopback without a token.
        """
        check_guarded("HTTP", remote, guarded=token is not None, remedy=_REMEDY)
        headers = {"Accept": JSON_TYPE, "Accept-Encoding": "identity", "Content-Type": JSON_TYPE}
        if token is not None:
            headers["Authorization"] = f"Bearer {token}"
        session = aiohttp.ClientSession(
            headers=headers,
            connector=aiohttp.TCPConnector(limit=MAX_OPEN),
            timeout=aiohttp.ClientTimeout(total=answer_s),
            cookie_jar=aiohttp.DummyCookieJar(),
            auto_decompress=False,
        )
        base = URL(f"http://{format_address(remote)}")
        return cls(on_piece, on_note, base, session)

    @property
    def address(self) -> Address:
        """The address to which requests go."""
        return self._base.host or "", self._base.port or 0

    def send(self, payload: bytes) -> bool:
        """Make a frame's request in the background; `False`, and counted, if it is none or too many are open."""
        if self._session.closed or self._ending is not None:
            return False
        if len(self._requests) >= MAX_OPEN:
            self.counts.overflowed += 1
            return False
        try:
            request = http_frames.read_request(payload)
        except DecodeError:
            self.counts.unfit += 1
            return False
        task = asyncio.get_running_loop().create_task(self._request(request))
        self._requests.add(task)
        task.add_done_callback(self._requests.discard)
        self.counts.sent += 1
        return True

    def close(self) -> None:
        """Cancel the open requests, and end the session."""
        if self._ending is None:
            for task in self._requests:
                task.cancel()
            self._ending = asyncio.get_running_loop().create_task(self._session.close())

    async def _request(self, request: http_frames.Request) -> None:
        url = self._base.with_path(http_frames.quoted(request.path), encoded=True)
        try:
            async with self._session.request(request.method, url, data=request.body, allow_redirects=False) as response:
                body = await read_bounded(response.content, response.content_length, MAX_BYTES)
                self._receive(response.status, response.headers.get("Content-Location"), request.path, body)
        except (aiohttp.ClientError, OSError, TimeoutError, ValueError) as error:
            self.counts.lost += 1
            if worth_noting(self.counts.lost):
                reason = str(error) or type(error).__name__
                self._on_note("lost", f"{format_address(self.address)}: {reason}, {self.counts.lost} so far")

    def _receive(self, status: int, where: str | None, path: str, body: bytes | None) -> None:
        try:
            if body is None:
                raise DecodeError(f"more than {MAX_BYTES} bytes")
            path = path if where is None else http_frames.unquoted(where)
            frame = http_frames.response_frame(status, path, body)
        except (DecodeError, ValueError):
            self.counts.garbage += 1
            if body:
                self._on_piece(Piece(body, garbage=True))
            return
        self.counts.frames += 1
        self._on_piece(Piece(frame, garbage=False))


def _error(status: int, message: str, headers: dict[str, str] | None = None) -> web.Response:
    body = http_frames.error_body(message)
    return web.Response(status=status, body=body, content_type=JSON_TYPE, headers=headers)
