"""The viewer's server: the page and its modules, and one stream, as a file or as a run flies.

It only reads, unless control of the run is wanted (`view.control_server`). It listens on this machine alone unless it
is told otherwise, answers requests that name it by an address (a page of another site cannot reach it through a name of
its own), and a slow browser holds nobody up.
"""

from __future__ import annotations

import asyncio
import ipaddress
import platform
import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager, contextmanager, suppress
from importlib.resources import files
from pathlib import PurePosixPath
from time import monotonic
from types import MappingProxyType
from typing import Final

from aiohttp import WSCloseCode, web

from skyrange.core.errors import InputError
from skyrange.io.limited_listener import listen
from skyrange.view.access import REFUSAL, Access
from skyrange.view.control_server import ControlServer
from skyrange.view.record_queries import RecordQueries
from skyrange.view.record_routes import add_record_routes, add_scan_route
from skyrange.view.scan_queries import FlyingScans
from skyrange.view.stream.messages import MEDIA_TYPE, POSITIONS, SCENE, Message, split_file

POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' data:;"
    " base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""The page loads and asks for nothing that is not this server's, and no other page contains it."""
_HEADERS: Final = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",
}
_TYPES: Final = {".js": "text/javascript", ".css": "text/css", ".html": "text/html"}
_PAGE: Final = "index.html"

HEARTBEAT_S: Final = 20.0
"""Time between two questions whether a page is still there."""
MAX_HEARD_BYTES: Final = 1024
"""A page that says more at once is disconnected; it has nothing to say."""
MAX_GATHERED: Final = 60
"""Messages of positions that may wait for a slow page."""
CUT_OFF_S: Final = 0.5
"""Wall time in which a page that says too much may close by itself."""
CLOSING_S: Final = 5.0
"""Wall time that pages have to close in."""
MAX_HEARD: Final = 64
"""One that says so much in all is disconnected too."""
MAX_CLIENTS: Final = 32
"""Pages that may follow a run at once; further ones are told to try again later."""
GRACE_S: Final = 10.0
"""Wall time after which a stream without pages counts as not watched: a page that is loaded again comes back sooner."""
HOST = web.AppKey("host", str)
"""How the page reads the stream: `file` or `socket`."""
ACCESS: Final = web.AppKey[Access | None]("access")
"""What requests of other machines need; None where there are none."""
CONTROLLED = web.AppKey("controlled", bool)
"""Whether the page offers control of the run."""
SCANNING = web.AppKey("scanning", bool)
"""Whether the page may ask about scans while a run flies."""
RECORDED = web.AppKey("recorded", bool)
"""Whether the page may ask about the records."""

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


class RecordedStream:
    """A file of the stream, which is answered whole or by a range of bytes (RFC 9110, 14.2)."""

    host = "file"

    def __init__(self, data: bytes) -> None:
        self._data = data

    async def answer(self, request: web.Request) -> web.Response:
        """The bytes asked for; several ranges at once are answered by the whole file, which the RFC allows."""
        headers = {"Accept-Ranges": "bytes"}
        size = len(self._data)
        try:
            asked = request.http_range
            start, stop, _ = asked.indices(size)
        except ValueError:
            asked, start, stop = slice(None), 0, size
        if asked == slice(None, None, 1) or asked == slice(None):
            return web.Response(body=self._data, content_type=MEDIA_TYPE, headers=headers)
        if start >= size or stop <= start:
            unknown = {"Content-Range": f"bytes */{size}"}
            return web.Response(status=416, headers=headers | unknown)
        part = {"Content-Range": f"bytes {start}-{stop - 1}/{size}"}
        return web.Response(status=206, body=self._data[start:stop], content_type=MEDIA_TYPE, headers=headers | part)


class LiveStream:
    """Messages that come while a run flies, from another thread; each client gets all of them from the first on.

    A client that is slow misses positions, never a scene or events. After the scene of a run that has ended, and all
    that came before it, each client's socket is closed.
    """

    host = "socket"

    def __init__(self) -> None:
        self._messages: list[tuple[str, bytes]] = []
        self._ended = False
        self._clients: dict[asyncio.Event, asyncio.AbstractEventLoop] = {}
        self._left_s = monotonic()

    @property
    def watched(self) -> bool:
        """Whether a page is open, or was within the last `GRACE_S` of wall time. From any thread."""
        return bool(self._clients) or monotonic() - self._left_s < GRACE_S

    def restart(self) -> None:
        """Forget what was published, to publish all of it anew. Clients are disconnected, and start over. From any
        thread.
        """
        self._messages = []
        self._ended = False
        self._wake()

    def publish(self, message: Message) -> None:
        """Send a message to all clients; returns at once. From any thread. The scene of a run that has ended is the
        last message.
        """
        self._messages.append((message.kind, message.encode()))
        if message.kind == SCENE:
            self._ended = message.head.get("flying") is False
        self._wake()

    def replace(self, data: bytes) -> None:
        """Have a file of the stream in place of all that was published. Clients are disconnected, start over with it,
        and then the stream ends. From any thread.
        """
        self._messages = [(chr(message[0]), message) for message in split_file(data)]
        self._ended = True
        self._wake()

    def _wake(self) -> None:
        for news, loop in list(self._clients.items()):
            with suppress(RuntimeError):  # the loop has ended, and with it the client
                loop.call_soon_threadsafe(news.set)

    async def answer(self, request: web.Request) -> web.WebSocketResponse:
        """A socket of the page, until the stream ends or the page closes it. What the page sends is discarded."""
        socket = web.WebSocketResponse(heartbeat=HEARTBEAT_S, max_msg_size=MAX_HEARD_BYTES)
        await socket.prepare(request)
        if len(self._clients) >= MAX_CLIENTS:
            await socket.close(code=WSCloseCode.TRY_AGAIN_LATER, message=b"too many pages are open")
            return socket
        news = asyncio.Event()
        self._clients[news] = asyncio.get_running_loop()
        listening = asyncio.create_task(_discard(socket, news))
        try:
            code = await self._send(socket, news)
            if code is not None:
                listening.cancel()  # closing waits for the page's answer, which it would take
                await asyncio.wait([listening])
                await socket.close(code=code)
        except ConnectionError:
            pass  # the page was closed while it was sent something
        finally:
            del self._clients[news]
            self._left_s = monotonic()
            listening.cancel()
        return socket

    async def _send(self, socket: web.WebSocketResponse, news: asyncio.Event) -> WSCloseCode | None:
        """Send all messages to a page until it closes; the code with which the stream ends before."""
        messages, sent = self._messages, 0
        while not socket.closed:
            news.clear()
            ended = self._ended  # asked first: what is published after the last scene does not exist
            if self._messages is not messages:
                return WSCloseCode.SERVICE_RESTART
            fresh = messages[sent:]
            for message in thin(fresh) if sent else [data for _, data in fresh]:
                await socket.send_bytes(message)
            sent += len(fresh)
            if ended:
                return WSCloseCode.OK
            await news.wait()
        return None


def thin(messages: Sequence[tuple[str, bytes]]) -> list[bytes]:
    """What a client gets of messages (kind, bytes) that have gathered: all but positions older than the newest."""
    late = max(len(messages) - MAX_GATHERED, 0)
    return [data for number, (kind, data) in enumerate(messages) if number >= late or kind != POSITIONS]


async def _discard(socket: web.WebSocketResponse, news: asyncio.Event) -> None:
    """Read until the page closes, and wake who sends; one that says much is cut off."""
    heard = 0
    async for _ in socket:
        heard += 1
        if heard == MAX_HEARD:
            with suppress(TimeoutError):
                async with asyncio.timeout(CUT_OFF_S):  # it may go on instead of answering
                    await socket.close(code=WSCloseCode.POLICY_VIOLATION, message=b"the viewer hears nothing")
    news.set()


def make_application(
    stream: RecordedStream | LiveStream,
    control: ControlServer | None = None,
    *,
    access: Access | None = None,
    queries: RecordQueries | None = None,
    scans: FlyingScans | None = None,
) -> web.Application:
    """The page, its modules and the stream, by path; what controls the run, and what answers about the records of the
    arms, or about the scans of a run that flies, if that is wanted. With `access`, for other machines too.
    """
    application = web.Application(middlewares=[_guard])
    application[HOST] = stream.host
    application[ACCESS] = access
    application[CONTROLLED] = control is not None
    if control is not None:
        control.add_routes(application)
    application[RECORDED] = queries is not None
    if queries is not None:
        add_record_routes(application, queries)
    application[SCANNING] = scans is not None
    if scans is not None:
        add_scan_route(application, scans)
    application.router.add_get("/", _answer_page)
    application.router.add_get("/assets/{name}", _answer_asset)
    application.router.add_get("/stream", stream.answer)
    return application


@asynccontextmanager
async def serve(application: web.Application, host: str, port: int) -> AsyncIterator[str]:
    """Serve it at an IP address and port (0: a free one) as long as the context lasts; gives the page's URL. With
    access for other machines it is served over TLS, and the URL contains the token.

    Raises `InputError` if nobody can listen there.
    """
    access = application[ACCESS]
    runner = web.AppRunner(application, access_log=None, shutdown_timeout=1.0)
    await runner.setup()
    try:
        assert runner.server is not None
        try:
            listener = await listen(runner.server, host, port, context=access.context if access is not None else None)
        except OSError as error:
            reason = error.strerror or str(error)
            raise InputError.one("viewer", "--host, --port", f"{host}:{port}", f"a free address ({reason})") from None
        chosen = listener.address[1]
        name = platform.node() if ipaddress.ip_address(host).is_unspecified else host
        place = f"{f'[{name}]' if ':' in name else name}:{chosen}/"
        try:
            yield f"http://{place}" if access is None else f"https://{place}{access.query}"
        finally:
            listener.close()
    finally:
        await runner.cleanup()


@contextmanager
def serve_beside(application: web.Application, host: str, port: int) -> Iterator[str]:
    """Serve it in a thread of its own as long as the context lasts; gives the page's URL. Raises as `serve`."""
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever, name="viewer", daemon=True)
    thread.start()
    serving = serve(application, host, port)
    try:
        yield asyncio.run_coroutine_threadsafe(serving.__aenter__(), loop).result()
        asyncio.run_coroutine_threadsafe(serving.__aexit__(None, None, None), loop).result(CLOSING_S)
    finally:
        loop.call_soon_threadsafe(loop.stop)
        thread.join(CLOSING_S)


@web.middleware
async def _guard(request: web.Request, handler: Handler) -> web.StreamResponse:
    """Refuse names that are no addresses, and pages of other origins; add the headers that protect the page."""
    origin, access = request.headers.get("Origin"), request.app[ACCESS]
    is_foreign = origin is not None and origin != f"{request.scheme}://{request.host}"
    if is_foreign or (access is None and not _is_address(request.host)):
        return web.Response(status=403, text=REFUSAL)
    try:
        if access is None or access.admits(request):
            response = await handler(request)
        else:
            response = access.answer(request)
    except web.HTTPException as error:
        response = web.Response(status=error.status, text=f"{error.reason}\n")
    if not response.prepared:  # a socket has been
        for name, value in _HEADERS.items():
            response.headers.setdefault(name, value)
    return response


def _is_address(host: str) -> bool:
    """Whether a Host header names this machine, or an IP address."""
    name = host.rsplit(":", 1)[0] if host.count(":") == 1 or "]" in host else host
    if name == "localhost":
        return True
    try:
        ipaddress.ip_address(name.strip("[]"))
    except ValueError:
        return False
    return True


async def _answer_page(request: web.Request) -> web.Response:
    more = (" data-control" if request.app[CONTROLLED] else "") + (" data-record" if request.app[RECORDED] else "")
    more += " data-scans" if request.app[SCANNING] else ""
    return _respond(_PAGE, {'data-source="file"': f'data-source="{request.app[HOST]}"{more}'})


async def _answer_asset(request: web.Request) -> web.Response:
    return _respond(request.match_info["name"])


def _respond(name: str, replaced: Mapping[str, str] = MappingProxyType({})) -> web.Response:
    """A text file of the package, with some of its text `replaced`; 404 for what is none."""
    kind = _TYPES.get(PurePosixPath(name).suffix)
    path = files("skyrange.view").joinpath("assets", name)
    if kind is None or "/" in name or "\\" in name or not path.is_file():
        raise web.HTTPNotFound
    text = path.read_text(encoding="utf-8")
    for before, after in replaced.items():
        text = text.replace(before, after)
    return web.Response(text=text, content_type=kind, charset="utf-8")
