"""Routes of the viewer's server that answer questions about recorded runs, as JSON."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Final

from aiohttp import web

from skyrange.core.errors import InputError
from skyrange.view.record_queries import RecordQueries
from skyrange.view.scan_queries import FlyingScans, ScanQueries

PATH: Final = "/record"
Answer = Callable[[Mapping[str, str]], Any]


def add_record_routes(application: web.Application, queries: RecordQueries) -> None:
    """Answer `fields`, `series`, `frames`, `causes` and `scans` below `PATH`, one question at a time.

    A question that is wrong is answered with status 400 and the `problem`, in JSON.
    """
    answers: dict[str, Answer] = {
        "fields": lambda asked: queries.list_fields(_number(asked, "arm")),
        "series": lambda asked: queries.read_series(
            _number(asked, "arm"), asked.get("vehicle", ""), asked.get("source", ""), asked.get("field", "")
        ),
        "causes": lambda asked: queries.read_causes(
            _number(asked, "arm"), _seconds(asked, "at"), asked.get("kind", ""), asked.get("about", "")
        ),
        "frames": lambda asked: queries.read_frames(
            _number(asked, "arm"), asked.get("vehicle", ""), _seconds(asked, "until")
        ),
        "scans": partial(_read_scans, queries.scans),
    }
    _add_routes(application, answers)


def add_scan_route(application: web.Application, scans: FlyingScans) -> None:
    """Answer `scans` alone, while a run flies."""
    _add_routes(application, {"scans": partial(_read_scans, scans)})


def _read_scans(scans: ScanQueries | FlyingScans, asked: Mapping[str, str]) -> Any:
    return scans.read_scans(_number(asked, "arm"), asked.get("vehicle", ""), _seconds(asked, "until"))


def _add_routes(application: web.Application, answers: Mapping[str, Answer]) -> None:
    one_at_a_time = asyncio.Lock()

    async def answer(request: web.Request, of: Answer) -> web.Response:
        async with one_at_a_time:
            try:
                return web.json_response(await asyncio.to_thread(of, request.query))
            except InputError as error:
                return web.json_response({"problem": str(error)}, status=400)

    for name, of in answers.items():
        application.router.add_get(f"{PATH}/{name}", partial(answer, of=of))


def _number(asked: Mapping[str, str], name: str) -> int:
    text = asked.get(name, "")
    if not (text.isascii() and text.isdigit() and len(text) < 10):
        raise InputError.one("viewer", name, repr(text), "a number of 0 or more")
    return int(text)


def _seconds(asked: Mapping[str, str], name: str) -> float:
    try:
        value = float(asked.get(name, ""))
    except ValueError:
        value = math.nan
    if not abs(value) < 1e9:
        raise InputError.one("viewer", name, repr(asked.get(name, "")), "a time in seconds")
    return value
