"""Report of a comparison of variants as one HTML file, whose columns lead to the reports of the runs."""

from __future__ import annotations

from pathlib import Path

from skyrange.core.files import atomic_write
from skyrange.report.rendering import asset, content_policy, render
from skyrange.study.variants.figure import draw_delays
from skyrange.study.variants.flights import Comparison
from skyrange.study.variants.sections import make_tables

REPORT = "report.html"
FIGURE = "delays.svg"


def write_comparison_report(result: Comparison) -> Path:
    """Write `report.html`, and `delays.svg` if there are delays, into the folder; returns the report."""
    figure = draw_delays(result)
    if figure is not None:
        figure.save(result.path / FIGURE)
    style = asset("style.css")
    page = render(
        "variants/page.html.jinja",
        policy=content_policy(style),
        title=f"{result.name} · variants · skyrange",
        style=style,
        name=result.name,
        failed=result.failed_missions,
        seeds=len(result.seeds),
        variants=[
            (variant, ", ".join(changes), [(seed, result.folder(variant, seed)) for seed in result.seeds])
            for variant, changes in result.changes.items()
        ],
        figure=figure,
        tables=make_tables(result),
    )
    with atomic_write(result.path / REPORT) as file:
        file.write(str(page).encode())
    return result.path / REPORT
