"""Other machines of a live range: who is let in, and what the supervisor makes of their clocks and files."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any, cast

import pytest

from skyrange import __version__
from skyrange.core.errors import ComponentError
from skyrange.record.folder import PARTS
from skyrange.runtime.live.supervisor.remote_hosts import RemoteHost, RemoteHosts
from skyrange.runtime.live.transport.control import CHUNK_BYTES, ControlServer, Message
from tests.live_ranges import VirtualSystem

WHERE = "10.9.0.2"
NAME = f"@{WHERE}"


class Overheard:
    """A control server that keeps what is sent by it."""

    def __init__(self) -> None:
        self.sent: list[tuple[str, Message, bytes]] = []

    async def send(self, who: str, kind: str, blob: bytes = b"", /, **data: Any) -> None:
        self.sent.append((who, {"kind": kind, **data}, blob))


def machines() -> tuple[RemoteHosts, Overheard, list[tuple[str, str]]]:
    control, ended = Overheard(), list[tuple[str, str]]()
    hosts = {WHERE: RemoteHost(WHERE)}
    clock = VirtualSystem().clock
    made = RemoteHosts("lab", cast("ControlServer", control), lambda node, how: ended.append((node, how)), hosts, clock)
    return made, control, ended


def hear(made: RemoteHosts, kind: str, who: str = NAME, blob: bytes = b"", **data: Any) -> bool:
    return asyncio.run(made.handle_message(who, {"kind": kind, **data}, blob))


def join(made: RemoteHosts, version: str = __version__, who: str = NAME) -> None:
    assert hear(made, "join", who, version=version, address=WHERE)


def test_one_that_is_expected_is_let_in_once() -> None:
    made, control, _ = machines()
    assert made.missing == [WHERE]
    join(made)
    assert control.sent[-1][1] == {"kind": "welcome", "name": "lab"}
    join(made)
    assert control.sent[-1][1]["kind"] == "refused"
    assert control.sent[-1][1]["value"] == f"{WHERE} again"


def test_another_version_and_another_address_are_refused_with_the_remedy() -> None:
    made, control, _ = machines()
    join(made, "0.0.9")
    refused = control.sent[-1][1]
    assert (refused["kind"], "0.0.9" in refused["value"], __version__ in refused["value"]) == ("refused", True, True)
    join(made, who="@10.9.0.7")
    refused = control.sent[-1][1]
    assert refused["kind"] == "refused"
    assert WHERE in refused["expected"]
    assert "--address" in refused["hint"]
    assert made.missing == [WHERE]


def test_nobody_is_heard_who_has_not_joined() -> None:
    made, control, ended = machines()
    for kind in ("clock", "ended", "chunk", "ask"):
        assert not hear(made, kind, node="world", how="x", words="", sent_ns=1, answered_ns=2, back_ns=3)
    assert not hear(made, "join", "world", version=__version__)
    assert (control.sent, ended, made.members[WHERE].clock.measured) == ([], [], 0)


def test_its_clock_tells_where_time_0_lies_on_it() -> None:
    made, control, ended = machines()
    join(made)
    assert hear(made, "ask", sent_ns=70)
    assert control.sent[-1][1]["sent_ns"] == 70
    assert hear(made, "clock", sent_ns=1_000_000, answered_ns=400_000, back_ns=1_200_000)
    assert made.missing == []
    made.zero_ns = 5_000_000
    assert made.zero_at(WHERE) == 5_000_000 + 700_000
    assert made.zero_at("10.9.0.1") == 5_000_000
    assert hear(made, "ended", node="blue.gcs", how="exit 3", words="why")
    assert ended == [("blue.gcs", "exit 3. It said last:\nwhy")]


def test_records_are_fetched_in_pieces_and_never_beside_the_folder(tmp_path: Path) -> None:
    made, control, _ = machines()
    join(made)
    data = b"row" * CHUNK_BYTES
    files = {"blue.gcs/manifest.json": b"{}", "blue.gcs/rows": data, "blue.gcs/none": b""}

    async def answer(listed: list[tuple[str, int]]) -> None:
        machine = made.members[WHERE]
        at = 0
        while True:
            await asyncio.sleep(0)
            for _, said, _ in control.sent[at:]:
                if said["kind"] == "parts":
                    machine.answers.put_nowait(({"kind": "parts"}, json.dumps(listed).encode()))
                elif said["kind"] == "fetch":
                    piece = files[said["name"]][said["offset"] : said["offset"] + CHUNK_BYTES]
                    machine.answers.put_nowait(({**said, "kind": "chunk"}, piece))
            at = len(control.sent)

    async def fetch(listed: list[tuple[str, int]]) -> None:
        control.sent.clear()
        answering = asyncio.create_task(answer(listed))
        try:
            await made.fetch_records(WHERE, tmp_path)
        finally:
            answering.cancel()

    async def both() -> None:
        await fetch([(name, len(content)) for name, content in files.items()])
        files["../../escaped"] = b"x"
        with pytest.raises(ComponentError, match="outside"):
            await fetch([("../../escaped", 1)])

    asyncio.run(both())
    assert (tmp_path / PARTS / "blue.gcs/rows").read_bytes() == data
    assert (tmp_path / PARTS / "blue.gcs/none").read_bytes() == b""
    assert not (tmp_path.parent / "escaped").exists()
