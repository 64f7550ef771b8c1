"""Benchmark of UTM services as processes: clients ask them over HTTPS on loopback, and every answer is durable.

Requests are those of `bench.approval`, on the clock of the day. Each service is a process of its own with SQLite.
"""

from __future__ import annotations

import asyncio
import json
import socket
import ssl
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import aiohttp
import numpy as np

from skyrange.bench.approval import make_intent
from skyrange.bench.yardstick import yardstick_us
from skyrange.contracts.mailboxes import Arrival, Inbox
from skyrange.core.errors import ComponentError
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import NS_PER_S
from skyrange.runtime.utm.agent_host import UNIX
from skyrange.runtime.utm.config import ServiceConfig, load_config
from skyrange.runtime.utm.database.journal import AuthorityJournal, Changes
from skyrange.runtime.utm.database.tables import open_engine
from skyrange.runtime.utm.initial_files import write_authority, write_federation
from skyrange.utm.approval_service import FlightApproval
from skyrange.utm.authority import Authority, AuthorityParams
from skyrange.utm.contract import OperationalIntent
from skyrange.utm.messages import Request, encode

_OPERATOR: Final = "blue"
_PORT: Final = Port("approval", "approval:blue")


def measure_durable(requests: int) -> dict[str, Any]:
    """An authority in this process with a database on disk: each request is committed before the next."""
    with tempfile.TemporaryDirectory() as folder:
        engine = open_engine(f"sqlite:///{folder}/authority.db", "bench")
        changes = Changes(engine)
        authority = Authority(AuthorityParams(), AuthorityJournal(changes))
        service = FlightApproval([_OPERATOR], UNIX, authority)
        now = time.time_ns()
        payloads = [encode(Request.of(_intent(number, now), UNIX)) for number in range(requests)]
        times = np.zeros(requests)
        for number, payload in enumerate(payloads):
            arrival = Arrival(_PORT, now, payload, "", FrameId(_PORT.link, "fwd", "bench", number))
            began = time.perf_counter()
            service.step(now, Inbox([arrival]))
            changes.commit()
            times[number] = time.perf_counter() - began
        engine.dispose()
    return _row("authority, in one process", 1, times, float(times.sum()))


def measure_authority(requests: int, clients: int) -> dict[str, Any]:
    """An authority in a process of its own, asked by some clients at once."""
    with tempfile.TemporaryDirectory() as folder:
        path = write_authority(Path(folder) / "utm", [_OPERATOR], _free_ports(1))
        with _running([path]):
            config = load_config(path)
            assert config.authority is not None
            times, took_s = asyncio.run(_ask(config, config.authority.operators[_OPERATOR], requests, clients))
    return _row("authority", clients, times, took_s)


def measure_federation(requests: int, clients: int) -> dict[str, Any]:
    """A USS, which asks a DSS about each request, with an authorization service; three processes."""
    with tempfile.TemporaryDirectory() as folder:
        paths = write_federation(Path(folder) / "utm", {"north": [_OPERATOR]}, _free_ports(3), tests=False)
        with _running(paths):
            config = load_config(paths[-1])
            assert config.uss is not None
            times, took_s = asyncio.run(_ask(config, config.uss.operators[_OPERATOR], requests, clients))
    return _row("USS and DSS", clients, times, took_s)


def _row(service: str, clients: int, times: Any, took_s: float) -> dict[str, Any]:
    milliseconds = times * 1e3
    return {
        "service": service,
        "clients": clients,
        "requests": len(times),
        "decisions_per_s": round(len(times) / took_s, 1),
        "p50_ms": round(float(np.percentile(milliseconds, 50)), 2),
        "p99_ms": round(float(np.percentile(milliseconds, 99)), 2),
        "yardstick_us": round(yardstick_us(), 2),
    }


def _intent(number: int, now: int) -> OperationalIntent:
    """The `number`-th flight of the benchmark, on the clock of the day."""
    intent = make_intent(number)
    start = now // NS_PER_S * NS_PER_S
    volumes = tuple(
        replace(volume, start_ns=volume.start_ns + start, end_ns=volume.end_ns + start) for volume in intent.volumes
    )
    return replace(intent, volumes=volumes)


async def _ask(config: ServiceConfig, token: str, requests: int, clients: int) -> tuple[Any, float]:
    """Seconds that each request took, and that all took together."""
    now, times, count = time.time_ns(), np.zeros(requests), iter(range(requests))
    messages = [json.loads(encode(Request.of(_intent(number, now), UNIX))) for number in range(requests)]
    bodies = [json.dumps(message["body"]).encode() for message in messages]
    assert config.tls is not None
    context = ssl.create_default_context(cafile=config.tls.authority)
    headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/json"}

    async def ask(session: aiohttp.ClientSession) -> None:
        for number in count:
            began = time.perf_counter()
            url = config.base_url + messages[number]["path"]
            async with session.put(url, data=bodies[number], headers=headers) as response:
                await response.read()
                if response.status != 200:
                    raise ComponentError("bench utm", f"{config.name} answers {response.status}")
            times[number] = time.perf_counter() - began

    async with aiohttp.ClientSession(connector=aiohttp.TCPConnector(ssl=context, limit=clients)) as session:
        began = time.perf_counter()
        await asyncio.gather(*(ask(session) for _ in range(clients)))
        return times, time.perf_counter() - began


@contextmanager
def _running(paths: Sequence[Path]) -> Iterator[None]:
    """Each service in a process of its own, from when all listen."""
    with ExitStack() as stack:
        for path in paths:
            process = subprocess.Popen(  # noqa: S603 - this program
                [sys.executable, "-c", "from skyrange.cli import main; main()", "utm", "serve", str(path)],
                stderr=subprocess.PIPE,
                text=True,
            )
            stack.callback(process.wait)
            stack.callback(process.terminate)
            assert process.stderr is not None
            line = process.stderr.readline()
            if "listens at" not in line:
                raise ComponentError("bench utm", f"{path.stem} does not start: {line.strip()}")
        yield


def _free_ports(count: int) -> int:
    """The first of some ports in a row that are free now."""
    for first in range(20_000, 32_000, count):
        try:
            with ExitStack() as stack:
                for port in range(first, first + count):
                    stack.enter_context(socket.create_server(("127.0.0.1", port)))
        except OSError:
            continue
        return first
    raise ComponentError("bench utm", "no ports are free from 20000 to 32000")
