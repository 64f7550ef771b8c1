"""Measured speed of aircraft in Gazebo, a collision there, the comparison of its physics, and the pictures of them.

`python docs/measure_gazebo.py measure` runs `skyrange bench gazebo`, whose results are `docs/data/gazebo.json`, and
`skyrange parity gazebo`, which writes `docs/explanation/gazebo-parity.md`; it takes half an hour on two quiet cores.
`python docs/measure_gazebo.py draw` rewrites the figure `docs/images/gazebo.svg` from the file, as `measure` does too.
`docs/generate.py` puts the tables into the reference, and `docs/photograph_gazebo.py` makes the picture of Gazebo's
window. All but `draw` need Gazebo and ArduCopter.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Final

from skyrange.bench.gazebo_page import draw

ROOT: Final = Path(__file__).parents[1]
DATA: Final = ROOT / "docs" / "data" / "gazebo.json"
PAGE: Final = ROOT / "docs" / "explanation" / "gazebo-parity.md"
IMAGE: Final = ROOT / "docs" / "images" / "gazebo.svg"


def measure(more: list[str]) -> None:
    """Run both commands; `more` are options of the benchmark."""
    for command in (
        ["bench", "gazebo", "--output", str(DATA), *more],
        ["parity", "gazebo", "--page", str(PAGE)],
    ):
        subprocess.run(["skyrange", *command], check=True)  # noqa: S603, S607


if __name__ == "__main__":
    if sys.argv[1:2] == ["measure"]:
        measure(sys.argv[2:])
    draw(json.loads(DATA.read_text())).save(IMAGE)
