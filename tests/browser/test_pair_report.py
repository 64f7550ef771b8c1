"""The report of a pair in a real browser: it opens at the effect, and its numbers lead to their moments."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest

from skyrange.report.pair.page import write_comparison
from skyrange.twins.pair_folder import Pair
from skyrange.view.opening import LEAD_S
from tests.browser.chromium import Opened, missing, visit

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Locator

pytestmark = pytest.mark.external(missing=missing())


def await_that(opened: Opened, holds: Callable[[], bool]) -> None:
    for _ in range(100):
        if holds():
            return
        opened.page.wait_for_timeout(100)
    assert holds()


def time_of(opened: Opened) -> float:
    time_s: float = opened.page.evaluate("skyrangeViewer.store.view.time")
    return time_s


def test_it_opens_shortly_before_the_first_departure(browser: Browser, spoofed: Pair) -> None:
    departed_s = min(
        row["departed_s"]
        for row in spoofed.effects.to_pylist()
        if row["seed"] == spoofed.seeds[0] and row["departed_s"] is not None
    )
    opened = visit(browser, spoofed.report, reduced_motion="reduce")
    await_that(opened, lambda: abs(time_of(opened) - (departed_s - LEAD_S)) < 0.01)
    words = opened.page.locator(".sky-verdict").inner_text()
    assert re.fullmatch(r"ghost made green/g1 leave its path at .*With seed \d+; it did so in 2 of 2 seeds\.", words)
    opened.close()


def test_numbers_boxes_and_marks_lead_to_their_moments(browser: Browser, spoofed: Pair) -> None:
    opened = visit(browser, spoofed.report, "#t=10")
    page = opened.page
    await_that(opened, lambda: time_of(opened) == 10.0)

    def check(link: Locator) -> None:
        wanted = re.match(r"#t=([\d.]+)(?:&select=([^&]*))?", link.get_attribute("href") or "")
        assert wanted is not None
        link.scroll_into_view_if_needed()
        link.focus()
        page.keyboard.press("Enter")
        await_that(opened, lambda: abs(time_of(opened) - float(wanted[1])) < 0.01)
        await_that(
            opened, lambda: page.evaluate("Math.abs(document.getElementById('scene').getBoundingClientRect().top) < 80")
        )
        if wanted[2]:
            chosen = page.evaluate("skyrangeViewer.store.nodeName(skyrangeViewer.store.view.selected)")
            assert chosen == wanted[2]

    for place in (
        ".tiles a",
        "#effects tbody a",
        "#chain .still a",
        "#chain .lanes a",
        "#chain tbody a",
        "#attacks td a",
    ):
        assert page.locator(place).count() > 0, place
        check(page.locator(place).last)
    times = {link.get_attribute("href") for link in page.locator("a[href^='#t=']").all()}
    assert len(times) > 20
    assert opened.messages == []
    opened.close()


def test_without_a_stream_a_moment_is_said_where_the_viewer_would_be(
    browser: Browser, spoofed: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("skyrange.report.viewer.MAX_STREAM_BYTES", 100)
    opened = visit(browser, write_comparison(spoofed, spoofed.path / "without.html"))
    opened.page.locator("#effects tbody a").first.click()
    words = opened.page.locator("#scene").inner_text()
    assert re.search(r"skyrange watch .* shows them: at [\d.]+ s, green/g1\.", words)
    assert opened.messages == []
    opened.close()
