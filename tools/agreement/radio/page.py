"""Results of a comparison of radio engines as files: tables in Markdown, figures, and JSON."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from skyrange.core.errors import InputError
from skyrange.core.files import MIB, atomic_write, read_input
from tools.agreement.radio.agreement import PARTIAL, WITHIN, Comparison
from tools.agreement.radio.figures import draw_residuals, draw_shares
from tools.agreement.radio.own_losses import residuals
from tools.agreement.radio.setups import BUILTIN, EngineSetup

BEGIN: Final = "<!-- python -m tools.agreement radio: begin -->"
END: Final = "<!-- python -m tools.agreement radio: end -->"
SHARES_SVG: Final = "radio-parity-shares.svg"
LOSSES_SVG: Final = "radio-parity-losses.svg"
_WORST: Final = 5
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
    said = f"{swap.text}: {comparison.shares[swap.setup.title][row]:.3f}"
    return f"{said}, builtin {comparison.shares[swap.builtin.title][row]:.3f}" if swap.builtin.changes else said


def _losses(comparison: Comparison) -> Iterator[str]:
    pairs = comparison.losses
    if pairs is None or not pairs.other_db:
        return
    count = f"{len(pairs.ends_m):,}"
    yield f"Loss of each model minus skyrange's in dB over {count} pairs: median (10th to 90th percentile)."
    yield ""
    found = {title: residuals(pairs, title) for title in pairs.other_db}
    yield "| heights | sight | pairs | " + " | ".join(found) + " |"
    yield "|---|---|---|" + "---|" * len(found)
    keys = list(dict.fromkeys(key for one in found.values() for key in one))
    for heights, sight in keys:
        cells, number = [], 0
        for one in found.values():
            if (heights, sight) not in one:
                cells.append("")
                continue
            it = one[(heights, sight)]
            number = max(number, it.pairs)
            missing = f"; none for {it.missing}" if it.missing else ""
            cells.append(f"{it.median_db:+.1f} ({it.low_db:+.1f} to {it.high_db:+.1f}{missing})")
        yield f"| {heights} | {'yes' if sight else 'no'} | {number} | " + " | ".join(cells) + " |"
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
                {"heights": heights, "sight": sight, **one._asdict()}
                for (heights, sight), one in residuals(comparison.losses, title).items()
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
        found = {title: residuals(comparison.losses, title) for title in comparison.losses.other_db}
        draw_residuals(found).save(folder / LOSSES_SVG)


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
