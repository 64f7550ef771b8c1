"""Processor time of a frame of the viewer: a made fleet over a city, drawn in software by headless Chromium.

`python -m tools.viewer_frames` measures 1,000 aircraft over a made city of 1,296 buildings at 1280 x 720, with all
processes of the browser: the city, the aircraft and their trails first, then with names and airspace, then with all
that the viewer shows. `--buildings FILE` reads a city instead. `--page FILE` also measures another page, in turn; it
has to define `ready` when it is, and `frame(k)`, which draws frame k and waits for it.
"""

from __future__ import annotations

import os
import statistics
from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Final

import typer
from playwright.sync_api import Page, sync_playwright

from skyrange.city.building_files import load_buildings
from skyrange.view.server import RecordedStream, make_application, serve_beside
from tests.browser import chromium
from tools.viewer_fleet import encode_fleet, make_city, make_flights

SIZE: Final = {"width": 1280, "height": 720}
SECONDS: Final = 120.0
LAYERS: Final[Mapping[str, tuple[str, ...]]] = {
    "city, aircraft, trails": ("buildings", "trails"),
    "and names, airspace": ("buildings", "trails", "names", "volumes"),
    "and all else": ("buildings", "trails", "names", "volumes", "belief", "station", "claims", "radio", "plans"),
}
"""What is measured, by what the viewer draws."""

COUNTER: Final = """
window.drawn = 0;
for (const name of ["drawArrays", "drawElements", "drawArraysInstanced", "drawElementsInstanced"]) {
  const draw = WebGL2RenderingContext.prototype[name];
  WebGL2RenderingContext.prototype[name] = function (...given) { window.drawn++; return draw.apply(this, given); };
}
"""
PREPARE: Final = """(layers) => {
  const { store, camera } = window.skyrangeViewer, view = document.querySelector(".sky-view").style;
  Object.assign(view, { position: "fixed", inset: "0", zIndex: "99", borderRadius: "0" });
  Object.assign(document.querySelector(".sky-hint").style, { display: "none" });
  for (const name of Object.keys(store.view.layers)) store.view.layers[name] = layers.includes(name);
  store.view.everyone = layers.includes("belief");
  camera.read("-0.6,0.576,1193,0,0,0");
  store.changed("data");
}"""
DRAW_VIEWER: Final = """async ([first, count]) => {
  const { store, camera } = window.skyrangeViewer, gl = document.querySelector(".sky-picture").getContext("webgl2");
  const pixel = new Uint8Array(4), shown = () => new Promise((done) => requestAnimationFrame(done));
  window.drawn = 0;
  for (let k = first; k < first + count; k++) {
    store.view.time = 40 + (k % 700) * 0.1;
    camera.turn(0.02, 0);
    store.tell();
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    await shown();
    await shown();
  }
  return window.drawn / count;
}"""
DRAW_OTHER: Final = """async ([first, count]) => {
  const shown = () => new Promise((done) => requestAnimationFrame(done));
  window.drawn = 0;
  for (let k = first; k < first + count; k++) {
    window.frame(k % 700);
    await shown();
    await shown();
  }
  return window.drawn / count;
}"""


@dataclass
class Measured:
    """One page as it is measured: its milliseconds of processor time a frame in each round, and its draw calls."""

    name: str
    page: Page
    draw: str
    layers: tuple[str, ...] = ()
    cpu_ms: list[float] = field(default_factory=list)
    calls: float = 0.0
    frames: int = 0

    def measure(self, count: int) -> None:
        """Draw some frames."""
        if self.layers:
            self.page.evaluate(PREPARE, list(self.layers))
        self.page.bring_to_front()
        self.page.evaluate(self.draw, [self.frames, 2])
        before = read_children_s()
        self.calls = float(self.page.evaluate(self.draw, [self.frames + 2, count]))
        self.cpu_ms.append((read_children_s() - before) / count * 1000)
        self.frames += count + 2


def read_children_s() -> float:
    """Seconds of processor time of all living processes that this one started, and that those did."""
    children: dict[int, list[tuple[int, float]]] = defaultdict(list)
    for pid, parent, spent_s in _list_processes():
        children[parent].append((pid, spent_s))
    total, left = 0.0, [os.getpid()]
    while left:
        for pid, spent_s in children[left.pop()]:
            total += spent_s
            left.append(pid)
    return total


def _list_processes() -> Iterator[tuple[int, int, float]]:
    ticks = os.sysconf("SC_CLK_TCK")
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            text = path.read_text()
        except OSError:  # it has ended
            continue
        fields = text[text.rindex(")") + 2 :].split()
        yield int(path.parent.name), int(fields[1]), (int(fields[11]) + int(fields[12])) / ticks


def _open(browser: Any, address: str, ready: str) -> Page:
    page: Page = chromium.visit(browser, address, viewport=SIZE, color_scheme="light", script=COUNTER).page
    for _ in range(600):
        if page.evaluate(ready):
            return page
        page.wait_for_timeout(200)
    raise SystemExit(f"{address}: did not load within two minutes")


def main(
    aircraft: Annotated[int, typer.Option(help="Number of aircraft.")] = 1000,
    buildings: Annotated[Path | None, typer.Option(help="Buildings, as a scenario's `file`.")] = None,
    page: Annotated[Path | None, typer.Option(help="Another page to compare with.")] = None,
    frames: Annotated[int, typer.Option(help="Frames of a page in each round.")] = 20,
    rounds: Annotated[int, typer.Option(help="How often each page takes its turn.")] = 5,
    picture: Annotated[Path | None, typer.Option(help="Folder for a picture of each page.")] = None,
) -> None:
    """Measure, and print the medians with the least and the most."""
    city = load_buildings(buildings)[0] if buildings else make_city()
    stream = encode_fleet(make_flights(aircraft, city, SECONDS), city)
    print(f"{aircraft} aircraft, {len(city.buildings)} buildings, {len(stream) / 1e6:.2f} MB of stream")
    with ExitStack() as stack:
        browser = stack.enter_context(chromium.launched(stack.enter_context(sync_playwright())))
        served = make_application(RecordedStream(stream))
        url = stack.enter_context(serve_beside(served, "127.0.0.1", 0))
        viewer = _open(browser, url, f"() => window.skyrangeViewer?.store.newest >= {SECONDS}")
        measured = [Measured(name, viewer, DRAW_VIEWER, layers) for name, layers in LAYERS.items()]
        if page:
            measured.append(
                Measured(page.name, _open(browser, page.resolve().as_uri(), "() => window.ready"), DRAW_OTHER)
            )
        for _ in range(rounds):
            for one in measured:
                one.measure(frames)
                if picture:
                    one.page.screenshot(path=picture / f"{one.name.replace(' ', '-').replace(',', '')}.png")
    for one in measured:
        ratios = [mine / other for mine, other in zip(one.cpu_ms, measured[-1].cpu_ms, strict=True)]
        beside = f", {statistics.median(ratios):.2f} of {page.name}" if page else ""
        low, middle, high = min(one.cpu_ms), statistics.median(one.cpu_ms), max(one.cpu_ms)
        print(f"{one.name}: {middle:.0f} CPU-ms a frame ({low:.0f} to {high:.0f}), {one.calls:.0f} draw calls{beside}")


if __name__ == "__main__":
    typer.run(main)
