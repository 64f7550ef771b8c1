"""Pictures of the documentation: figures and screenshots of runs of the shipped scenarios, made by skyrange itself.

`python -m tools.docs.pictures [NAME …]` flies the scenarios (all of them unless named) and rewrites their files in
`docs/images`: `NAME.svg`, and in Chromium, as the tests of `tests/browser` open pages, a picture of the report of those
in `SCREENSHOTS` and pictures of the viewer of those in `VIEWS`. Scenarios with attacks are flown beside their twins.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from skyrange import figures
from skyrange.figures.causal_path import draw_causal_path
from skyrange.record import RunRecord
from skyrange.report.pair.page import draw_pair_plan
from skyrange.scenario.shipped import load
from skyrange.study.pairing import pair
from skyrange.study.runs import fly
from skyrange.twins.causal_path import find_causal_path
from skyrange.view.folders import encode_folder
from skyrange.view.server import RecordedStream, make_application, serve_beside

if TYPE_CHECKING:
    from playwright.sync_api import Browser

ROOT: Final = Path(__file__).parents[2]
IMAGES: Final = ROOT / "docs" / "images"
DRAWN_MS: Final = 3000
"""Wait until a page has read and drawn its flights."""

FIGURES: Final[dict[str, Callable[[RunRecord], figures.Figure]]] = {
    "squares": figures.trajectories_3d,
    "city-fleet": figures.plan_view,
    "crossing": figures.overview,
    "head-on": figures.overview,
    "wind": figures.track_deviation,
}
"""The figure that shows each."""

PAIRS: Final = (
    "chain", "emergency-landing", "falsified-log", "gcs-flood", "gnss-drift", "gnss-pull-off", "hijack", "insider",
    "jam-then-spoof", "jammed-corridor", "mitm-mission", "rid-city", "rid-spoofing", "unsigned-ghost",
)  # fmt: skip
"""Of these both flights are drawn."""

CAUSAL_PATHS: Final = ("chain",)
"""Of these the causal path is drawn as well, as `NAME-path.svg`."""


class Screenshot(NamedTuple):
    """A file's name, the moment that the page opens at as its address's fragment, and pixels."""

    name: str
    at: str
    width: int
    height: int
    scheme: str = "light"


SCREENSHOTS: Final = {
    "survey": Screenshot("survey.png", "#t=60", 1280, 800),
    "rid-spoofing": Screenshot("comparison.png", "#t=72.05", 1200, 1120),
}

VIEWS: Final = {
    "rid-spoofing": (
        Screenshot("viewer.png", "#t=72.05&camera=-0.9,0.85,190,14,50,25", 1280, 800),
        Screenshot("viewer-selected.png", "#t=80.05&select=green/g1&camera=0.35,0.8,200,15,60,25", 1280, 800, "dark"),
    ),
}
"""Pictures of the viewer by scenario."""


def main(names: list[str]) -> None:
    """Fly and draw."""
    for name in names or sorted({*FIGURES, *PAIRS, *SCREENSHOTS, *VIEWS}):
        with tempfile.TemporaryDirectory() as folder:
            for path in draw(name, Path(folder) / name):
                print(path)


def draw(name: str, folder: Path) -> list[Path]:
    """The pictures of a scenario that is flown into `folder`."""
    made = []
    if name in PAIRS:
        flown = pair(load(name), folder)
        made.append(draw_pair_plan(flown).save(IMAGES / f"{name}.svg"))
        if name in CAUSAL_PATHS:
            path = find_causal_path(flown.run("attacked"), flown.propagation.to_pylist())
            made.append(draw_causal_path(path).save(IMAGES / f"{name}-path.svg"))
    else:
        record = fly(load(name), folder)
        if name in FIGURES:
            made.append(FIGURES[name](record).save(IMAGES / f"{name}.svg"))
    if name in SCREENSHOTS or name in VIEWS:
        with _browser(name) as browser:
            if name in SCREENSHOTS:
                made.append(photograph(browser, (folder / "report.html").resolve().as_uri(), SCREENSHOTS[name]))
            for wanted in VIEWS.get(name, ()):
                served = make_application(RecordedStream(encode_folder(folder)))
                with serve_beside(served, "127.0.0.1", 0) as address:
                    made.append(photograph(browser, address, wanted))
    return made


@contextmanager
def _browser(name: str) -> Iterator[Browser]:
    """Chromium, or an exit with the reason why `name` cannot be photographed."""
    chromium = _chromium()
    if reason := chromium.missing():
        raise SystemExit(f"{name}: {reason}")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver, chromium.launched(driver) as browser:
        yield browser


def photograph(browser: Browser, address: str, wanted: Screenshot) -> Path:
    """A picture of the upper part of a page, a moment after it has opened."""
    size = {"width": wanted.width, "height": wanted.height}
    opened = _chromium().visit(browser, address, wanted.at, viewport=size, color_scheme=wanted.scheme)
    opened.page.wait_for_timeout(DRAWN_MS)
    opened.settle()
    opened.page.screenshot(path=IMAGES / wanted.name)
    opened.close()
    return IMAGES / wanted.name


def _chromium() -> Any:
    """The module of the tests that opens pages; the tests are not installed."""
    sys.path.insert(0, str(ROOT))
    from tests.browser import chromium

    return chromium


if __name__ == "__main__":
    main(sys.argv[1:])
