"""Requests that control a run: who may ask, what is malformed or too much, and the answers."""

from __future__ import annotations

import asyncio
import math
import secrets
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import asdict, dataclass
from typing import Any, Final, Protocol, get_args

from aiohttp import web

from skyrange.codec.strict_json import parse_json_object
from skyrange.core.errors import DecodeError, InputError, SkyrangeError
from skyrange.core.secrets import is_same_secret
from skyrange.view.control import Command, Do

PATH: Final = "/control"
OPEN_PATH: Final = "/open/{ticket}"
MAX_BYTES: Final = 1024
"""Of a command."""
MAX_PER_S: Final = 50.0
"""Commands and questions that are answered in a second."""
BODY_S: Final = 5.0
"""Wall time in which a command has to arrive."""
ANSWER_S: Final = 10.0
"""Wall time in which the run has to carry it out; then it is withdrawn."""


class Controllable(Protocol):
    """What can be controlled from the server's thread."""

    @property
    def state(self) -> Mapping[str, Any]:
        """JSON data."""
        ...

    def submit(self, command: Command) -> Future[Mapping[str, Any]]:
        """Have a command carried out."""
        ...


@dataclass(slots=True)
class ControlCounts:
    """Requests by what became of them."""

    obeyed: int = 0
    refused: int = 0
    """By the run, with a reason."""
    strangers: int = 0
    """Without the token, or with a wrong one."""
    malformed: int = 0
    too_long: int = 0
    too_many: int = 0
    unanswered: int = 0
    """Withdrawn, because the run did not answer in time."""

    def describe(self) -> str:
        """What was not obeyed, in words; "" for nothing."""
        named = (
            (self.refused, "refused by the run"),
            (self.strangers, "without its token"),
            (self.malformed, "malformed"),
            (self.too_long, "too long"),
            (self.too_many, "too many in a second"),
            (self.unanswered, "not answered in time"),
        )
        return ", ".join(f"{count:,} {words}" for count, words in named if count)


class ControlServer:
    """Answers questions for the state, and commands, of whoever has the token, which is random."""

    def __init__(self, control: Controllable, *, clock: Callable[[], float] = time.monotonic) -> None:
        self.token = secrets.token_urlsafe(24)
        self.counts = ControlCounts()
        self._control = control
        self._clock = clock
        self._ticket: str | None = secrets.token_urlsafe(24)
        self._allowance = (MAX_PER_S, clock())

    def add_routes(self, application: web.Application) -> None:
        """Answer at `PATH`, and once at the address of the ticket."""
        application.router.add_get(PATH, self.answer_question)
        application.router.add_post(PATH, self.answer_command)
        application.router.add_get(OPEN_PATH, self.answer_ticket)

    def address(self, url: str) -> str:
        """The page's address with the token, in the fragment, which no browser sends to a server."""
        return f"{url}#token={self.token}"

    def address_once(self, url: str) -> str:
        """An address that leads there once: other users of the machine see what programs are started with."""
        return f"{url}open/{self._ticket}"

    async def answer_ticket(self, request: web.Request) -> web.Response:
        """Lead the first one who has the ticket to the address with the token."""
        ticket, given = self._ticket, request.match_info["ticket"]
        if ticket is None or not is_same_secret(given, ticket):
            self.counts.strangers += 1
            raise web.HTTPNotFound
        self._ticket = None
        return web.Response(status=303, headers={"Location": self.address("/"), "Cache-Control": "no-store"})

    async def answer_question(self, request: web.Request) -> web.Response:
        """The state of the run."""
        refusal = self._find_refusal(request)
        return refusal or _answer(200, {**self._control.state, "counts": asdict(self.counts)})

    async def answer_command(self, request: web.Request) -> web.Response:
        """Have a command carried out, and answer with its result or with why it is refused."""
        refusal = self._find_refusal(request)
        if refusal is not None:
            return refusal
        try:
            async with asyncio.timeout(BODY_S):
                body = await _read(request)
        except TimeoutError:
            self.counts.malformed += 1
            return _answer(408, {"error": f"The command did not arrive within {BODY_S:g} s."})
        if body is None:
            self.counts.too_long += 1
            return _answer(413, {"error": f"A command has at most {MAX_BYTES} bytes."})
        command = parse_command(body)
        if command is None:
            self.counts.malformed += 1
            return _answer(400, {"error": 'Expected JSON such as {"do": "start", "act": "ghost"}.'})
        try:
            result = await _await_result(self._control.submit(command))
        except SkyrangeError as error:
            self.counts.refused += 1
            return _answer(409 if isinstance(error, InputError) else 503, {"error": str(error)})
        if result is None:
            self.counts.unanswered += 1
            return _answer(503, {"error": f"The run has not answered within {ANSWER_S:g} s; the command is withdrawn."})
        self.counts.obeyed += 1
        return _answer(200, {**result, "state": self._control.state})

    def _find_refusal(self, request: web.Request) -> web.Response | None:
        """The answer to who has no token, or asks too often."""
        scheme, _, token = request.headers.get("Authorization", "").partition(" ")
        if scheme != "Bearer" or not is_same_secret(token, self.token):
            self.counts.strangers += 1
            hint = "Open the address that skyrange printed, with its token."
            return _answer(401, {"error": hint}, {"WWW-Authenticate": "Bearer"})
        left, since = self._allowance
        now = self._clock()
        left = min(left + (now - since) * MAX_PER_S, MAX_PER_S)
        self._allowance = (max(left - 1.0, 0.0), now)
        if left < 1.0:
            self.counts.too_many += 1
            return _answer(429, {"error": f"More than {MAX_PER_S:g} requests in a second."}, {"Retry-After": "1"})
        return None


def parse_command(body: bytes) -> Command | None:
    """A command from JSON; `None` for anything else."""
    try:
        data = parse_json_object(body)
    except DecodeError:
        return None
    do = data.get("do")
    if not isinstance(do, str) or do not in get_args(Do):
        return None
    wanted = {"start": "act", "stop": "act", "speed": "speed"}.get(do)
    if data.keys() != {"do", *([wanted] if wanted else ())}:
        return None
    if wanted == "act":
        return Command(do, act=data["act"]) if isinstance(data["act"], str) else None  # type: ignore[arg-type]
    if wanted == "speed":
        speed = data["speed"]
        if isinstance(speed, bool) or not isinstance(speed, (int, float)) or not math.isfinite(_as_float(speed)):
            return None
        return Command("speed", speed=float(speed))
    return Command(do)  # type: ignore[arg-type]


def _as_float(number: float) -> float:
    try:
        return float(number)
    except OverflowError:
        return math.inf


async def _read(request: web.Request) -> bytes | None:
    """The body, or `None` if it is too long."""
    body = b""
    async for piece in request.content.iter_any():
        body += piece
        if len(body) > MAX_BYTES:
            return None
    return body


async def _await_result(answer: Future[Mapping[str, Any]]) -> Mapping[str, Any] | None:
    """What the run answers; `None` if it does not in time, and then it will not carry it out."""
    answered = asyncio.wrap_future(answer)
    await asyncio.wait([answered], timeout=ANSWER_S)
    if not answered.done() and answer.cancel():
        return None
    return await answered


def _answer(status: int, data: Mapping[str, Any], headers: Mapping[str, str] | None = None) -> web.Response:
    return web.json_response(data, status=status, headers={"Cache-Control": "no-store", **(headers or {})})
