"""Measured speed of aircraft in Gazebo, a collision there, the comparison of its physics, and the figures of them.

`python -m tools.docs.measure_gazebo speed NAME [OPTION…]` runs `python -m tools.agreement gazebo-speed` with these
options, whose results are `docs/data/gazebo/NAME.json`, and draws `docs/images/gazebo-NAME.svg`; the names are `sim`
and `classic`, for the two flavours of Gazebo, and `window`. It takes some five minutes on two quiet cores. `parity`
runs `python -m tools.agreement gazebo-physics`, which renews `docs/explanation/gazebo-parity.md`, in some ten minutes.
`draw` draws all figures again. `tools/docs/generate.py` puts the tables into the reference, and
`tools/docs/photograph_gazebo.py` makes the picture of Gazebo's window. All but `draw` need Gazebo and ArduCopter.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Final

from tools.agreement.gazebo_bench.page import draw

DOCS: Final = Path(__file__).parents[2] / "docs"
DATA: Final = DOCS / "data" / "gazebo"


def measure_speed(name: str, options: list[str]) -> None:
    """Run the benchmark with these options."""
    _run("gazebo-speed", "--output", str(DATA / f"{name}.json"), *options)


def compare_physics() -> None:
    """Run the comparison."""
    _run("gazebo-physics", "--page", str(DOCS / "explanation" / "gazebo-parity.md"))


def draw_all() -> None:
    """Draw the figure of each file of results."""
    for file in sorted(DATA.glob("*.json")):
        draw(json.loads(file.read_text())).save(DOCS / "images" / f"gazebo-{file.stem}.svg")


def _run(*arguments: str) -> None:
    subprocess.run([sys.executable, "-m", "tools.agreement", *arguments], check=True)


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["speed", name, *options]:
            measure_speed(name, options)
        case ["parity"]:
            compare_physics()
        case ["draw"]:
            pass
        case _:
            sys.exit(__doc__)
    draw_all()
