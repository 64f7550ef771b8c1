"""Page of the results of all benchmarks as one HTML file, its figures, and the tables in Markdown."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final
from xml.etree.ElementTree import Element

import numpy as np

from skyrange.bench.suite.comparison import Change, compare_results, list_differences, list_warnings
from skyrange.bench.suite.results import Memory, Results
from skyrange.bench.suite.tables import (
    Table,
    format_value,
    list_facts,
    list_skipped,
    make_load_table,
    make_tables,
    name_case,
)
from skyrange.core.files import atomic_write
from skyrange.figures import svg
from skyrange.figures.palette import OKABE_ITO
from skyrange.figures.svg import Figure, format_number
from skyrange.report.rendering import asset, content_policy, render

MEMORY_TEXT: Final = """\
Resident memory of all processes of a case together, from its start to its end. Pages that processes share count for
each of them, so a case of several processes takes less than this.
"""


def write_page(results: Results, path: Path, old: Results | None = None) -> None:
    """Write the page of the results, compared with `old` ones if there are some. Raises `OSError`."""
    with atomic_write(path) as file:
        file.write(make_page(results, old).encode())


def make_page(results: Results, old: Results | None = None) -> str:
    """The page of the results as HTML, which loads nothing."""
    style = asset("style.css") + asset("bench.css")
    before = {} if old is None else {(benchmark.name, case.name): case.memory for benchmark, case in old.cases()}
    memories = [
        (
            benchmark.name,
            case.name,
            case.memory.peak_mb,
            case.memory.processes,
            draw_memory(case.memory, f"{benchmark.name}, {case.name}", before.get((benchmark.name, case.name))),
        )
        for benchmark, case in results.cases()
        if case.memory.resident_mb
    ]
    was = dict(list_facts(results if old is None else old))
    facts = [(name, value, was[name]) for name, value in list_facts(results)]
    return str(
        render(
            "bench/page.html.jinja",
            policy=content_policy(style),
            title="Benchmarks · skyrange",
            style=style,
            compared=old is not None,
            machine=results.machine,
            started=f"{results.started:%Y-%m-%d %H:%M} UTC",
            quick=results.quick,
            facts=facts,
            warnings=[*([] if old is None else list_differences(old, results)), *list_warnings(results)],
            speeds=draw_speeds(results, old),
            changes=None if old is None else draw_changes(compare_results(old, results)),
            tables=make_tables(results, old),
            load=make_load_table(results),
            memories=memories,
            memory_text=MEMORY_TEXT,
            skipped=list_skipped(results),
        )
    )


def make_markdown(results: Results) -> str:
    """The tables of the results in Markdown, from headings of the second level on."""
    facts = Table("Machine", "", ("", ""), list_facts(results), 2)
    parts = [*(f"> {warning}\n" for warning in list_warnings(results)), _markdown(facts)]
    parts += [_markdown(table) for table in make_tables(results)]
    parts.append(_markdown(make_load_table(results)))
    if skipped := list_skipped(results):
        parts.append(_markdown(Table("Skipped", "", ("benchmark", "why"), skipped, 2)))
    return "\n".join(parts)


def _markdown(table: Table) -> str:
    lines = [table.head, ["---" if n < table.texts else "---:" for n in range(len(table.head))], *table.rows]
    text = f"{' '.join(table.text.split())}\n\n" if table.text else ""
    rows = "".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |\n" for line in lines)
    return f"## {table.title}\n\n{text}{rows}"


SPEED: Final = "speed"
"""Name of the measures that `draw_speeds` shows."""
_WIDE: Final = 1080.0
_LEFT: Final = 330.0
_RIGHT: Final = 80.0
_ROW: Final = 26.0
_FOOT: Final = 44.0
_NEW: Final = {"class": "bar", "fill": OKABE_ITO[0]}
_OLD: Final = {"class": "bar old", "fill": "#8a93a0"}
_VERDICTS: Final = {"better": "#0b7a43", "worse": "#b3261e", "": "#8a93a0"}


def draw_speeds(results: Results, old: Results | None = None) -> Figure | None:
    """Bars of the speeds on a logarithmic axis, the old ones thinner below the new; `None` without speeds."""
    new = _speeds(results)
    before = _speeds(old) if old is not None else {}
    values = [value for value in (*new.values(), *(before.get(name, 0.0) for name in new)) if value > 0.0]
    if not values:
        return None
    low, high = math.floor(math.log10(min(*values, 0.999))), math.ceil(math.log10(max(*values, 1.001)))
    scale = (_WIDE - _LEFT - _RIGHT) / (high - low)

    def place(value: float) -> float:
        return _LEFT + (math.log10(value) - low) * scale

    row, top = _ROW + (10.0 if before else 0.0), 24.0 if before else 8.0
    height = top + row * len(new) + _FOOT
    body = _log_axis(low, high, place, top, height - _FOOT)
    body += _key(("new", _NEW), ("old", _OLD)) if before else []
    for n, (name, value) in enumerate(new.items()):
        y = top + row * n + 5
        body.append(svg.label(_LEFT - 12, y + 12, name, "end", 12))
        body += _bar(_LEFT, place(value), y, 15.0, _NEW, f"{name}: {format_value(value)} ×")
        body.append(svg.label(place(value) + 6, y + 12, f"{format_value(value)} ×", "start", 12, svg.BOLD))
        if before.get(name, 0.0) > 0.0:
            was = before[name]
            body += _bar(_LEFT, place(was), y + 17, 7.0, _OLD, f"{name}, old: {format_value(was)} ×")
            body.append(svg.label(place(was) + 6, y + 25, format_value(was), "start", 10.5, {"opacity": ".7"}))
    body.append(svg.label(_LEFT, height - 8, "× real time, logarithmic", "start", 11.5, _DIM))
    return svg.document(_WIDE, height, "Speed of each case", body)


def draw_changes(changes: Sequence[Change]) -> Figure | None:
    """Costs in yardsticks, new over old: a bar from 1 on a logarithmic axis for each; `None` without any."""
    costs = [
        (f"{change.benchmark}, {name_case(change.case, change.row)}", change.ratio, change.verdict)
        for change in changes
        if change.new.unit == "yardsticks" and change.ratio
    ]
    if not costs:
        return None
    most = max(2.0, *(max(ratio, 1.0 / ratio) for _, ratio, _ in costs if ratio)) * 1.05
    scale = (_WIDE - _LEFT - 2 * _RIGHT) / (2.0 * math.log(most))
    one_x = _LEFT + _RIGHT + math.log(most) * scale - 40
    height = 8.0 + _ROW * len(costs) + _FOOT
    body: list[Element] = []
    for value in (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0):
        if 1.0 / most <= value <= most:
            x = one_x + math.log(value) * scale
            look = {"stroke": "currentColor", "stroke-opacity": ".55"} if value == 1.0 else svg.GRID
            body.append(svg.element("path", {"d": f"M{format_number(x)} 8V{format_number(height - _FOOT)}", **look}))
            body.append(svg.label(x, height - _FOOT + 16, f"{value:g}"))
    for n, (name, ratio, verdict) in enumerate(costs):
        assert ratio is not None
        x, y = one_x + math.log(ratio) * scale, 8.0 + _ROW * n + 5
        body.append(svg.label(_LEFT - 12, y + 12, name, "end", 12))
        look = {"class": verdict or "same", "fill": _VERDICTS[verdict]}
        body += _bar(min(x, one_x), max(x, one_x, min(x, one_x) + 1), y, 15.0, look, f"{name}: {ratio:.2f}")
        anchor, shift = ("start", 6.0) if ratio >= 1.0 else ("end", -6.0)
        body.append(svg.label(x + shift, y + 12, f"{ratio:.2f}", anchor, 12, svg.BOLD))
    caption = "cost in yardsticks, new over old; left of 1 is cheaper"
    body.append(svg.label(_LEFT, height - 8, caption, "start", 11.5, _DIM))
    return svg.document(_WIDE, height, "Costs in yardsticks, new over old", body)


def draw_memory(memory: Memory, title: str, old: Memory | None = None) -> Figure:
    """Resident memory of a case's processes over its wall time, that of the old results dashed."""
    width, height, left, above, below = 440.0, 172.0, 52.0, 22.0, 34.0
    kept = [series for series in (memory, old) if series is not None and series.resident_mb]
    last = max((len(series.resident_mb) * series.every_s for series in kept), default=0.0) or 1.0
    top = (max((max(series.resident_mb) for series in kept), default=0.0) or 1.0) * 1.08
    x_scale, y_scale = (width - left - 12) / last, (height - above - below) / top
    foot = height - below
    body: list[Element] = []
    values, step = svg.ticks(0.0, top, 4)
    for value in values:
        y = foot - value * y_scale
        across = f"M{format_number(left)} {format_number(y)}H{format_number(width - 12)}"
        body.append(svg.element("path", {"d": across, **svg.GRID}))
        body.append(svg.label(left - 7, y + 4, svg.format_tick(value, step), "end"))
    values, step = svg.ticks(0.0, last, 6)
    body += [svg.label(left + value * x_scale, foot + 15, svg.format_tick(value, step)) for value in values]
    body.append(svg.label(width - 12, height - 4, "wall time, s", "end", 10.5, _DIM))
    body.append(svg.label(left - 7, 12, "MB", "end", 10.5, _DIM))
    for series in kept:
        points = np.array(
            [
                (left + (n + 1) * series.every_s * x_scale, foot - mb * y_scale)
                for n, mb in enumerate(series.resident_mb)
            ]
        )
        line = svg.path_data(points)
        if series is memory:
            area = np.vstack([[points[0, 0], foot], points, [points[-1, 0], foot]])
            look = {"class": "area", "fill": OKABE_ITO[0], "fill-opacity": ".18"}
            body.append(svg.element("path", {"d": svg.path_data(area, close=True), **look}))
        dashes = {} if series is memory else {"stroke-dasharray": "5 4"}
        drawn = {"class": "trace" if series is memory else "trace old", "stroke": OKABE_ITO[0], "fill": "none"}
        body.append(svg.element("path", {"d": line, "stroke-width": "1.8", **drawn, **dashes}))
    return svg.document(width, height, f"Memory: {title}", body)


_DIM: Final = {"opacity": ".7"}


def _speeds(results: Results) -> Mapping[str, float]:
    """The speeds by benchmark, case and row."""
    return {
        f"{benchmark.name}, {name_case(case.name, row.name)}": measure.value
        for benchmark, case in results.cases()
        for row in case.rows
        for measure in row.measures
        if measure.name == SPEED and measure.value
    }


def _log_axis(low: int, high: int, place: Callable[[float], float], top: float, foot: float) -> list[Element]:
    """Grid lines at the powers of ten, and a stronger one at 1."""
    body: list[Element] = []
    for power in range(low, high + 1):
        x = place(10.0**power)
        look = {"stroke": "currentColor", "stroke-opacity": ".55"} if power == 0 else svg.GRID
        body.append(
            svg.element("path", {"d": f"M{format_number(x)} {format_number(top)}V{format_number(foot)}", **look})
        )
        body.append(svg.label(x, foot + 16, f"{10.0**power:g}"))
    return body


def _bar(left: float, right: float, y: float, high: float, look: Mapping[str, str], text: str) -> list[Element]:
    place: svg.Attributes = {"x": left, "y": y, "width": max(right - left, 1.0), "height": high, "rx": 2}
    return [svg.element("rect", {**place, **look}, svg.title(text))]


def _key(*entries: tuple[str, Mapping[str, str]]) -> list[Element]:
    body: list[Element] = []
    for n, (name, look) in enumerate(entries):
        x = _LEFT + 70.0 * n
        body.append(svg.element("rect", {"x": x, "y": 5, "width": 11, "height": 11, "rx": 2, **look}))
        body.append(svg.label(x + 16, 15, name, "start", 12))
    return body
