"""Federations of UTM services in this process, and operators that ask them over HTTP."""

from __future__ import annotations

import asyncio
import json
import os
import socket
import ssl
from collections.abc import AsyncIterator, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import aiohttp

from skyrange.core.time import NS_PER_S
from skyrange.runtime.utm.agent_host import UNIX
from skyrange.runtime.utm.config import ServiceConfig, load_config
from skyrange.runtime.utm.initial_files import write_authority, write_federation
from skyrange.runtime.utm.service import run_service
from skyrange.utm.contract import OperationalIntent
from skyrange.utm.messages import Request, encode

SERVICES = {"north": ["blue", "green"], "south": ["red"]}


def free_port(count: int) -> int:
    """The first of some ports in a row that are free now; each worker of the tests has its own to choose from."""
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    lowest = 20_000 + worker % 12 * 1_000
    for first in range(lowest, lowest + 1_000 - count, count):
        held = []
        try:
            for port in range(first, first + count):
                held.append(socket.create_server(("127.0.0.1", port)))  # noqa: PERF401 - those so far are closed
        except OSError:
            continue
        else:
            return first
        finally:
            for one in held:
                one.close()
    raise AssertionError("no ports")


def write_one(folder: Path) -> list[Path]:
    """The configuration of a new authority of all operators of `SERVICES`."""
    operators = [operator for names in SERVICES.values() for operator in names]
    return [write_authority(folder / "authority", operators, free_port(1))]


def write(folder: Path) -> list[Path]:
    """The configurations of a new federation of `SERVICES`, with the interfaces for tests."""
    return write_federation(folder / "federation", SERVICES, free_port(len(SERVICES) + 2), tests=True)


@dataclass
class Federation:
    """Services that run, and a client."""

    configs: dict[str, ServiceConfig]
    session: aiohttp.ClientSession
    tokens: dict[tuple[str, str], str] = field(default_factory=dict)

    async def call(
        self, service: str, method: str, path: str, body: Any = None, token: str = "", **more: Any
    ) -> tuple[int, Any]:
        """Status and JSON of a response."""
        url = self.configs[service].base_url + path
        if token:
            more["headers"] = {"Authorization": f"Bearer {token}"}
        async with self.session.request(method, url, json=body, **more) as response:
            text = await response.text()
            return response.status, json.loads(text) if text else None

    async def ask(self, operator: str, request: Request) -> tuple[int, Any]:
        """The answer of an operator's USS to a request."""
        data = json.loads(encode(request))
        serving = {name: config.authority or config.uss for name, config in self.configs.items()}
        for name, settings in serving.items():
            if settings is not None and operator in settings.operators:
                token = settings.operators[operator]
                return await self.call(name, data["method"], data["path"], data["body"], token)
        raise AssertionError(f"nobody serves {operator}")

    async def want(self, intent: OperationalIntent, version: int = 0) -> Any:
        """The decision on an intent."""
        status, body = await self.ask(intent.operator, Request.of(intent, UNIX, version))
        assert status == 200, body
        return body

    def secret(self, client: str) -> str:
        """The secret of a client of the authorization service."""
        authorization = self.configs["auth"].authorization
        assert authorization is not None
        return authorization.clients[client].secret

    async def token(self, client: str, scopes: str) -> str:
        """A token of a client for services on localhost."""
        if (client, scopes) not in self.tokens:
            query = {"grant_type": "client_credentials", "scope": scopes, "intended_audience": "localhost"}
            headers = {"Authorization": aiohttp.encode_basic_auth(client, self.secret(client))}
            status, body = await self.call("auth", "GET", "/token", params=query, headers=headers)
            assert status == 200, body
            self.tokens[client, scopes] = body["access_token"]
        return self.tokens[client, scopes]


@asynccontextmanager
async def running(paths: Sequence[Path], only: Sequence[str] = ()) -> AsyncIterator[Federation]:
    """The services of some configurations, or those named, and a client of all."""
    configs = {config.name: config for config in map(load_config, paths)}
    context = ssl.create_default_context(cafile=str(paths[0].parent / "ca.crt"))
    async with AsyncExitStack() as stack:
        for name, config in configs.items():
            if not only or name in only:
                await stack.enter_async_context(run_service(config))
        session = aiohttp.ClientSession(connector=aiohttp.TCPConnector(ssl=context))
        await stack.enter_async_context(session)
        yield Federation(configs, session)


def later(seconds: float) -> int:
    """A time in whole seconds from now, in ns since 1970."""
    import time

    return (time.time_ns() // NS_PER_S + round(seconds)) * NS_PER_S


def run(body: Any) -> None:
    """Run a coroutine function to its end."""

    async def bounded() -> None:
        async with asyncio.timeout(60):
            await body()

    asyncio.run(bounded())
