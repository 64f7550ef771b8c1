"""The viewer with hundreds of aircraft over a city: it loads, plays, and its names stay legible."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest

from skyrange.view.server import RecordedStream, make_application, serve_beside
from tests.browser.chromium import missing, visit
from tools.viewer_fleet import encode_fleet, make_city, make_flights

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytestmark = [pytest.mark.external(missing=missing()), pytest.mark.slow]

MAX_BYTES = 3_000_000
MAX_CALLS = 20
COLLECT = """
window.names = [];
const draw = CanvasRenderingContext2D.prototype.drawImage, clear = CanvasRenderingContext2D.prototype.clearRect;
CanvasRenderingContext2D.prototype.clearRect = function (...given) {
  if (this.canvas.className === "sky-over") window.names = [];
  return clear.apply(this, given);
};
CanvasRenderingContext2D.prototype.drawImage = function (...given) {
  if (this.canvas.className === "sky-over" && given.length === 5) window.names.push(given.slice(1));
  return draw.apply(this, given);
};
"""
"""Keeps left, top, width and height of each name of the newest frame."""
HALO_PX = 2.0


@pytest.mark.parametrize(("aircraft", "seconds"), [(500, 300.0), (1000, 60.0)])
def test_many_aircraft_load_play_and_stay_legible(
    browser: Browser, aircraft: int, seconds: float, record_property: Callable[[str, object], None]
) -> None:
    city = make_city()
    stream = encode_fleet(make_flights(aircraft, city, seconds), city)
    with serve_beside(make_application(RecordedStream(stream)), "127.0.0.1", 0) as url:
        began = time.perf_counter()
        opened = visit(browser, url, "#t=40", script=COLLECT)
        page = opened.page
        for _ in range(600):
            if page.evaluate(f"() => window.skyrangeViewer?.store.newest >= {seconds}"):
                break
            page.wait_for_timeout(100)
        loaded_s = time.perf_counter() - began
        page.wait_for_timeout(1000)
        octets = page.evaluate(
            "performance.getEntriesByType('resource').reduce((sum, one) => sum + one.encodedBodySize, 0)"
        )
        elements = page.evaluate("document.querySelectorAll('*').length")
        width, height = page.evaluate(
            "(({ clientWidth: w, clientHeight: h }) => [w, h])(document.querySelector('.sky-over'))"
        )
        for view in ("3-D", "Top"):
            page.get_by_role("button", name=view, exact=True).click()
            page.wait_for_timeout(800)
            boxes = page.evaluate("window.names")
            assert len(boxes) >= 40, view
            for place, (left, top, wide, high) in enumerate(boxes):
                assert left >= 0
                assert top >= 0
                assert left + wide <= width + HALO_PX
                assert top + high <= height + HALO_PX
                for other_left, other_top, other_wide, other_high in boxes[:place]:
                    across = min(left + wide, other_left + other_wide) - max(left, other_left)
                    down = min(top + high, other_top + other_high) - max(top, other_top)
                    assert across <= 2 * HALO_PX or down <= 2 * HALO_PX, (view, "two names cover each other")
        before = float(page.get_by_role("slider", name="Time").input_value())
        page.get_by_role("button", name="Play").click()
        page.wait_for_timeout(3000)
        page.get_by_role("button", name="Pause").click()
        assert float(page.get_by_role("slider", name="Time").input_value()) > before + 1
        assert page.evaluate("window.skyrangeViewer.drawCalls()") <= MAX_CALLS
        assert opened.messages == []
        print(f"{aircraft} aircraft: {octets / 1e6:.2f} MB, {elements} elements, read after {loaded_s:.1f} s")
        record_property("bytes", octets)
        assert octets > len(stream)
        if aircraft <= 500:
            assert octets <= MAX_BYTES
        assert elements < 2000
        opened.close()
