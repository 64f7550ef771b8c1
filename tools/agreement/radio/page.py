"""Results of a comparison of radio engines as files: tables in Markdown, figures, and JSON."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final
from xml.etree.ElementTree import Element

import numpy as np

from skyrange.core.errors import InputError
from skyrange.core.files import MIB, atomic_write, read_input
from skyrange.figures import svg
from skyrange.figures.palette import OKABE_ITO
from skyrange.figures.svg import Figure
from tools.agreement.radio.agreement import PARTIAL, WITHIN, Comparison
from tools.agreement.radio.own_losses import Residual, residuals
from tools.agreement.radio.setups import BUILTIN, EngineSetup

BEGIN: Final = "<!-- python -m tools.agreement radio: begin -->"
END: Final = "<!-- python -m tools.agreement radio: end -->"
SHARES_SVG: Final = "radio-parity-shares.svg"
LOSSES_SVG: Final = "radio-parity-losses.svg"
_WORST: Final = 2
_BLOCK: Final = re.compile(f"{re.escape(BEGIN)}.*?{re.escape(END)}", re.DOTALL)


def tables(comparison: Comparison, pictures: str = "") -> Iterator[str]:
    """The lines of the tables. With `pictures`, the folder of the figures as links name it, links to both."""
    yield from _agreement(comparison)
    if pictures:
        yield f"![Share of frames that the engines decode, over the builtin's]({pictures}/{SHARES_SVG})"
        yield ""
    yield from _swaps(comparison)
    yield from _worst(comparison)
    yield from _losses(comparison)
    if pictures and comparison.losses is not None and comparison.losses.other_db:
        yield f"![Path losses of the engines' own models minus skyrange's]({pictures}/{LOSSES_SVG})"
        yield ""


def _share(good: int, all_: int) -> str:
    return f"{good} of {all_} ({good / all_:.0%})" if all_ else "none counts"


def _agreement(comparison: Comparison) -> Iterator[str]:
    low, high = (f"{bound:.0%}" for bound in PARTIAL)
    yield f"Cells in which either engine decodes {low} to {high}, and those of them that agree within {WITHIN:.0%}:"
    yield ""
    yield "| engine | " + " | ".join(comparison.experiments) + " | all |"
    yield "|---|" + "---|" * (len(comparison.experiments) + 1)
    for engine in comparison.engines:
        title = EngineSetup(engine).title
        several = dict.fromkeys(" and ".join(swap.models) for swap in comparison.swaps[engine] if len(swap.models) > 1)
        lines = {
            f"{title}, defaults": [comparison.agreeing(name, title) for name in comparison.experiments],
            f"{title}, or one model swapped": [
                comparison.explained(name, engine, 1) for name in comparison.experiments
            ],
        }
        if several:
            label = f"{title}, or several models swapped ({'; '.join(several)})"
            lines[label] = [comparison.explained(name, engine) for name in comparison.experiments]
        for label, counts in lines.items():
            total = sum(good for good, _ in counts), sum(count for _, count in counts)
            yield f"| {label} | " + " | ".join(_share(*pair) for pair in (*counts, total)) + " |"
    yield ""


def _swaps(comparison: Comparison) -> Iterator[str]:
    for engine in comparison.engines:
        swaps = comparison.swaps[engine]
        if not swaps:
            continue
        yield f"Gaps of {EngineSetup(engine).title}'s defaults that are closed by swapping models:"
        yield ""
        yield "| swapped | how | " + " | ".join(comparison.experiments) + " |"
        yield "|---|---|" + "---|" * len(comparison.experiments)
        for swap in swaps:
            counts = [comparison.closed(name, swap) for name in comparison.experiments]
            cells = " | ".join(f"{good} of {gaps}" for good, gaps in counts)
            yield f"| {', '.join(swap.models)} | {swap.text} | {cells} |"
        yield ""


def _worst(comparison: Comparison) -> Iterator[str]:
    """The largest differences, with the best swap of each."""
    for engine in comparison.engines:
        title = EngineSetup(engine).title
        yield f"Largest differences between {title} and the builtin:"
        yield ""
        yield f"| experiment | cell | builtin | {title} | best swap |"
        yield "|---|---|---|---|---|"
        for experiment in comparison.experiments:
            rows = comparison.select(experiment, title)
            order = np.argsort(-np.abs(comparison.differences(rows, title)), kind="stable")
            for row in rows[order][:_WORST].tolist():
                mine = comparison.shares[BUILTIN.title][row]
                facts = ", ".join(f"{name} {value}" for name, value in comparison.cells[row][1].items())
                theirs = comparison.shares[title][row]
                swap = _best(comparison, engine, row)
                yield f"| {experiment} | {facts} | {mine:.3f} | {theirs:.3f} | {swap} |"
        yield ""


def _best(comparison: Comparison, engine: str, row: int) -> str:
    """The best swap of a cell and the share of the engine with it, or both shares if the builtin differs too."""
    swap = comparison.best(row, engine)
    if swap is None:
        return ""
    text = f"{swap.text}: {comparison.shares[swap.setup.title][row]:.3f}"
    return f"{text}, builtin {comparison.shares[swap.builtin.title][row]:.3f}" if swap.builtin.changes else text


def _losses(comparison: Comparison) -> Iterator[str]:
    pairs = comparison.losses
    if pairs is None or not pairs.other_db:
        return
    count = f"{len(pairs.ends_m):,}"
    yield f"Loss of each model minus skyrange's in dB over {count} pairs: median (10th to 90th percentile)."
    yield ""
    models = {title: residuals(pairs, title) for title in pairs.other_db}
    yield "| heights | sight | pairs | " + " | ".join(models) + " |"
    yield "|---|---|---|" + "---|" * len(models)
    keys = list(dict.fromkeys(key for cells in models.values() for key in cells))
    for heights, sight in keys:
        texts: list[str] = []
        number = 0
        for cells in models.values():
            if (heights, sight) not in cells:
                texts.append("")
                continue
            cell = cells[(heights, sight)]
            number = max(number, cell.pairs)
            missing = f"; none for {cell.missing}" if cell.missing else ""
            texts.append(f"{cell.median_db:+.1f} ({cell.low_db:+.1f} to {cell.high_db:+.1f}{missing})")
        yield f"| {heights} | {'yes' if sight else 'no'} | {number} | " + " | ".join(texts) + " |"
    yield ""


def results(comparison: Comparison) -> dict[str, Any]:
    """All shares and residuals as plain data."""
    cells = []
    for row, (experiment, facts) in enumerate(comparison.cells):
        shares = {title: values[row] for title, values in comparison.shares.items() if np.isfinite(values[row])}
        cells.append({"experiment": experiment, **facts, "frames": comparison.frames[row], "decoded": shares})
    agreement = {
        EngineSetup(engine).title: {
            name: dict(
                zip(
                    ("agree", "count", "or_one_model_swapped", "or_several_models_swapped"),
                    (
                        *comparison.agreeing(name, EngineSetup(engine).title),
                        comparison.explained(name, engine, 1)[0],
                        comparison.explained(name, engine)[0],
                    ),
                    strict=True,
                )
            )
            for name in comparison.experiments
        }
        for engine in comparison.engines
    }
    swaps = {
        EngineSetup(engine).title: [
            {
                "models": list(swap.models), "how": swap.text,
                "closed": {name: comparison.closed(name, swap)[0] for name in comparison.experiments},
            }
            for swap in comparison.swaps[engine]
        ]
        for engine in comparison.engines
    }  # fmt: skip
    losses = {}
    if comparison.losses is not None:
        losses = {
            title: [
                {"heights": heights, "sight": sight, **residual._asdict()}
                for (heights, sight), residual in residuals(comparison.losses, title).items()
            ]
            for title in comparison.losses.other_db
        }
    return {"agreement": agreement, "swaps": swaps, "cells": cells, "losses": losses}


def write_results(comparison: Comparison, folder: Path) -> None:
    """Write `radio.json`, `radio.md` and both figures into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in (
        ("radio.json", json.dumps(results(comparison), indent=1)), ("radio.md", "\n".join(tables(comparison, ".")))
    ):  # fmt: skip
        with atomic_write(folder / name) as file:
            file.write(text.encode())
    write_figures(comparison, folder)


def write_figures(comparison: Comparison, folder: Path) -> None:
    """Write the figures as SVG."""
    panels: dict[str, Sequence[tuple[float, float]]] = {}
    for engine in comparison.engines:
        title = EngineSetup(engine).title
        panels[f"{title}, defaults"] = comparison.pairs(engine, swapped=False)
        panels[f"{title}, defaults or best swap"] = comparison.pairs(engine, swapped=True)
    draw_shares(comparison, BUILTIN.title, panels).save(folder / SHARES_SVG)
    if comparison.losses is not None and comparison.losses.other_db:
        models = {title: residuals(comparison.losses, title) for title in comparison.losses.other_db}
        draw_residuals(models).save(folder / LOSSES_SVG)


def _read(page: Path) -> str:
    try:
        return read_input(page, "--page", max_bytes=MIB, expected="a Markdown page").decode()
    except UnicodeDecodeError:
        raise InputError.one("--page", str(page), "not UTF-8", "a Markdown page") from None


def check_page(page: Path) -> None:
    """Raise `InputError` for a page without `BEGIN` and `END`, or one that cannot be read."""
    if _BLOCK.search(_read(page)) is None:
        raise InputError.one("--page", str(page), "a page without the marks", f"a page with {BEGIN} and {END}")


def renew_page(comparison: Comparison, page: Path) -> None:
    """Replace the tables between `BEGIN` and `END` in a page, and its figures in `../images`."""
    check_page(page)
    block = "\n".join([BEGIN, "", *tables(comparison, "../images"), END])
    text = _BLOCK.sub(lambda _: block, _read(page))
    with atomic_write(page) as file:
        file.write(text.encode())
    write_figures(comparison, page.parent.parent / "images")


_SIZE: Final = 260.0
_LEFT, _TOP, _GAP = 44.0, 40.0, 36.0
_BEYOND_DB: Final = 60.0


def draw_shares(comparison: Comparison, first: str, others: Mapping[str, Sequence[tuple[float, float]]]) -> Figure:
    """Draw a panel for each of `others`, by title: the share decoded in each cell over that of `first`.

    Each has a pair for each cell, the share of `first` and its own.

    The band is the agreement that is asked for. Colours are experiments; cells that do not count are faint.
    """
    width = _LEFT + len(others) * (_SIZE + _GAP)
    height = _TOP + _SIZE + 62.0
    colours = dict(zip(comparison.experiments, OKABE_ITO, strict=False))
    body: list[Element] = []
    for panel, (other, pairs) in enumerate(others.items()):
        x0 = _LEFT + panel * (_SIZE + _GAP)
        body += _axes(x0, first, other)
        for row, (experiment, facts) in enumerate(comparison.cells):
            mine, theirs = pairs[row]
            if not np.isfinite(mine) or not np.isfinite(theirs):
                continue
            counts = any(PARTIAL[0] <= share <= PARTIAL[1] for share in (mine, theirs))
            dot: svg.Attributes = {
                "cx": x0 + mine * _SIZE, "cy": _TOP + (1.0 - theirs) * _SIZE, "r": 2.6,
                "fill": colours[experiment], "fill-opacity": ".8" if counts else ".15",
            }  # fmt: skip
            text = f"{experiment}: {_describe(facts)}: {mine:.3f}, {theirs:.3f}"
            body.append(svg.element("circle", dot, svg.title(text)))
    x = _LEFT
    for experiment, colour in colours.items():
        body.append(svg.element("circle", {"cx": x + 4, "cy": height - 10, "r": 4, "fill": colour}))
        body.append(svg.label(x + 13, height - 6, experiment, "start"))
        x += 30 + 7 * len(experiment)
    return svg.document(width, height, f"Share of decoded frames: {first} and {', '.join(others)}", body)


def _axes(x0: float, first: str, other: str) -> list[Element]:
    """Axes from 0 to 1 with the diagonal and the band of agreement."""
    outline = ((0.0, 0.0), (0.0, WITHIN), (1.0 - WITHIN, 1.0), (1.0, 1.0), (1.0, 1.0 - WITHIN), (WITHIN, 0.0))
    points = np.array([(x0 + x * _SIZE, _TOP + (1.0 - y) * _SIZE) for x, y in outline])
    body = [
        svg.label(x0, _TOP - 22, other, "start", 12, svg.BOLD),
        svg.element("path", {"d": svg.path_data(points, close=True), "fill": "currentColor", "fill-opacity": ".08"}),
    ]
    for tick in (0.0, 0.25, 0.5, 0.75, 1.0):
        x, y = x0 + tick * _SIZE, _TOP + (1.0 - tick) * _SIZE
        lines = (f"M{x:.1f} {_TOP:.1f}v{_SIZE:.1f}", f"M{x0:.1f} {y:.1f}h{_SIZE:.1f}")
        body += [svg.element("path", {"d": data, **svg.GRID}) for data in lines]
        body.append(svg.label(x, _TOP + _SIZE + 16, f"{tick:g}"))
        if x0 == _LEFT:
            body.append(svg.label(x0 - 7, y + 4, f"{tick:g}", "end"))
    body.append(svg.label(x0 + _SIZE / 2, _TOP + _SIZE + 32, f"share decoded by {first}", extra={"opacity": ".7"}))
    return body


def _describe(facts: Mapping[str, object]) -> str:
    return ", ".join(f"{name} {value}" for name, value in facts.items())


def draw_residuals(residuals: Mapping[str, Mapping[tuple[str, bool], Residual]]) -> Figure:
    """Draw the 10th to 90th percentile and the median of each model's loss minus skyrange's, by heights and sight.

    What is beyond `_BEYOND_DB` is an arrow at the edge.
    """
    rows = list(dict.fromkeys(key for cells in residuals.values() for key in cells))
    spans = [residual for cells in residuals.values() for residual in cells.values()]
    low = max(min((residual.low_db for residual in spans), default=-10.0) - 2.0, -_BEYOND_DB)
    high = min(max((residual.high_db for residual in spans), default=10.0) + 2.0, _BEYOND_DB)
    step = 9.0 * len(residuals) + 12.0
    left, top, width = 170.0, 44.0, 680.0
    height = top + step * len(rows) + 40.0
    scale = width / (high - low)
    colours = dict(zip(residuals, OKABE_ITO, strict=False))
    body: list[Element] = []
    values, spacing = svg.ticks(low, high, 8)
    for value in values:
        x = left + (value - low) * scale
        body.append(svg.element("path", {"d": f"M{x:.1f} {top:.1f}V{height - 36:.1f}", **svg.GRID}))
        body.append(svg.label(x, height - 20, svg.format_tick(value, spacing)))
    for number, (heights, sight) in enumerate(rows):
        y = top + number * step + 6.0
        body.append(svg.label(left - 10, y + step / 2 - 2, f"{heights}, {'sight' if sight else 'no sight'}", "end"))
        for turn, (model, cells) in enumerate(residuals.items()):
            residual = cells.get((heights, sight))
            if residual is None:
                continue
            level = y + 9.0 * turn + 3.0
            a, middle, b = (
                left + (min(max(value, low), high) - low) * scale
                for value in (residual.low_db, residual.median_db, residual.high_db)
            )
            look: svg.Attributes = {"stroke": colours[model], "stroke-width": 3.0, "stroke-opacity": ".75"}
            span = f"{residual.low_db:+.1f} to {residual.high_db:+.1f}"
            text = f"{model}: {residual.median_db:+.1f} dB, {span}, {residual.pairs} pairs"
            body.append(svg.element("path", {"d": f"M{a:.1f} {level:.1f}H{b:.1f}", **look}, svg.title(text)))
            if residual.median_db > high:
                arrow = f"M{b - 7:.1f} {level - 4:.1f}L{b:.1f} {level:.1f}L{b - 7:.1f} {level + 4:.1f}Z"
                body.append(svg.element("path", {"d": arrow, "fill": colours[model]}, svg.title(text)))
                continue
            body.append(svg.element("circle", {"cx": middle, "cy": level, "r": 3.4, "fill": colours[model]}))
    x = 20.0
    for model, colour in colours.items():
        body.append(svg.element("circle", {"cx": x + 4, "cy": 16.0, "r": 4, "fill": colour}))
        body.append(svg.label(x + 12, 20.0, model, "start"))
        x += 26 + 6.2 * len(model)
    body.append(svg.label(left + width / 2, height - 4, "loss minus skyrange's, dB", extra={"opacity": ".7"}))
    return svg.document(left + width + 20.0, height, "Path losses of the engines' own models", body)
