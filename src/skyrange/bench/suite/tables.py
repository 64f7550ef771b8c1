"""Tables of the results of all benchmarks, as texts: for the terminal, for the HTML page, and for Markdown."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import Final, NamedTuple

from skyrange.bench.suite.comparison import Change, compare_results
from skyrange.bench.suite.results import BenchmarkResult, CaseResult, Measure, Results

NONE: Final = "–"
LOAD_TEXT: Final = """\
Involuntary switches: how often the system took the core from the case's processes, per second of wall time. Other
programs: the cores that they used during the case. The load average is that of the last minute before the case. If the
yardstick changes, so did the speed of the machine.
"""


class Table(NamedTuple):
    """A table: the first `texts` columns are texts, the others numbers; `verdicts` is () or has a word for each row."""

    title: str
    text: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    texts: int = 1
    verdicts: Sequence[str] = ()


def make_tables(results: Results, old: Results | None = None) -> list[Table]:
    """A table for each benchmark that ran, relative measures first; with `old`, old and new values side by side."""
    if old is None:
        return [_measured(benchmark) for benchmark in results.benchmarks if any(c.rows for c in benchmark.cases)]
    about = {benchmark.name: benchmark.about for benchmark in results.benchmarks}
    groups = groupby(compare_results(old, results), key=lambda change: change.benchmark)
    return [_compared(name, about[name], list(changes)) for name, changes in groups]


def make_load_table(results: Results) -> Table:
    """What each case used of the machine, and what else ran."""
    head = (
        "benchmark", "case", "wall time, s", "CPU / wall", "involuntary switches, 1/s", "load average before",
        "other programs, cores", "yardstick before, µs", "yardstick after, µs", "peak memory, MB",
    )  # fmt: skip
    rows = [(benchmark.name, case.name, *_load(case)) for benchmark, case in results.cases()]
    return Table("Load", LOAD_TEXT, head, rows, 2)


def make_overview(results: Results) -> Table:
    """One line for each row: its speed and its cost in yardsticks, and what its case used of the machine."""
    head = ("case", "speed, ×", "yardsticks", "wall s", "CPU/wall", "others", "peak MB")
    rows = []
    for benchmark, case in results.cases():
        for row in case.rows:
            speed = next(
                (measure.value for measure in row.measures if measure.unit == "×" and "speed" in measure.name), None
            )
            cost = next((measure for measure in row.measures if measure.unit == "yardsticks"), None)
            load = list(_load(case))
            rows.append(
                (
                    f"{benchmark.name}: {name_case(case.name, row.name)}",
                    format_value(speed),
                    NONE if cost is None else format_value(cost.value),
                    *(load[k] for k in (0, 1, 4, 7)),
                )
            )
    return Table("", "", head, rows)


def list_facts(results: Results) -> list[tuple[str, str]]:
    """The machine and the versions, each with its name."""
    machine = results.machine
    memory = NONE if machine.memory_mb is None else f"{machine.memory_mb / 1e3:.1f} GB"
    return [
        ("processor", f"{machine.processor}, {machine.cores} cores"),
        ("memory", memory),
        ("virtual machine", NONE if machine.virtual is None else "yes" if machine.virtual else "no"),
        ("system", machine.system),
        ("versions", f"{machine.python}, numpy {machine.numpy}, numba {machine.numba}, llvmlite {machine.llvmlite}"),
        ("skyrange", results.skyrange),
        ("measured", f"{results.started:%Y-%m-%d %H:%M} UTC" + (", quick sizes" if results.quick else "")),
    ]


def list_skipped(results: Results) -> list[tuple[str, str]]:
    """The benchmarks that were skipped, with the reasons."""
    return [(benchmark.name, benchmark.skipped) for benchmark in results.benchmarks if benchmark.skipped]


def format_value(value: float | None) -> str:
    """A value with three significant digits, or all digits before the point, thousands apart."""
    if value is None:
        return NONE
    size = abs(value)
    decimals = 0 if size >= 100 or size == 0 else 1 if size >= 10 else 2 if size >= 1 else 3
    return f"{value:,.{decimals}f}".replace(",", "\u202f")


def name_case(case: str, row: str) -> str:
    """A case, and the row of it if it has several."""
    return f"{case}: {row}" if row else case


def _measured(benchmark: BenchmarkResult) -> Table:
    measured = [(name_case(case.name, row.name), row.measures) for case in benchmark.cases for row in case.rows]
    heads = list(dict.fromkeys(map(_head, _sorted([measure for _, measures in measured for measure in measures]))))
    rows = []
    for name, measures in measured:
        cells = {_head(measure): format_value(measure.value) for measure in measures}
        rows.append([name, *(cells.get(head, NONE) for head in heads)])
    return Table(benchmark.name, benchmark.about, ["case", *heads], rows)


def _compared(name: str, about: str, changes: Sequence[Change]) -> Table:
    ordered = sorted(changes, key=lambda change: not change.new.relative)
    head = ("case", "measure", "old", "new", "new over old")
    rows = [
        (
            name_case(change.case, change.row),
            _head(change.new),
            format_value(change.old.value),
            format_value(change.new.value),
            NONE if change.ratio is None else f"{change.ratio:.2f}",
        )
        for change in ordered
    ]
    return Table(name, about, head, rows, 2, [change.verdict for change in ordered])


def _sorted(measures: Sequence[Measure]) -> Iterator[Measure]:
    yield from (measure for measure in measures if measure.relative)
    yield from (measure for measure in measures if not measure.relative)


def _head(measure: Measure) -> str:
    return f"{measure.name}, {measure.unit}" if measure.unit else measure.name


def _load(case: CaseResult) -> Iterator[str]:
    load = case.load
    wall_s = max(load.wall_s, 1e-3)
    yield format_value(load.wall_s)
    yield f"{load.cpu_s / wall_s:.2f}"
    yield format_value(round(load.involuntary_switches / wall_s))
    yield f"{load.loadavg_before:.2f}"
    yield NONE if load.elsewhere_cores is None else f"{load.elsewhere_cores:.2f}"
    yield format_value(load.yardstick_before_us)
    yield format_value(load.yardstick_after_us)
    yield format_value(case.memory.peak_mb)
