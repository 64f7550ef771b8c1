"""Where do the pictures of the shipped scenarios come from? From a run of each, drawn by skyrange itself.

`python docs/pictures.py [NAME …]` flies the scenarios (all of them unless named) and rewrites `docs/images/NAME.svg`;
those with attacks it flies beside their twins.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from skyrange.record import RunRecord
from skyrange.scenario.catalogue import load
from skyrange.study import figures
from skyrange.study.pairing import pair
from skyrange.study.report.comparison import draw_pair_plan
from skyrange.study.session import fly

IMAGES = Path(__file__).parent / "images"

PICTURES: dict[str, Callable[[RunRecord], figures.Figure]] = {
    "squares": figures.trajectories_3d,
    "city-fleet": figures.plan_view,
    "crossing": figures.overview,
    "head-on": figures.overview,
    "wind": figures.track_deviation,
}
"""What is drawn of each; `survey` has a picture of its report instead."""
PAIRS = ("gnss-drift", "rid-city", "rid-spoofing")
"""Of these both flights are drawn."""


def main(names: list[str]) -> None:
    """Fly and draw."""
    for name in names or [*PICTURES, *PAIRS]:
        with tempfile.TemporaryDirectory() as folder:
            if name in PAIRS:
                print(draw_pair_plan(pair(load(name), Path(folder) / "pair")).save(IMAGES / f"{name}.svg"))
                continue
            record = fly(load(name), Path(folder) / "run", report=False)
            print(PICTURES[name](record).save(IMAGES / f"{name}.svg"))


if __name__ == "__main__":
    main(sys.argv[1:])
