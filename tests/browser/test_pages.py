"""Every kind of report in a real browser: no error, no request, each part drawn, in light, in dark and on paper."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from skyrange.record import load
from skyrange.report import write_report
from skyrange.twins.pair_folder import Pair
from tests.browser.chromium import missing, visit
from tests.unit.study_sample import SampleRun, squares

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = pytest.mark.external(missing=missing())

BLANK = {"name": "blank", "status": "complete", "vehicles": [], "operators": []}


def ended(status: str) -> Callable[[Path], Path]:
    return lambda folder: write_report(squares(folder, status=status, seconds=15), folder / "report.html")


def blank(folder: Path) -> Path:
    return write_report(SampleRun(folder, BLANK, [], {}), folder / "report.html")


def check_opens(browser: Browser, path: Path, heading: str) -> None:
    opened = visit(browser, path)
    assert opened.page.locator("h1").inner_text().startswith(heading)
    opened.page.wait_for_timeout(300)  # what a script does later
    assert opened.messages == []
    assert opened.requests == [path.resolve().as_uri()]
    assert opened.page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    opened.close()


def test_the_report_of_a_run_opens(browser: Browser, run_page: Path) -> None:
    check_opens(browser, run_page, "squares")


@pytest.mark.parametrize(
    ("make", "heading"),
    [(ended("running"), "squares"), (ended("interrupted"), "squares"), (ended("failed"), "squares"), (blank, "blank")],
    ids=["killed", "interrupted", "failed", "blank"],
)
def test_the_report_of_a_run_that_fell_short_opens(
    browser: Browser, make: Callable[[Path], Path], heading: str, tmp_path: Path
) -> None:
    check_opens(browser, make(tmp_path), heading)


def test_the_reports_of_a_pair_and_of_its_runs_open(browser: Browser, spoofed: Pair) -> None:
    check_opens(browser, spoofed.report, "rid-spoofing")
    for seed in spoofed.seeds:
        check_opens(browser, spoofed.run("attacked", seed).path / "report.html", "rid-spoofing")


def test_the_report_of_a_pair_with_false_sensors_opens(browser: Browser, drifted: Pair) -> None:
    check_opens(browser, drifted.report, "gnss-drift")


def test_a_flown_run_is_drawn_again_as_it_was(browser: Browser, drifted: Pair, tmp_path: Path) -> None:
    again = write_report(load(drifted.run("attacked").path), tmp_path / "again.html")
    check_opens(browser, again, "gnss-drift")


def test_a_page_as_narrow_as_a_telephone_does_not_scroll_sideways(
    browser: Browser, run_page: Path, spoofed: Pair
) -> None:
    for path in (run_page, spoofed.report):
        opened = visit(browser, path, viewport={"width": 390, "height": 844})
        assert opened.page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        opened.close()


@pytest.mark.parametrize("kind", ["run", "pair"])
def test_light_and_dark_are_two_looks_of_one_page(browser: Browser, run_page: Path, spoofed: Pair, kind: str) -> None:
    path = run_page if kind == "run" else spoofed.report
    brightness, words = {}, {}
    for scheme in ("light", "dark"):
        opened = visit(browser, path, "#t=20", color_scheme=scheme)
        shown = opened.pixels()
        brightness[scheme] = float(np.median(shown))
        words[scheme] = opened.page.locator("main").inner_text()
        assert opened.messages == []
        if kind == "run":  # the scene follows the page
            opened.page.emulate_media(color_scheme="dark" if scheme == "light" else "light")
            turned = float(np.median(opened.pixels(opened.page.locator(".sky-view"))))
            assert (turned < 90) == (scheme == "light")
        opened.close()
    assert brightness["light"] > 200
    assert brightness["dark"] < 60
    assert words["light"] == words["dark"]


def test_print_shows_still_pictures_and_no_controls(browser: Browser, run_page: Path) -> None:
    opened = visit(browser, run_page, "#t=20", color_scheme="dark")
    page = opened.page
    assert not page.locator("#overview").is_visible()
    page.emulate_media(media="print", color_scheme="dark")
    for gone in (".contents", ".filter", "#viewer", "canvas"):
        assert not page.locator(gone).first.is_visible(), gone
    for still in page.locator(".still svg").all():
        assert still.is_visible()
    assert float(np.median(opened.pixels())) > 200, "paper is white"
    pdf = page.pdf(format="A4")
    assert pdf.startswith(b"%PDF")
    assert len(pdf) > 30_000
    opened.close()


def test_a_comparison_is_printed_whole(browser: Browser, spoofed: Pair) -> None:
    opened = visit(browser, spoofed.report)
    opened.page.emulate_media(media="print")
    for drawing in opened.page.locator("figure svg.figure").all():
        assert drawing.is_visible()
    assert opened.page.pdf(format="A4").startswith(b"%PDF")
    opened.close()


def test_without_scripts_the_page_still_has_its_pictures(browser: Browser, run_page: Path) -> None:
    opened = visit_still(browser, run_page)
    assert opened.locator("#overview svg").is_visible()
    assert opened.locator("noscript").inner_text().startswith("With scripts on")
    opened.context.close()


def visit_still(browser: Browser, path: Path) -> Page:
    page = browser.new_context(java_script_enabled=False).new_page()
    page.goto(path.resolve().as_uri())
    return page
