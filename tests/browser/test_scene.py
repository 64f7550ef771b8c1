"""The flight in three dimensions: drawn, played, scrubbed, and its aircraft selected, by mouse and by keyboard."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from tests.browser.chromium import WITHOUT_WEBGL, Opened, launched, missing, visit

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from playwright.sync_api import Browser, Playwright

pytestmark = pytest.mark.external(missing=missing())

VIEWPORT = {"width": 1000, "height": 800}
AT_S = 15.0
END_S = 40.7
"""Where the views of the sample end (`test_study_report`)."""


@pytest.fixture
def opened(browser: Browser, run_page: Path) -> Iterator[Opened]:
    """The report of a run, standing at `AT_S`."""
    found = visit(browser, run_page, f"#t={AT_S:g}", viewport=VIEWPORT)
    yield found
    assert found.messages == []
    found.close()


def scene(opened: Opened) -> NDArray[np.int64]:
    """(height, width, 3) values of what the renderer drew, on white, read in the frame in which it was drawn."""
    width, height, values = opened.page.evaluate(
        """() => new Promise((done) => {
          const read = () => {
            const drawn = document.querySelector(".stage canvas"), w = drawn.clientWidth, h = drawn.clientHeight;
            const context = new OffscreenCanvas(w, h).getContext("2d");
            context.fillStyle = "#fff";
            context.fillRect(0, 0, w, h);
            context.drawImage(drawn, 0, 0, w, h);
            const { data } = context.getImageData(0, 0, w, h);
            let out = "";
            for (let k = 0; k < data.length; k += 32768) out += String.fromCharCode(...data.subarray(k, k + 32768));
            done([w, h, btoa(out)]);
          };
          document.getElementById("clock").dispatchEvent(new Event("input"));
          requestAnimationFrame(read);
        })"""
    )
    flat = np.frombuffer(base64.b64decode(values), dtype=np.uint8)
    return flat.reshape(height, width, 4)[:, :, :3].astype(np.int64)


def differ(first: NDArray[np.int64], second: NDArray[np.int64]) -> float:
    """The part of two pictures that is not about the same."""
    return float((np.abs(first - second).max(axis=2) > 30).mean())


def near(pixels: NDArray[np.int64], colour: str, within: int = 40) -> int:
    """How many pixels are about of a colour."""
    wanted = [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
    return int((np.abs(pixels - wanted).max(axis=2) <= within).sum())


def data(opened: Opened) -> dict[str, Any]:
    read: dict[str, Any] = json.loads(opened.page.locator("#run").text_content() or "")
    return read


def spot(opened: Opened, colour: str) -> tuple[float, float]:
    """Where an aircraft's disc lies on the page: the middle of what is wholly of its colour."""
    opened.settle()
    place = opened.page.evaluate(
        """(colour) => {
          const canvas = document.querySelector(".over"), box = canvas.getBoundingClientRect();
          const wanted = [1, 3, 5].map((i) => parseInt(colour.slice(i, i + 2), 16));
          const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d");
          copy.drawImage(canvas, 0, 0);
          const { data, width, height } = copy.getImageData(0, 0, canvas.width, canvas.height);
          const same = (x, y) => [...wanted, 255].every((c, k) => data[(y * width + x) * 4 + k] === c);
          const round = [[0, 0], [3, 0], [-3, 0], [0, 3], [0, -3], [2, 2], [-2, 2], [2, -2], [-2, -2]];
          for (let y = 3; y < height - 3; y++) for (let x = 3; x < width - 3; x++)
            if (round.every(([i, k]) => same(x + i, y + k)))
              return [box.left + x * box.width / width, box.top + y * box.height / height];
          return null;
        }""",
        colour,
    )
    assert place is not None, "the aircraft's disc is not on the picture"
    return place[0], place[1]


def test_the_scene_is_drawn_by_webgl(opened: Opened) -> None:
    page = opened.page
    assert page.evaluate("document.querySelector('.stage canvas').getContext('webgl2') !== null")
    drawn = scene(opened)
    inks = {vehicle["id"]: vehicle["ink"][0] for vehicle in data(opened)["vehicles"]}
    for vehicle, ink in inks.items():
        assert near(drawn, ink) > 50, vehicle
    roofs = near(drawn, "#eef2f7", 3)
    assert roofs > 3000
    page.get_by_role("button", name="Buildings").dispatch_event("click")
    assert near(scene(opened), "#eef2f7", 3) < roofs / 10
    page.get_by_role("button", name="green").dispatch_event("click")
    hidden = scene(opened)
    assert near(hidden, inks["blue/b1"]) > 50
    assert near(hidden, inks["green/g3"], 12) < near(drawn, inks["green/g3"], 12) / 4


def test_without_webgl_the_scene_is_drawn_on_a_plain_canvas(driver: Playwright, run_page: Path) -> None:
    with launched(driver, *WITHOUT_WEBGL) as browser:
        opened = visit(browser, run_page, f"#t={AT_S:g}", viewport=VIEWPORT)
        assert opened.page.evaluate("document.createElement('canvas').getContext('webgl2') === null")
        drawn = scene(opened)
        for vehicle in data(opened)["vehicles"]:
            assert near(drawn, vehicle["ink"][0]) > 50, vehicle["id"]
        assert near(drawn, "#eef2f7", 3) > 3000
        assert [line for line in opened.messages if "WebGL" not in line] == []


def test_views_from_above_and_from_the_side_differ(opened: Opened) -> None:
    pictures = []
    for name in ("3-D", "Top", "Side"):
        opened.page.get_by_role("button", name=name, exact=True).dispatch_event("click")
        pictures.append(scene(opened))
    for first, second in ((0, 1), (0, 2), (1, 2)):
        assert differ(pictures[first], pictures[second]) > 0.02


def test_the_mouse_turns_and_zooms(opened: Opened) -> None:
    page, before = opened.page, scene(opened)
    box = page.locator("#stage").bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 160, y + 20, steps=4)
    page.mouse.up()
    turned = scene(opened)
    assert differ(turned, before) > 0.02
    page.mouse.click(x, y)  # the wheel scrolls the page until the scene is taken up
    page.mouse.wheel(0, 300)
    opened.page.wait_for_timeout(100)
    assert differ(scene(opened), turned) > 0.02
    assert page.evaluate("scrollY") == 0


def test_keys_turn_move_zoom_and_come_home(opened: Opened) -> None:
    page = opened.page
    page.locator(".over").focus()
    page.keyboard.press("Home")
    home = scene(opened)
    for keys in ("ArrowLeft", "ArrowUp", "Shift+ArrowRight", "+"):
        for _ in range(3):
            page.keyboard.press(keys)
        assert differ(scene(opened), home) > 0.01, keys
        page.keyboard.press("Home")
        assert differ(scene(opened), home) < 0.001, keys


def test_the_flight_plays_by_mouse_and_by_key(opened: Opened) -> None:
    page, play = opened.page, opened.page.locator("#play")
    page.locator("#pace").select_option("0.5")
    assert play.get_attribute("aria-label") == "Play"
    starts: tuple[Callable[[], None], ...] = (play.click, lambda: page.keyboard.press(" "))
    for start in starts:
        before = opened.now_s
        start()
        page.wait_for_function("(t) => Number(document.getElementById('clock').value) > t + 0.1", arg=before)
        assert play.get_attribute("aria-label") == "Pause"
        page.locator(".over").focus()
        page.keyboard.press(" ")
        assert play.get_attribute("aria-label") == "Play"
        opened.settle()
        stopped = opened.now_s
        assert before < stopped < END_S
        page.wait_for_timeout(200)
        assert opened.now_s == stopped
    assert page.locator("#now").inner_text() == f"{opened.now_s:.1f} s"


def test_it_plays_when_it_opens_unless_motion_is_unwanted(browser: Browser, run_page: Path) -> None:
    moving = visit(browser, run_page)
    moving.page.wait_for_function("Number(document.getElementById('clock').value) > 0.2")
    assert moving.page.locator("#play").get_attribute("aria-label") == "Pause"
    moving.close()
    still = visit(browser, run_page, reduced_motion="reduce")
    still.page.wait_for_timeout(300)
    assert still.now_s == pytest.approx(END_S, abs=0.5)
    assert still.page.locator("#play").get_attribute("aria-label") == "Play"
    still.close()


def test_what_is_drawn_follows_the_clock(opened: Opened) -> None:
    ink = data(opened)["vehicles"][1]["ink"][0]
    first = spot(opened, ink)
    opened.page.evaluate("location.hash = '#t=11'")
    opened.page.wait_for_function("Number(document.getElementById('clock').value) === 11")
    second = spot(opened, ink)
    assert np.hypot(first[0] - second[0], first[1] - second[1]) > 15


def test_the_clock_is_set_by_mouse(opened: Opened) -> None:
    page = opened.page
    page.locator("#missions").scroll_into_view_if_needed()
    clock = page.locator("#clock").bounding_box()
    assert clock is not None
    page.mouse.click(clock["x"] + clock["width"] / 2, clock["y"] + clock["height"] / 2)
    opened.settle()
    assert opened.now_s == pytest.approx(END_S / 2, abs=1.0)
    page.mouse.move(clock["x"] + clock["width"] / 2, clock["y"] + clock["height"] / 2)
    page.mouse.down()
    page.mouse.move(clock["x"] + clock["width"] - 1, clock["y"] + 4, steps=3)
    page.mouse.up()
    opened.settle()
    assert opened.now_s == pytest.approx(END_S, abs=1.0)
    lanes = page.locator(".lane-marks").nth(1)
    lanes.scroll_into_view_if_needed()
    box = lanes.bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + box["width"] / 4, box["y"] + 24)
    opened.settle()
    assert opened.now_s == pytest.approx(END_S / 4, abs=0.5)


def test_the_clock_is_set_by_key(opened: Opened) -> None:
    page = opened.page
    page.locator("#clock").focus()
    page.keyboard.press("Home")
    opened.settle()
    assert opened.now_s == 0.0
    page.keyboard.press("End")
    opened.settle()
    assert opened.now_s == pytest.approx(END_S, abs=0.5)
    row = page.locator("#events tbody tr").nth(7)
    row.locator("button").focus()
    page.keyboard.press("Enter")
    opened.settle()
    assert opened.now_s == float(row.get_attribute("data-t") or "nan")
    before = opened.now_s
    page.locator("#chart canvas").focus()
    page.keyboard.press("ArrowRight")
    opened.settle()
    assert opened.now_s > before


def test_an_aircraft_is_selected_by_mouse(opened: Opened) -> None:
    page = opened.page
    for index in (1, 4):
        vehicle = data(opened)["vehicles"][index]
        page.mouse.move(*spot(opened, vehicle["ink"][0]))
        opened.settle()
        assert page.locator("#tip b").inner_text() == vehicle["id"]
        assert page.locator("#tip").is_visible()
        rows = page.locator("tr.focus, .lane.focus")
        assert {row.get_attribute("data-v") for row in rows.all()} == {str(index)}
        page.mouse.move(5, 5)
        opened.settle()
        assert not page.locator("#tip").is_visible()
        assert rows.count() == 0


def test_a_row_of_a_table_selects_its_aircraft_in_the_scene(opened: Opened) -> None:
    page = opened.page
    ink = data(opened)["vehicles"][0]["ink"][0]
    before = near(scene(opened), ink, 25)
    page.locator('#missions tr[data-v="0"]').dispatch_event("pointerenter")
    assert near(scene(opened), ink, 25) > 1.2 * before, "its line is wider"


def test_an_aircraft_is_selected_by_key(opened: Opened) -> None:
    page, ids = opened.page, [vehicle["id"] for vehicle in data(opened)["vehicles"]]
    page.locator(".over").focus()
    chosen = []
    for key in ("n", "n", "p", "p"):
        page.keyboard.press(key)
        opened.settle()
        chosen.append(page.locator("#tip b").inner_text())
    assert chosen == [ids[0], ids[1], ids[0], ids[-1]]
    assert page.locator("tr.focus").first.get_attribute("data-v") == str(len(ids) - 1)
    page.keyboard.press("Escape")
    opened.settle()
    assert not page.locator("#tip").is_visible()
    assert page.locator("tr.focus").count() == 0


def test_operators_are_chosen_by_key(opened: Opened) -> None:
    chip = opened.page.get_by_role("button", name="blue")
    chip.focus()
    opened.page.keyboard.press("Enter")
    opened.settle()
    assert chip.get_attribute("aria-pressed") == "false"
    assert opened.page.locator("#plan .line.off").count() > 0
    opened.page.keyboard.press(" ")
    opened.settle()
    assert chip.get_attribute("aria-pressed") == "true"
    assert opened.page.locator("#plan .line.off").count() == 0


def test_every_control_can_be_reached_by_tab(opened: Opened) -> None:
    page, reached = opened.page, set()
    for _ in range(60):
        page.keyboard.press("Tab")
        reached.add(page.evaluate("(document.activeElement.id || document.activeElement.className || '') + ''"))
    assert {"skip", "over", "chip", "play", "clock", "pace"} <= reached


def test_a_table_is_filtered_by_text_and_kind(opened: Opened) -> None:
    bar, rows = opened.page.locator('.filter[data-table="events"]'), opened.page.locator("#events tbody tr")
    total = rows.count()
    bar.locator("input").fill("b1 mode")
    shown = [row for row in rows.all() if row.is_visible()]
    assert 0 < len(shown) < total
    assert all("blue/b1" in row.inner_text() for row in shown)
    assert bar.locator("output").inner_text() == f"{len(shown)} rows"
    bar.locator("input").fill("")
    bar.locator("select").select_option("event.takeoff")
    assert bar.locator("output").inner_text() == "5 rows"


def test_panels_turn_and_the_chart_shows_other_quantities(opened: Opened) -> None:
    page = opened.page
    panel = page.locator(".panel canvas").first
    panel.scroll_into_view_if_needed()
    before = opened.pixels(panel)
    panel.focus()
    page.keyboard.press("ArrowLeft")
    assert differ(opened.pixels(panel), before) > 0.005
    page.get_by_role("button", name="Speed", exact=True).click()
    assert "true speed" in page.locator("#chart figcaption").inner_text()
