"""Pictures of the documentation: figures and screenshots of runs of the shipped scenarios, made by skyrange itself.

`python -m tools.docs.pictures [NAME …]` flies the scenarios (all of them unless named) and rewrites their files in
`docs/images`: `NAME.svg`, and of those in `SCREENSHOTS` a picture of the report in Chromium, as the tests of
`tests/browser` open it. Scenarios with attacks are flown beside their twins.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple

from skyrange import figures
from skyrange.figures.causal_path import draw_causal_path
from skyrange.record import RunRecord
from skyrange.report.pair.page import draw_pair_plan
from skyrange.scenario.shipped import load
from skyrange.study.pairing import pair
from skyrange.study.runs import fly
from skyrange.twins.causal_path import find_causal_path

ROOT: Final = Path(__file__).parents[2]
IMAGES: Final = ROOT / "docs" / "images"

FIGURES: Final[dict[str, Callable[[RunRecord], figures.Figure]]] = {
    "squares": figures.trajectories_3d,
    "city-fleet": figures.plan_view,
    "crossing": figures.overview,
    "head-on": figures.overview,
    "wind": figures.track_deviation,
}
"""The figure that shows each."""

PAIRS: Final = (
    "chain", "falsified-log", "gcs-flood", "gnss-drift", "gnss-pull-off", "hijack", "insider", "jam-then-spoof",
    "jammed-corridor", "mitm-mission", "rid-city", "rid-spoofing", "unsigned-ghost",
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


SCREENSHOTS: Final = {
    "survey": Screenshot("survey.png", "#t=60", 1100, 1120),
    "rid-spoofing": Screenshot("comparison.png", "", 1200, 1380),
}


def main(names: list[str]) -> None:
    """Fly and draw."""
    for name in names or sorted({*FIGURES, *PAIRS, *SCREENSHOTS}):
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
    if name in SCREENSHOTS:
        made.append(photograph(folder / "report.html", SCREENSHOTS[name]))
    return made


def photograph(report: Path, wanted: Screenshot) -> Path:
    """A picture of the upper part of a report."""
    sys.path.insert(0, str(ROOT))  # the tests are not installed
    from tests.browser import chromium

    if reason := chromium.missing():
        raise SystemExit(f"{wanted.name}: {reason}")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver, chromium.launched(driver) as browser:
        size = {"width": wanted.width, "height": wanted.height}
        opened = chromium.visit(browser, report, wanted.at, viewport=size, color_scheme="light")
        opened.settle()
        opened.page.screenshot(path=IMAGES / wanted.name)
        opened.close()
    return IMAGES / wanted.name


if __name__ == "__main__":
    main(sys.argv[1:])
