"""One UTM service: its agent, database and HTTP, from its configuration until it is stopped."""

from __future__ import annotations

import asyncio
import json
import signal
import ssl
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Any, Final, TextIO

import aiohttp

from skyrange.contracts.mailboxes import Departure, Note
from skyrange.core.errors import ComponentError, InputError
from skyrange.core.files import read_input
from skyrange.core.ids import Port, endpoint
from skyrange.core.time import Time
from skyrange.io.addresses import check_guarded, with_address
from skyrange.io.limited_listener import listen
from skyrange.runtime.memory import collect_seldom
from skyrange.runtime.utm.agent_host import UNIX, AgentHost
from skyrange.runtime.utm.config import (
    AuthorityConfig,
    DssConfig,
    ServiceConfig,
    TlsConfig,
    TokenConfig,
    UssConfig,
    host_of,
)
from skyrange.runtime.utm.database.journal import AuthorityJournal, Changes, DssJournal, UssJournal
from skyrange.runtime.utm.database.tables import open_engine
from skyrange.runtime.utm.federation import Inbound, OpenDirectory, Outbound
from skyrange.runtime.utm.flight_planning import FlightPlanning
from skyrange.runtime.utm.operators import Operators
from skyrange.runtime.utm.tokens import Authorization, TokenClient, TokenRequests, read_private_key, read_public_key
from skyrange.runtime.utm.web import Routes, WebService
from skyrange.utm.approval_service import FlightApproval
from skyrange.utm.authority import Authority
from skyrange.utm.federated.dss.service import Dss
from skyrange.utm.federated.dss.store import DssStore
from skyrange.utm.federated.exchanges import Peer
from skyrange.utm.federated.tokens import TokenChecker
from skyrange.utm.federated.uss.service import Uss

TEST_OPERATOR: Final = "tests"
"""Operator of the flights that automated tests plan."""
_MAX_SECRET_BYTES: Final = 65_536
_INBOUND: Final = "uss:inbound"
_DSS: Final = "uss:dss"


def serve(configs: Sequence[ServiceConfig], on_ready: Callable[[str, str], None]) -> None:
    """Run services until SIGINT, SIGTERM or SIGHUP; `on_ready(name, url)` is called for each when it listens.

    Raises `InputError`, `OSError` for an address that cannot be used, and `ComponentError` if a service fails.
    """
    with collect_seldom():
        asyncio.run(_serve(configs, on_ready))


async def _serve(configs: Sequence[ServiceConfig], on_ready: Callable[[str, str], None]) -> None:
    loop = asyncio.get_running_loop()
    stopped = asyncio.Event()
    hang_up = () if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN else (signal.SIGHUP,)
    for number in (signal.SIGINT, signal.SIGTERM, *hang_up):
        loop.add_signal_handler(number, stopped.set)
    hosts: dict[str, AgentHost] = {}
    async with AsyncExitStack() as stack:
        for config in configs:
            url, host = await stack.enter_async_context(run_service(config))
            on_ready(config.name, url)
            if host is not None:
                hosts[config.name] = host
        waiting = [loop.create_task(event.wait()) for event in (stopped, *(host.failed for host in hosts.values()))]
        await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
        for task in waiting:
            task.cancel()
        for name, host in hosts.items():
            if host.failure is not None:
                raise ComponentError(name, f"the service failed: {host.failure!r}") from host.failure


@asynccontextmanager
async def run_service(config: ServiceConfig) -> AsyncIterator[tuple[str, AgentHost | None]]:
    """The service while the context lasts: its URL, and what steps its agent."""
    address = config.address
    check_guarded(config.name, address, guarded=config.tls is not None, remedy="Give it certificates (table tls).")
    ssl_in, ssl_out = _contexts(config)
    log = open(config.log, "a", encoding="utf-8") if config.log is not None else None  # noqa: SIM115 - closed below
    session = aiohttp.ClientSession(
        connector=aiohttp.TCPConnector(limit=256, ssl=ssl_out if ssl_out is not None else True),
        cookie_jar=aiohttp.DummyCookieJar(),
    )
    host, close = None, _nothing
    try:
        routes = Routes()
        if config.authorization is not None:
            key = read_private_key(config.authorization.key, config.name)
            routes.authorization = Authorization(config.authorization, key)
        elif config.authority is not None:
            host, close = _host_authority(config, config.authority, routes, log)
        elif config.tokens is not None:
            host, close = _host_agent(config, config.tokens, session, routes, log)
        web = WebService(routes)
        try:
            listener = await listen(web.server, *address, context=ssl_in)
        except OSError as error:
            raise with_address(address, error) from error
        try:
            if host is not None:
                host.start()
            port = listener.address[1]
            yield f"{'https' if config.tls is not None else 'http'}://{address[0]}:{port}", host
        finally:
            listener.close()
            await web.server.shutdown(1.0)
    finally:
        close()
        await session.close()
        if log is not None:
            log.close()


def _nothing() -> None:
    """Close nothing."""


def _host_agent(
    config: ServiceConfig, tokens: TokenConfig, session: aiohttp.ClientSession, routes: Routes, log: TextIO | None
) -> tuple[AgentHost, Callable[[], None]]:
    """The agent of a USS or a DSS with what carries its frames, and what ends both."""
    keys = tuple(read_public_key(path, config.name) for path in tokens.keys)
    checker = TokenChecker(config.receivers, keys, UNIX, frozenset(tokens.issuers))
    here = endpoint("approval", config.name)
    changes = None if config.database is None else Changes(open_engine(config.database, config.name))
    commit = _nothing if changes is None else changes.commit

    def deliver(port: Port, payload: bytes, sender: str) -> None:
        host.deliver(port, payload, sender)

    inbound = Inbound(Port(here, _INBOUND), deliver)
    routes.checker, routes.inbound, routes.now = checker, inbound, lambda: host.now()
    if config.dss is not None:
        routes.prefixes = ("/dss/",)
        secret = _read_secret(config.dss, config.name)
        store = DssStore()
        if changes is not None:
            journal = DssJournal(changes)
            store = DssStore(journal, journal.entities())
        dss = Dss(config.name, [inbound.port], checker, secret, UNIX, store)
        host = AgentHost(dss, inbound.on_departure, commit=commit, note=_noter(log))
        return host, _closer(host.close, changes)
    assert config.uss is not None
    assert tokens.url is not None
    client = TokenClient(session, tokens.url, config.name, tokens.secret)
    outbound = Outbound(session, client, {_DSS: config.uss.dss_url}, deliver)
    names = [*config.uss.operators, *([TEST_OPERATOR] if config.uss.flight_planning else [])]
    operators = Operators(names, deliver, lambda: host.now())
    uss = _make_uss(config, config.uss, checker, operators, here=here, inbound=inbound.port, changes=changes)

    def send(departure: Departure) -> None:
        if departure.port == inbound.port:
            inbound.on_departure(departure)
        elif operators.is_operator_port(departure.port):
            operators.on_departure(departure)
        else:
            outbound.on_departure(departure)

    host = AgentHost(uss, send, commit=commit, note=_noter(log))
    routes.prefixes, routes.operators, routes.secrets = ("/uss/",), operators, config.uss.operators
    if config.uss.flight_planning:
        routes.planning = FlightPlanning(TEST_OPERATOR, operators, lambda: uss.own_intents, UNIX)

    def close() -> None:
        host.close()
        outbound.close()

    return host, _closer(close, changes)


def _closer(close: Callable[[], None], changes: Changes | None) -> Callable[[], None]:
    """What ends an agent, and then its database."""

    def close_all() -> None:
        close()
        if changes is not None:
            changes.close()

    return close_all


def _host_authority(
    config: ServiceConfig, settings: AuthorityConfig, routes: Routes, log: TextIO | None
) -> tuple[AgentHost, Callable[[], None]]:
    """The agent of an authority with what carries its frames."""
    changes = None if config.database is None else Changes(open_engine(config.database, config.name))
    journal = None if changes is None else AuthorityJournal(changes)
    accepted = () if journal is None else list(journal.intents())
    policy = Authority(settings.limits, journal, accepted)
    agent = FlightApproval(list(settings.operators), UNIX, policy, name=config.name, queue=settings.limits.make_queue())
    for intent in accepted:
        agent.restore(intent.operator, intent.id)

    def deliver(port: Port, payload: bytes, sender: str) -> None:
        host.deliver(port, payload, sender)

    operators = Operators(settings.operators, deliver, lambda: host.now())
    host = AgentHost(
        agent, operators.on_departure, commit=_nothing if changes is None else changes.commit, note=_noter(log)
    )
    routes.operators, routes.secrets = operators, settings.operators
    return host, _closer(host.close, changes)


def _make_uss(
    config: ServiceConfig,
    settings: UssConfig,
    checker: TokenChecker,
    operators: Operators,
    *,
    here: str,
    inbound: Port,
    changes: Changes | None,
) -> Uss:
    journal = None if changes is None else UssJournal(changes)
    audience = settings.dss_audience or host_of(settings.dss_url)
    directory = OpenDirectory(config.name, config.base_url, frozenset(settings.peers))
    directory.ports = (inbound,)
    return Uss(
        config.name,
        config.name,
        operators=list(operators.ports.items()),
        dss=Peer(audience, Port(here, _DSS)),
        directory=directory,
        base_url=config.base_url,
        tokens=TokenRequests(),
        checker=checker,
        limits=settings.limits.limits,
        epoch=UNIX,
        journal=journal,
        earlier_intents=() if journal is None else journal.intents(),
        constraints=settings.constraints,
    )


def _read_secret(config: DssConfig, who: str) -> bytes:
    secret = read_input(config.secret, who, "dss.secret", max_bytes=_MAX_SECRET_BYTES)
    if len(secret) < 16:
        raise InputError.one(who, "dss.secret", f"{len(secret)} bytes", "at least 16 bytes")
    return secret[:64]


def _contexts(config: ServiceConfig) -> tuple[ssl.SSLContext | None, ssl.SSLContext | None]:
    """TLS of the server and of the client; `None` for none, and for that of the system."""
    tls = config.tls
    if tls is None:
        return None, None
    try:
        inside = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
        inside.load_cert_chain(tls.certificate, tls.key)
        return inside, _client_context(tls)
    except (OSError, ssl.SSLError) as error:
        raise InputError.one(config.name, "tls", str(tls.certificate), "PEM files that fit", str(error)) from error


def _client_context(tls: TlsConfig) -> ssl.SSLContext:
    return ssl.create_default_context(ssl.Purpose.SERVER_AUTH, cafile=tls.authority)


def _noter(log: TextIO | None) -> Callable[[Time, Note], None]:
    """What writes decisions down."""

    def write(now: Time, note: Note) -> None:
        if log is not None:
            row: dict[str, Any] = {"time": UNIX.rfc3339(now), "kind": note.kind, "about": note.about, **note.data}
            log.write(json.dumps(row) + "\n")
            log.flush()

    return write
