"""Does the viewer's stream of a run that flies hold what its record holds, without altering the run?"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from pathlib import Path

import aiohttp
import pytest

from skyrange.core.errors import InputError
from skyrange.record import RunRecord
from skyrange.scenario.shipped import load
from skyrange.study.runs import fly
from skyrange.view.flying import FlightView
from skyrange.view.folders import encode_folder
from skyrange.view.server import MAX_GATHERED, LiveStream, make_application, serve, thin
from skyrange.view.stream.events import StatusTable
from skyrange.view.stream.messages import Message, decode_file, decode_message
from tests.flights import shared_run
from tests.viewer_streams import positions_of, require_same_flight

pytestmark = pytest.mark.rotating

SCENE, EVENTS = Message("S", {"version": 1, "flying": True}), Message("E", {"arm": 0, "names": []})
FLIGHTS = {
    "gnss.jump": ("duration_s=15", "attacks.*.start_s=4"),
    "link.delay": ("duration_s=15", "attacks.*.start_s=4"),
    "approval.squat": ("duration_s=15",),
    "rid-spoofing": ("duration_s=15", "attacks.*.start_s=4"),
    "head-on": ("duration_s=40",),
    "squares": ("duration_s=12", "record.level=study"),
}


class Host:
    """Keeps messages, decoded; looks whether anybody watches are answered in turn, and from then on by the last."""

    def __init__(self, *looks: bool) -> None:
        self._looks = iter(looks)
        self._watched = True
        self.messages: list[Message] = []
        self.told: list[int] = []
        """How many messages there were at each look."""
        self.file = b""

    @property
    def watched(self) -> bool:
        self.told.append(len(self.messages))
        self._watched = next(self._looks, self._watched)
        return self._watched

    def publish(self, message: Message) -> None:
        self.messages.append(decode_message(message.encode()))

    def restart(self) -> None:
        self.messages = []

    def replace(self, data: bytes) -> None:
        self.file = data


def flown(name: str, changes: Sequence[str], folder: Path) -> tuple[RunRecord, list[Message]]:
    """A run with a view, whose messages were encoded and decoded."""
    scenario, host = load(name, changes), Host()
    view = FlightView(scenario, host, every_s=0.004)
    record = fly(scenario, folder, on_start=view.start, report=False)
    view.finish(record)
    assert view.fault is None
    return record, host.messages


@pytest.mark.parametrize("name", FLIGHTS)
def test_it_is_what_is_recorded_and_the_run_is_the_same(name: str, tmp_path: Path) -> None:
    record, live = flown(name, FLIGHTS[name], tmp_path / "run")
    alone = shared_run(name, *FLIGHTS[name])
    assert record.manifest["digests"] == alone.manifest["digests"]
    recorded = list(decode_file(encode_folder(alone.path)))

    first, last = live[0].head, live[-1].head
    assert [first["flying"], last["flying"], last["arms"][0]["status"]] == [True, False, "complete"]
    assert last["end_s"] == float(record.manifest["simulated_s"])
    for key in ("vehicles", "radios", "operators"):
        assert last[key] == recorded[0].head[key]
    shown = recorded[0].head["end_s"]  # a record is shown until nothing happens any more
    for volumes in (last["volumes"], recorded[0].head["volumes"]):
        for volume in volumes:
            volume["until_s"] = min(volume["until_s"], shown)
    assert [volume for volume in last["volumes"] if volume["from_s"] < shown] == recorded[0].head["volumes"]
    assert all((live[0].arrays[array] == recorded[0].arrays[array]).all() for array in live[0].arrays)

    require_same_flight(live, recorded)
    assert max(time_ms for _, _, time_ms in positions_of(live)) >= 1000 * last["end_s"] - 200
    newest_s = 0.0
    for message in live[:-2]:  # what comes last is told at the end
        if message.kind == "P" and message.head["layer"] == "truth":
            newest_s = message.head["from_s"] + (message.head["samples"] - 1) * message.head["step_s"]
        elif message.kind == "E":
            assert message.head["until_s"] <= newest_s + 1e-9


@pytest.mark.parametrize("comes_back", [True, False])
def test_while_nobody_watches_nothing_is_told_and_then_everything(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, comes_back: bool
) -> None:
    monkeypatch.setattr("skyrange.view.flying.UNWATCHED_S", 0.004)
    looks = [True, False, False, comes_back]
    scenario, host = load("rid-spoofing", FLIGHTS["rid-spoofing"]), Host(*looks)
    view = FlightView(scenario, host, every_s=0.004)
    record = fly(scenario, tmp_path / "run", on_start=view.start, report=False)
    view.finish(record)
    assert view.fault is None
    assert len(host.told) >= len(looks)
    assert host.told[0] < host.told[1] == host.told[2]
    assert record.manifest["digests"] == shared_run("rid-spoofing", *FLIGHTS["rid-spoofing"]).manifest["digests"]
    recorded = encode_folder(record.path)
    if comes_back:
        assert host.messages[-1].head["flying"] is False
        require_same_flight(host.messages, list(decode_file(recorded)))
    else:
        assert len(host.messages) == host.told[1]
        assert host.file == recorded


def test_a_fault_of_the_view_ends_the_view_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scenario, host = load("squares", ("duration_s=12",)), Host()
    view = FlightView(scenario, host, every_s=0.004)
    monkeypatch.setattr(StatusTable, "rows", None)
    record = fly(scenario, tmp_path / "run", on_start=view.start, report=False)
    view.finish(record)
    assert isinstance(view.fault, TypeError)
    assert record.manifest["digests"] == shared_run("squares", "duration_s=12").manifest["digests"]
    last = host.messages[-1].head
    assert (last["flying"], last["arms"][0]["status"]) == (False, "not shown to its end")


@pytest.mark.parametrize("change", ['record.level="summary"', "record.truth_hz=0"])
def test_a_run_whose_record_has_no_truth_is_refused(change: str) -> None:
    with pytest.raises(InputError, match=change.partition("=")[0]):
        FlightView(load("squares", (change,)), Host())


def test_a_page_that_connects_late_gets_everything_and_one_that_closes_costs_nothing() -> None:
    async def run() -> tuple[list[str], int]:
        stream = LiveStream()
        stream.publish(SCENE)
        async with serve(make_application(stream), "127.0.0.1", 0) as url, aiohttp.ClientSession() as session:
            async with session.ws_connect(url + "stream", origin=url.rstrip("/")) as socket:
                first = await socket.receive_bytes()
                stream.publish(EVENTS)
                second = await socket.receive_bytes()
                await socket.send_str("nothing that matters")
            async with session.ws_connect(url + "stream") as socket:
                third = await socket.receive_bytes()
                await socket.send_bytes(bytes(1 << 16))  # too much: it is disconnected
                await socket.receive()
                await socket.receive()
                assert socket.closed
            for _ in range(100):
                if not stream._clients:
                    break
                await asyncio.sleep(0.05)
            async with session.get(url) as page:
                assert 'data-source="socket"' in await page.text()
        return [decode_message(data).kind for data in (first, second, third)], len(stream._clients)

    assert asyncio.run(run()) == (["S", "E", "S"], 0)


def test_a_stream_that_ends_closes_the_sockets_of_pages_that_were_there_and_of_those_that_come() -> None:
    async def run() -> list[tuple[str, int | None]]:
        stream, found = LiveStream(), []
        stream.publish(SCENE)
        async with (
            serve(make_application(stream), "127.0.0.1", 0) as url,
            aiohttp.ClientSession() as session,
            session.ws_connect(url + "stream") as early,
        ):
            got = [await early.receive_bytes()]
            for message in (EVENTS, Message("S", {"version": 1, "flying": False})):
                stream.publish(message)
            async with session.ws_connect(url + "stream") as late:
                for socket, kinds in ((early, got), (late, [])):
                    kinds += [message.data async for message in socket]
                    found.append(("".join(decode_message(data).kind for data in kinds), socket.close_code))
        return found

    assert asyncio.run(run()) == [("SES", 1000), ("SES", 1000)]


def test_a_slow_page_misses_positions_alone() -> None:
    gathered = [("P", b"p%d" % number) if number % 2 else ("E", b"e%d" % number) for number in range(200)]
    sent = thin(gathered)
    assert [data for data in sent if data.startswith(b"e")] == [data for kind, data in gathered if kind == "E"]
    assert sent[-MAX_GATHERED:] == [data for _, data in gathered[-MAX_GATHERED:]]
    assert len(sent) < len(gathered)
