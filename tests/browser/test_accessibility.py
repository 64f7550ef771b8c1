"""Pages without a mouse, without motion, by touch and on paper, and by the rules of WCAG that axe-core checks."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from skyrange.study.matrix.page import write_matrix_report
from skyrange.twins.pair_folder import Pair
from skyrange.view.folders import encode_folder
from skyrange.view.server import RecordedStream, make_application, serve_beside
from tests.browser.axe import find_violations, missing_axe
from tests.browser.chromium import Opened, missing, visit
from tests.flights import shared_pair
from tests.unit.matrix_sample import make_matrix

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = pytest.mark.external(missing=missing())

Point = tuple[float, float]
PHONE = {"width": 390, "height": 800}
SELECTED = "#t=50&select=green/g1"


@pytest.fixture(scope="module")
def pair() -> Pair:
    return shared_pair("rid-spoofing", "duration_s=75")


@pytest.fixture(scope="module")
def address(pair: Pair) -> Iterator[str]:
    """The address of the viewer's page."""
    with serve_beside(make_application(RecordedStream(encode_folder(pair.path))), "127.0.0.1", 0) as url:
        yield url


@contextmanager
def shown(browser: Browser, path: Path | str, at: str = "#t=50", **context: Any) -> Iterator[Opened]:
    """A page whose flights have been read."""
    opened = visit(browser, path, at, **context)
    for _ in range(100):
        slider = opened.page.get_by_role("slider", name="Time")
        if slider.count() and float(slider.input_value()) == 50.0:
            break
        opened.page.wait_for_timeout(200)
    opened.page.wait_for_timeout(300)
    yield opened
    assert opened.messages == []
    opened.close()


def focused(opened: Opened) -> str:
    """The name of what has the focus, "" if nothing has."""
    name: str = opened.page.evaluate(
        """() => {
          const one = document.activeElement;
          if (one === document.body) return "";
          return one.getAttribute("aria-label") || one.labels?.[0]?.textContent.trim() || one.textContent.trim();
        }"""
    )
    return name


def drag(page: Page, *ways: tuple[Point, Point]) -> None:
    """Move a finger from a point to another for each of `ways`, all together."""
    touch = page.context.new_cdp_session(page)

    def dispatch(kind: str, *points: Point) -> None:
        fingers = [{"x": x, "y": y, "id": k} for k, (x, y) in enumerate(points)]
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": fingers})

    dispatch("touchStart", *(start for start, _ in ways))
    for part in np.linspace(0.1, 1.0, 10):
        dispatch("touchMove", *((a + (c - a) * part, b + (d - b) * part) for (a, b), (c, d) in ways))
    dispatch("touchEnd")


def camera(opened: Opened) -> str:
    """The camera of the page's address, as it stands a moment later."""
    opened.page.wait_for_timeout(700)
    address: str = opened.page.evaluate("location.hash")
    return address.partition("camera=")[2]


@pytest.mark.skipif(missing_axe() != "", reason=missing_axe())
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_pages_break_no_rule_of_wcag(
    browser: Browser, scheme: str, pair: Pair, address: str, run_page: Path, drifted: Pair, tmp_path: Path
) -> None:
    matrix = write_matrix_report(make_matrix(tmp_path))
    pages: list[tuple[Path | str, str]] = [
        (address, "#t=50"), (address, SELECTED), (pair.report, SELECTED), (run_page, ""),
        (drifted.report, ""), (matrix, ""),
    ]  # fmt: skip
    for path, at in pages:
        opened = visit(browser, path, at, color_scheme=scheme)
        opened.page.wait_for_timeout(1500)
        assert find_violations(opened) == [], (path, at)
        opened.close()


@pytest.mark.skipif(missing_axe() != "", reason=missing_axe())
def test_a_broken_rule_is_found(browser: Browser, address: str) -> None:
    with shown(browser, address) as opened:
        opened.page.evaluate(
            "() => { const pale = document.querySelector('.sky-verdict'); pale.style.color = '#ccc';"
            " document.querySelector('.sky-slider').removeAttribute('aria-label'); }"
        )
        found = find_violations(opened)
        assert any(line.startswith("color-contrast") for line in found)
        assert any(line.startswith("label") for line in found)


def test_everything_is_reached_and_used_by_keys(browser: Browser, address: str) -> None:
    with shown(browser, address) as opened:
        page = opened.page
        names = []
        for _ in range(40):
            page.keyboard.press("Tab")
            names.append(focused(opened))
            if not names[-1]:  # past the last one
                break
            outline = page.evaluate("() => getComputedStyle(document.activeElement).outlineStyle")
            assert outline != "none", names[-1]
        wanted = [
            "attacked", "green 1", "Flights in three dimensions", "3-D", "Top", "Beliefs", "Names",
            "Find an aircraft", "green/g1", "Event before (,)", "Play", "Time", "Speed", "Decisions",
        ]  # fmt: skip
        places = [next(k for k, name in enumerate(names) if name.startswith(one)) for one in wanted]
        assert places == sorted(places)

        # an aircraft of the list, by its button; the focus stays in the panel, and Escape comes back to the list
        page.get_by_label("Find an aircraft").focus()
        page.keyboard.type("green")
        page.keyboard.press("Tab")
        assert focused(opened) == "green/g1"
        page.keyboard.press("Enter")
        page.wait_for_timeout(300)
        assert page.get_by_role("heading", name="green/g1").is_visible()
        assert focused(opened) == "Let go of it (escape)"
        page.keyboard.press("Escape")
        page.wait_for_timeout(300)
        assert focused(opened) == "Find an aircraft"

        # the slider by arrows, the clock by the space bar
        slider = page.get_by_role("slider", name="Time")
        slider.focus()
        page.keyboard.press("ArrowRight")
        page.keyboard.press("ArrowRight")
        assert float(slider.input_value()) == pytest.approx(50.2)
        page.keyboard.press(" ")
        page.get_by_role("button", name="Pause").wait_for()
        page.keyboard.press(" ")
        page.get_by_role("button", name="Play").wait_for()

        # the stage: arrows turn, plus zooms, n chooses, f shows all again
        page.locator(".sky-stage").focus()
        assert camera(opened) == ""
        page.keyboard.press("ArrowLeft")
        turned = camera(opened)
        page.keyboard.press("+")
        assert turned != camera(opened) != ""
        page.keyboard.press("f")
        assert camera(opened) == ""
        page.keyboard.press("n")
        page.wait_for_timeout(300)
        assert page.locator(".sky-panel .sky-name:visible").inner_text() == "green/g1"

        # a lane of the timeline: to the next event
        before = float(slider.input_value())
        page.locator(".sky-lane-marks[aria-label^=Decisions]").focus()
        page.keyboard.press("ArrowRight")
        opened.settle()
        assert float(slider.input_value()) > before


def test_without_motion_the_clock_goes_in_steps(browser: Browser, address: str) -> None:
    times: dict[str, list[float]] = {}
    for motion in ("reduce", "no-preference"):
        with shown(browser, address, reduced_motion=motion) as opened:
            page = opened.page
            page.get_by_role("button", name="Play").click()
            slider = page.get_by_role("slider", name="Time")
            times[motion] = page.evaluate(
                """() => new Promise((done) => {
                  const slider = document.querySelector(".sky-slider"), seen = new Set(), began = performance.now();
                  const look = () => {
                    seen.add(Number(slider.value));
                    performance.now() - began < 4500 ? requestAnimationFrame(look) : done([...seen]);
                  };
                  look();
                })"""
            )
            page.get_by_role("button", name="Pause").click()
            assert 51.0 < float(slider.input_value()) < 58.0
            moving = page.evaluate(
                """() => [...document.querySelectorAll(".sky-viewer *")]
                  .filter((one) => getComputedStyle(one).transitionDuration !== "0s").length"""
            )
            assert (moving == 0) == (motion == "reduce")
    steps = np.diff(times["reduce"])
    assert len(steps) >= 2
    assert np.all(steps >= 0.9)
    assert np.median(np.diff(times["no-preference"])) < 0.5


def test_on_paper_it_is_a_still_with_a_note(browser: Browser, pair: Pair, address: str, tmp_path: Path) -> None:
    for path in (address, pair.report):
        with shown(browser, path, SELECTED, color_scheme="dark") as opened:
            page = opened.page
            page.emulate_media(media="print", color_scheme="dark")
            page.wait_for_timeout(500)
            assert page.get_by_text("A still at 0:50.0 of 1:15").is_visible()
            for gone in (".sky-picture", ".sky-tools", ".sky-slider", ".sky-play", ".sky-hint"):
                assert not page.locator(gone).first.is_visible(), gone
            still = opened.pixels(page.locator(".sky-still"))
            assert len(np.unique(still.reshape(-1, 3), axis=0)) > 500
            assert np.median(still) > 180, "paper is light"
            page.emulate_media(media="screen", color_scheme="dark")
            page.wait_for_timeout(500)
            assert np.median(opened.pixels(page.locator(".sky-stage"))) < 80
            assert page.pdf(format="A4").startswith(b"%PDF")


def test_a_wheel_over_the_stage_of_a_report_scrolls_the_page_until_it_is_clicked(browser: Browser, pair: Pair) -> None:
    with shown(browser, pair.report) as opened:
        page = opened.page
        page.locator(".sky-stage").scroll_into_view_if_needed()
        box = page.locator(".sky-stage").bounding_box()
        assert box is not None
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + 200)
        page.mouse.wheel(0, 300)
        page.wait_for_timeout(400)
        scrolled = page.evaluate("scrollY")
        assert scrolled > 100
        assert camera(opened) == ""
        page.keyboard.down("Control")
        page.mouse.wheel(0, -100)
        page.keyboard.up("Control")
        by_ctrl = camera(opened)
        assert by_ctrl != ""
        page.mouse.wheel(0, -100)
        page.wait_for_timeout(400)
        assert page.evaluate("scrollY") == pytest.approx(scrolled - 100, abs=2)
        assert camera(opened) == by_ctrl
        page.mouse.click(box["x"] + 30, box["y"] + 150)
        scrolled = page.evaluate("scrollY")
        page.mouse.wheel(0, -100)
        assert camera(opened) != by_ctrl
        assert page.evaluate("scrollY") == scrolled


def test_fingers_turn_zoom_and_choose(browser: Browser, address: str) -> None:
    with shown(browser, address, has_touch=True) as opened:
        page = opened.page
        drag(page, ((400, 400), (500, 400)))
        turned = [float(value) for value in camera(opened).split(",")]
        assert turned[0] != pytest.approx(-0.62, abs=0.1)
        drag(page, ((380, 400), (300, 400)), ((480, 400), (560, 400)))
        nearer = [float(value) for value in camera(opened).split(",")]
        assert nearer[0] == pytest.approx(turned[0], abs=0.01)
        assert nearer[2] < turned[2] * 0.7
        assert page.evaluate("visualViewport.scale") == 1
        page.get_by_text("green/g1", exact=True).first.tap()
        page.wait_for_timeout(500)
        assert page.get_by_role("heading", name="green/g1").is_visible()


def test_a_finger_scrolls_a_report_over_its_stage(browser: Browser, pair: Pair) -> None:
    with shown(browser, pair.report, has_touch=True, is_mobile=True, viewport=PHONE) as opened:
        page = opened.page
        page.locator(".sky-stage").scroll_into_view_if_needed()
        assert page.evaluate("getComputedStyle(document.querySelector('.sky-stage')).touchAction") == "pan-y"
        box = page.locator(".sky-stage").bounding_box()
        assert box is not None
        before = page.evaluate("scrollY")
        drag(page, ((box["x"] + 150, box["y"] + 250), (box["x"] + 152, box["y"] + 50)))
        assert page.evaluate("scrollY") > before + 100
        assert camera(opened) == ""
