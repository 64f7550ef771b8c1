"""The report of a run in a real browser: its views follow the viewer's clock and set it, tables, panels and chart."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from skyrange.report import write_report
from tests.browser.chromium import Opened, missing, visit
from tests.unit.study_sample import squares

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytestmark = pytest.mark.external(missing=missing())

AT_S = 15.0
END_S = 40.7
"""Where the views of the sample end (`test_study_report`)."""


@pytest.fixture
def opened(browser: Browser, run_page: Path) -> Iterator[Opened]:
    """The report of a run, standing at `AT_S`."""
    found = visit(browser, run_page, f"#t={AT_S:g}", viewport={"width": 1000, "height": 800})
    await_that(found, lambda: time_of(found) == AT_S)
    yield found
    assert found.messages == []
    found.close()


def time_of(opened: Opened) -> float:
    time_s: float = opened.page.evaluate("skyrangeViewer.store.view.time")
    return time_s


def selected(opened: Opened) -> str:
    name: str = opened.page.evaluate("skyrangeViewer.store.nodeName(skyrangeViewer.store.view.selected)")
    return name


def await_that(opened: Opened, holds: Callable[[], bool]) -> None:
    for _ in range(100):
        if holds():
            return
        opened.page.wait_for_timeout(100)
    assert holds()


def test_it_plays_when_it_opens_unless_motion_is_unwanted(browser: Browser, run_page: Path) -> None:
    moving = visit(browser, run_page)
    await_that(moving, lambda: time_of(moving) > 0.2)
    assert moving.page.get_by_role("button", name="Pause").is_visible()
    moving.close()
    still = visit(browser, run_page, reduced_motion="reduce")
    await_that(still, lambda: abs(time_of(still) - END_S / 2) < 0.5)
    assert still.page.get_by_role("button", name="Play", exact=True).is_visible()
    still.close()


def test_a_moment_that_is_linked_is_shown_and_its_aircraft_selected(opened: Opened) -> None:
    page = opened.page
    row = page.locator("#events tbody tr", has_text="green/g2").nth(1)
    link = row.locator("a")
    wanted_s = float(link.inner_text())
    link.focus()
    page.keyboard.press("Enter")
    await_that(opened, lambda: abs(time_of(opened) - wanted_s) < 0.01)
    assert selected(opened) == "green/g2"
    await_that(opened, lambda: page.evaluate("document.getElementById('viewer').getBoundingClientRect().top > -10"))
    assert page.locator(".sky-view").bounding_box() is not None
    page.evaluate("skyrangeViewer.store.seek(30)")
    page.locator("#log").scroll_into_view_if_needed()
    link.click()  # the address may be the same
    await_that(opened, lambda: abs(time_of(opened) - wanted_s) < 0.01)


def test_lanes_and_chart_set_the_clock(opened: Opened) -> None:
    page = opened.page
    lanes = page.locator(".lane-marks").nth(1)
    lanes.scroll_into_view_if_needed()
    box = lanes.bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + box["width"] / 4, box["y"] + 24)
    await_that(opened, lambda: abs(time_of(opened) - END_S / 4) < 0.5)
    before = time_of(opened)
    page.locator("#chart canvas").focus()
    page.keyboard.press("ArrowRight")
    await_that(opened, lambda: time_of(opened) > before)


def test_what_is_under_the_pointer_is_marked_everywhere(opened: Opened) -> None:
    page = opened.page
    page.locator('#missions tr[data-v="3"]').hover()
    marked = page.locator("tr.focus, .lane.focus")
    await_that(opened, lambda: {row.get_attribute("data-v") for row in marked.all()} == {"3"})
    assert page.evaluate("skyrangeViewer.store.view.hovered") == 3
    page.locator("h2").first.hover()
    await_that(opened, lambda: marked.count() == 0)


def test_an_operator_that_the_viewer_hides_is_hidden_on_the_plan(opened: Opened) -> None:
    chip = opened.page.get_by_role("button", name="blue 2")
    chip.focus()
    opened.page.keyboard.press("Enter")
    await_that(opened, lambda: opened.page.locator("#plan .line.off").count() > 0)
    opened.page.keyboard.press("Enter")
    await_that(opened, lambda: opened.page.locator("#plan .line.off").count() == 0)


@pytest.mark.parametrize("folded", [False, True])
def test_a_table_is_filtered_by_text_and_kind(
    browser: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, folded: bool
) -> None:
    monkeypatch.setattr("skyrange.report.rendering.MAX_ROWS_READY", 10 if folded else 1000)
    monkeypatch.setattr("skyrange.report.rendering.MAX_ROWS_WHOLE", 10 if folded else 1000)
    opened = visit(browser, write_report(squares(tmp_path, hostile=True), tmp_path / "report.html"), "#t=15")
    bar, rows = opened.page.locator('.filter[data-table="events"]'), opened.page.locator("#events tbody tr")
    assert (rows.count() == 10) == folded
    output = bar.locator("output")
    bar.locator("input").fill("b1 mode")
    await_that(opened, lambda: output.inner_text() == "3 rows")
    assert [("blue/b1" in row.inner_text()) for row in rows.all() if row.is_visible()] == [True] * 3
    bar.locator("input").fill("")
    bar.locator("select").select_option("event.takeoff")
    await_that(opened, lambda: output.inner_text() == "5 rows")
    bar.locator("select").select_option("")
    await_that(opened, lambda: output.inner_text() == "72 rows")
    assert sum(row.is_visible() for row in rows.all()) == 72
    assert opened.messages == []
    opened.close()


def test_rows_are_made_as_a_table_is_scrolled_and_all_at_once_on_demand(
    browser: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("skyrange.report.rendering.MAX_ROWS_READY", 20)
    monkeypatch.setattr("skyrange.report.rendering.MAX_ROWS_WHOLE", 20)
    opened = visit(browser, write_report(squares(tmp_path, hostile=True), tmp_path / "report.html"), "#t=15")
    page, events, decisions = opened.page, opened.page.locator("#events"), opened.page.locator("#decisions")
    assert events.locator("tbody tr").count() == 20
    assert decisions.locator("tbody tr").count() == 15
    box = page.locator(".scroll", has=events)
    assert box.get_attribute("tabindex") == "0", "it is scrolled by keys"
    assert "20 of 72 rows" in box.locator(".more").inner_text()
    box.focus()
    page.keyboard.press("End")
    await_that(opened, lambda: events.locator("tbody tr").count() == 72)
    assert not box.locator(".more").is_visible()
    texts = [row.inner_text() for row in events.locator("tbody tr td:first-child").all()]
    assert texts == sorted(texts, key=float)
    opened.close()


def test_panels_turn_and_the_chart_shows_other_quantities(opened: Opened) -> None:
    page = opened.page
    panel = page.locator(".panel canvas").first
    panel.scroll_into_view_if_needed()
    before = opened.pixels(panel)
    panel.focus()
    page.keyboard.press("ArrowLeft")
    assert (np.abs(opened.pixels(panel) - before).max(axis=2) > 30).mean() > 0.005
    page.get_by_role("button", name="Speed", exact=True).click()
    assert "true speed" in page.locator("#chart figcaption").inner_text()


def test_without_a_stream_the_charts_still_work(
    browser: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("skyrange.report.viewer.MAX_STREAM_BYTES", 100)
    opened = visit(browser, write_report(squares(tmp_path), tmp_path / "report.html"), "#t=15")
    page = opened.page
    assert page.locator("#overview svg").is_visible()
    page.locator("#chart canvas").focus()
    page.keyboard.press("ArrowLeft")
    page.locator('#missions tr[data-v="3"]').hover()
    await_that(opened, lambda: page.locator('.lane.focus[data-v="3"]').count() == 1)
    assert opened.messages == []
    opened.close()
