"""`skyrange live --view`: a real browser's socket gets what the range records while it flies, and then its record."""

from __future__ import annotations

import asyncio
import re
import signal
from pathlib import Path

import aiohttp
import pytest

from skyrange.record import load
from skyrange.view.stream.messages import Message, decode_message
from tests.integration.live_programs import ONE_AIRCRAFT, live, until
from tests.ports import OFFSET
from tests.viewer_streams import events_of, positions_of

pytestmark = pytest.mark.realtime


async def watch(url: str) -> list[tuple[list[Message], int | None]]:
    """The messages of each connection until the stream ends, and how each was closed."""
    found: list[tuple[list[Message], int | None]] = []
    async with aiohttp.ClientSession() as session:
        while not found or found[-1][1] != 1000:
            async with session.ws_connect(url + "stream", max_msg_size=0) as socket:
                messages = [decode_message(message.data) async for message in socket]
            found.append((messages, socket.close_code))
    return found


def test_a_live_range_is_seen_as_it_flies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BROWSER", "true")
    with live(tmp_path, ONE_AIRCRAFT.format(seconds=10), OFFSET, "--view", "--group", "component") as flight:
        until(lambda: "watch the run at" in flight.said, 60.0, "the viewer", flight.program)
        (url,) = re.findall(r"http://\S+", flight.said)
        flying, recorded = asyncio.run(asyncio.wait_for(watch(url), 150.0))
        until(lambda: "The viewer runs until Ctrl-C" in flight.said, 30.0, "the end", flight.program)
        flight.program.send_signal(signal.SIGINT)
        flight.program.communicate(timeout=30.0)
    assert flight.program.returncode == 0, flight.said
    assert (flying[1], recorded[1]) == (1012, 1000)
    record = load(tmp_path / "run")
    assert recorded[0][0].head["arms"][0]["status"] == record.status == "complete"
    assert flying[0][0].head["flying"]
    seen, whole = positions_of(flying[0]), positions_of(recorded[0])
    assert len(seen) > 0.7 * len(whole)
    kinds = [row["kind"] for row in events_of(flying[0]).rows["notes"]]
    assert "event.takeoff" in kinds
    assert any(row["plan"] for message in flying[0] if message.kind == "S" for row in message.head["vehicles"])
