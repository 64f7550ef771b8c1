"""`python -m tools.detection_range`: at which distance sensors see another aircraft, and what avoidance needs.

It prints the tables of docs/explanation/detection-range.md, or renews them and the figure.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import typer

from skyrange.cli.output.console import print_text
from tools.detection_range.page import PART, draw, run_study, write_lines

FIGURE: Final = "detection-range.svg"


def main(
    *,
    trials: Annotated[int, typer.Option(metavar="N", min=20, help="Trials of each encounter.")] = 200,
    page: Annotated[Path | None, typer.Option(metavar="FILE", help="Renew the tables of this page.")] = None,
    images: Annotated[Path | None, typer.Option(metavar="DIR", help="Write the figure to this folder.")] = None,
) -> None:
    """Measure detection ranges; a hundred trials take two minutes."""
    if page is not None:
        PART.read(page)
    study = run_study(trials)
    lines = write_lines(study)
    if page is not None:
        PART.write(page, lines)
    if images is not None:
        draw(study).save(images / FIGURE)
    for line in lines:
        print_text(line)


if __name__ == "__main__":
    typer.run(main)
