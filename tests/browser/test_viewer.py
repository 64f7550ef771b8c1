"""The viewer in a real browser: recorded, live, without WebGL, with hostile texts and broken streams."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from aiohttp import web

from skyrange.scenario.shipped import load
from skyrange.study.runs import fly
from skyrange.view.access import open_access
from skyrange.view.flying import FlightView
from skyrange.view.folders import encode_folder, read_folder_arms
from skyrange.view.record_queries import RecordQueries
from skyrange.view.server import LiveStream, RecordedStream, make_application, serve_beside
from skyrange.view.stream.messages import Message, Part, decode_file, encode_file
from tests.browser.chromium import WITHOUT_WEBGL, Opened, launched, missing, visit
from tests.certificates import make_certificate
from tests.flights import shared_pair

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Playwright

pytestmark = pytest.mark.external(missing=missing())

HOSTILE = '<img src=x onerror="alert(1)">'


@pytest.fixture(scope="module")
def stream() -> bytes:
    return encode_folder(shared_pair("rid-spoofing", "duration_s=75").path)


@contextmanager
def shown(browser: Browser, served: RecordedStream | LiveStream, at: str = "") -> Iterator[Opened]:
    with serve_beside(make_application(served), "127.0.0.1", 0) as url:
        opened = visit(browser, url, at)
        try:
            yield opened
        finally:
            opened.close()


def time_of(opened: Opened) -> float:
    return float(opened.page.get_by_role("slider", name="Time").input_value())


def await_time(opened: Opened, time_s: float) -> None:
    """Wait until the page shows a time, which it does once it has read its stream."""
    for _ in range(100):
        slider = opened.page.get_by_role("slider", name="Time")
        if slider.count() and float(slider.input_value()) == time_s:
            return
        opened.page.wait_for_timeout(200)
    raise AssertionError(f"the page does not show {time_s} s")


def test_a_pair_plays_and_its_address_shows_the_same_again(browser: Browser, stream: bytes) -> None:
    with shown(browser, RecordedStream(stream)) as opened:
        page = opened.page
        page.get_by_text("ghost made green/g1 leave its path").wait_for()
        page.get_by_role("button", name="attacked").wait_for()
        before = time_of(opened)
        if page.get_by_role("button", name="Play").count():
            page.get_by_role("button", name="Play").click()
        page.wait_for_timeout(1500)
        page.get_by_role("button", name="Pause").click()
        assert time_of(opened) > before
        page.get_by_role("slider", name="Time").fill("60")
        page.get_by_text("green/g1", exact=True).first.click()
        page.wait_for_timeout(800)
        address = page.evaluate("location.hash")
        assert "t=60.0" in address
        assert "select=green/g1" in address
        picture = opened.pixels()
        assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 500
        assert opened.messages == []
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    with shown(browser, RecordedStream(stream), address) as opened:
        await_time(opened, 60.0)
        assert opened.page.evaluate("location.hash") == address


def test_frames_and_fields_of_a_record_are_shown(browser: Browser) -> None:
    arms = read_folder_arms(shared_pair("hijack", "duration_s=60").path)
    application = make_application(RecordedStream(arms.encode()), queries=RecordQueries(arms.records))
    with serve_beside(application, "127.0.0.1", 0) as url:
        opened = visit(browser, url, "#t=42&select=blue/b1")
        page = opened.page
        page.get_by_text("Frames on its links").click()
        forwarded = page.locator(".sky-links .sky-hostile", has_text="mallory: inject, forwarded")
        forwarded.first.wait_for()
        assert page.locator(".sky-links h4").first.text_content() == "gcs blue.gcs → blue/b1.companion"
        page.get_by_text("Recorded fields").click()
        page.locator("option", has_text="battery_v").first.wait_for(state="attached")
        page.get_by_label("Field to plot").select_option('["truth","up_m"]')
        page.get_by_text("truth.up_m: 30").wait_for()
        drawn = page.locator(".sky-plots canvas").evaluate(
            "(one) => one.getContext('2d').getImageData(0, 0, one.width, one.height).data.some((byte) => byte)"
        )
        assert drawn
        assert opened.messages == []
        opened.close()


def test_a_run_is_seen_while_it_flies(browser: Browser, tmp_path: Path) -> None:
    scenario, live = load("squares", ["duration_s=30"]), LiveStream()
    view = FlightView(scenario, live)
    with shown(browser, live) as opened:
        record = fly(scenario, tmp_path / "run", on_start=view.start, report=False)
        opened.page.get_by_text("aircraft · flying").wait_for()
        view.finish(record)
        opened.page.get_by_text("aircraft · flying").wait_for(state="detached")
        opened.page.get_by_role("slider", name="Time").fill("20")
        opened.page.wait_for_timeout(500)
        assert 20.0 <= time_of(opened) <= 24.0
        assert opened.messages == []


class BrokenOnce(LiveStream):
    """A stream whose first client is cut off after two messages."""

    def __init__(self) -> None:
        super().__init__()
        self.clients = 0

    async def answer(self, request: web.Request) -> web.WebSocketResponse:
        self.clients += 1
        if self.clients > 1:
            return await super().answer(request)
        socket = web.WebSocketResponse()
        await socket.prepare(request)
        for _, data in self._messages[:2]:
            await socket.send_bytes(data)
        assert request.transport is not None
        request.transport.abort()
        return socket


@pytest.mark.parametrize(("served", "clients"), [(LiveStream(), None), (BrokenOnce(), 2)])
def test_a_page_starts_over_after_a_loss_and_stays_after_the_end(
    browser: Browser, stream: bytes, served: LiveStream, clients: int | None
) -> None:
    scene, *others = decode_file(stream)
    for message in (Message("S", scene.head | {"flying": True}, scene.arrays), *others, scene):
        served.publish(message)
    notes = sum(len(message.head.get("notes", {"t": []})["t"]) for message in others if message.head["arm"] == 0)
    with shown(browser, served) as opened:
        size = "window.skyrangeViewer?.store.arms[0]?.events.notes.size"
        for _ in range(100):
            if opened.page.evaluate(size) == notes and not opened.page.evaluate("skyrangeViewer.store.scene.flying"):
                break
            opened.page.wait_for_timeout(100)
        opened.page.wait_for_timeout(1500)  # in which a page that reconnects would
        assert opened.page.evaluate(size) == notes
        assert opened.page.evaluate("skyrangeViewer.store.notice") == ""
        assert clients is None or served.clients == clients  # type: ignore[attr-defined]


@pytest.mark.parametrize("flying", [False, True])
def test_another_machine_sees_it_over_tls_with_the_printed_address(
    browser: Browser, stream: bytes, tmp_path: Path, flying: bool
) -> None:
    access, live = open_access("127.0.0.1", *make_certificate(tmp_path)), LiveStream()
    live.replace(stream)
    served = live if flying else RecordedStream(stream)
    with serve_beside(make_application(served, access=access), "127.0.0.1", 0) as url:
        opened = visit(browser, url, "#t=50", ignore_https_errors=True)
        await_time(opened, 50.0)
        assert "token" not in opened.page.url
        assert opened.messages == []
        opened.close()
        stranger = visit(browser, url.partition("?")[0], ignore_https_errors=True)
        stranger.page.get_by_text("those who open the address that skyrange printed").wait_for()
        stranger.close()


def test_it_is_drawn_without_webgl(driver: Playwright, stream: bytes) -> None:
    with launched(driver, *WITHOUT_WEBGL) as browser, shown(browser, RecordedStream(stream), "#t=50") as opened:
        opened.page.wait_for_timeout(1500)
        assert len(np.unique(opened.pixels().reshape(-1, 3), axis=0)) > 500
        assert [message for message in opened.messages if message.startswith("error")] == []


def test_hostile_texts_stay_texts(browser: Browser, stream: bytes) -> None:
    scene, *others = decode_file(stream)
    head = scene.head | {"name": HOSTILE, "verdict": HOSTILE}
    head["vehicles"] = [row | {"id": HOSTILE + row["id"]} for row in head["vehicles"]]
    for message in others:
        if message.kind == "E":
            message.head["names"] = [HOSTILE for _ in message.head["names"]]
    data = encode_file(Message("S", head, scene.arrays), [Part(0.0, 75.0, others)])
    with shown(browser, RecordedStream(data), "#t=50") as opened:
        opened.page.get_by_text(HOSTILE).first.click()
        opened.page.wait_for_timeout(1000)
        assert opened.dialogs == []
        assert opened.page.locator("img").count() == 0
        assert opened.messages == []


@pytest.mark.parametrize("cut", [0, 5, 300, -40])
def test_a_broken_stream_says_so(browser: Browser, stream: bytes, cut: int) -> None:
    with shown(browser, RecordedStream(stream[:cut])) as opened:
        opened.page.get_by_role("alert").or_(opened.page.get_by_role("status")).first.wait_for()
        opened.page.wait_for_timeout(500)
        text = opened.page.inner_text("body").lower()
        assert any(word in text for word in ("cannot", "could not", "broken", "cut short", "ends", "not a"))


def test_another_version_is_refused(browser: Browser, stream: bytes) -> None:
    scene, *_ = decode_file(stream)
    data = encode_file(Message("S", scene.head | {"version": 2}, scene.arrays), [])
    with shown(browser, RecordedStream(data)) as opened:
        opened.page.get_by_text("version").first.wait_for()


def test_the_report_of_a_pair_plays(browser: Browser) -> None:
    opened = visit(browser, shared_pair("rid-spoofing", "duration_s=75").report, "#t=60")
    opened.page.get_by_text("ghost made green/g1 leave its path").wait_for()
    await_time(opened, 60.0)
    opened.page.get_by_role("button", name="Play").click()
    opened.page.wait_for_timeout(1000)
    assert time_of(opened) > 60.0
    assert opened.messages == []
    assert len(opened.requests) == 1
    opened.close()
