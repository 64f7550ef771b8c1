"""A UTM service that is killed in mid-flight: whatever it has answered is true after its restart."""

from __future__ import annotations

import asyncio
import os
import re
import signal
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import aiohttp
import pytest
from sqlalchemy import create_engine, text

from skyrange.utm.contract import intent_id
from skyrange.utm.intent_states import IntentState
from skyrange.utm.messages import Request
from tests.unit.test_utm_services import COORDINATION, wanted
from tests.utm_services import Federation, later, run, running, write

pytestmark = pytest.mark.realtime
POSTGRESQL = "SKYRANGE_POSTGRESQL"
WHY_NO_POSTGRESQL = "" if os.environ.get(POSTGRESQL) else f"{POSTGRESQL} has no URL of a server to make databases in"


def use_postgresql(paths: list[Path]) -> None:
    """Give each service a new database of the server."""
    url = os.environ[POSTGRESQL]
    with create_engine(url, isolation_level="AUTOCOMMIT").connect() as server:
        for path in paths:
            name = f"skyrange_{path.stem}"
            server.execute(text(f"DROP DATABASE IF EXISTS {name} WITH (FORCE)"))
            server.execute(text(f"CREATE DATABASE {name}"))
            configured = path.read_text()
            own = re.sub(r"(?m)^database = .*$", f'database = "{url.rpartition("/")[0]}/{name}"', configured)
            path.write_text(own)


@asynccontextmanager
async def process(path: Path) -> AsyncIterator[asyncio.subprocess.Process]:
    """A service in a process of its own, from when it listens until it is killed."""
    child = await asyncio.create_subprocess_exec(
        Path(sys.executable).with_name("skyrange"), "utm", "serve", str(path), stderr=asyncio.subprocess.PIPE
    )
    try:
        assert child.stderr is not None
        assert b"listens at" in await child.stderr.readline()
        yield child
    finally:
        if child.returncode is None:
            child.kill()
        await child.wait()


async def details(federation: Federation, number: int) -> int:
    path = f"/uss/v1/operational_intents/{intent_id(f'blue/f{number}')}"
    token = await federation.token("south", COORDINATION)
    return (await federation.call("north", "GET", path, token=token))[0]


@pytest.mark.parametrize("victim", ["north", "dss"])
@pytest.mark.parametrize(
    "database", ["sqlite", pytest.param("postgresql", marks=pytest.mark.external(missing=WHY_NO_POSTGRESQL))]
)
def test_what_was_answered_before_a_kill_is_true_after_the_restart(tmp_path: Path, victim: str, database: str) -> None:
    paths = write(tmp_path)
    if database == "postgresql":
        use_postgresql([path for path in paths if path.stem != "auth"])
    (killed,) = [path for path in paths if path.stem == victim]
    rest = [path.stem for path in paths if path.stem != victim]

    async def body() -> None:
        start_ns = later(600)
        accepted: list[int] = []

        async def file_intents(federation: Federation) -> None:
            for number in range(500):
                intent = wanted(f"blue/f{number}", start_ns, 0.002 * number)
                try:
                    answer = await federation.want(intent)
                except aiohttp.ClientError:
                    return
                if answer["decision"] != "Accepted":
                    return
                accepted.append(number)

        async with running(paths, only=rest) as federation:
            async with process(killed) as child:
                filing = asyncio.create_task(file_intents(federation))
                while len(accepted) < 12:
                    await asyncio.sleep(0.005)
                child.send_signal(signal.SIGKILL)
                await child.wait()
                await filing
            async with process(killed):
                assert [await details(federation, number) for number in accepted] == [200] * len(accepted)
                for number in accepted[:3]:
                    active = wanted(f"blue/f{number}", start_ns, 0.002 * number, state=IntentState.ACTIVATED)
                    assert (await federation.want(active, version=1))["decision"] == "Accepted"
                    refused = await federation.want(wanted(f"red/f{number}", start_ns, 0.002 * number))
                    assert refused["decision"] == "Rejected"
                interrupted = wanted(f"blue/f{len(accepted)}", start_ns, 0.002 * len(accepted))
                assert (await federation.want(interrupted, version=2))["decision"] == "Accepted"
                ended = await federation.ask("blue", Request.end(interrupted))
                assert ended[1]["decision"] == "Ended"

    run(body)
