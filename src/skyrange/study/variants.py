"""Comparison of variants of a scenario: runs of the same seeds with some values changed, their tables and page."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

from skyrange.assembly.build import build
from skyrange.core.errors import ComponentError, InputError, Problem, ShortfallError
from skyrange.core.files import atomic_write, expand_user
from skyrange.core.ids import ID_PATTERN
from skyrange.figures import svg
from skyrange.figures.palette import OKABE_ITO
from skyrange.figures.svg import Figure
from skyrange.record import load as load_run
from skyrange.record.folder import make_new_folder
from skyrange.report.rendering import asset, content_policy, render
from skyrange.runtime.run import free_folder
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.shipped import load as load_scenario
from skyrange.statistics.means import Interval, estimate_mean
from skyrange.study.parallel_runs import OnRunProgress, require_level, run_all
from skyrange.study.run_measures import QUANTITIES, RunMeasures, measure_run
from skyrange.twins.arms import acting_attacks
from skyrange.twins.failed_missions import find_failed_missions

UNCHANGED: Final = "unchanged"
"""Name of the scenario as it is."""
MANIFEST: Final = "comparison.json"
FORMAT: Final = "skyrange.comparison/1"
MAX_VARIANTS: Final = 16


@dataclass(frozen=True, slots=True)
class Comparison:
    """The measures of all runs."""

    path: Path
    name: str
    seeds: tuple[int, ...]
    changes: Mapping[str, Sequence[str]]
    """By variant, in order: the changes of the scenario."""
    measured: Mapping[tuple[str, int], RunMeasures]
    """By variant and seed."""
    failed_missions: Sequence[str] = ()
    """Missions that failed in the scenario as it is, if no attack or fault acts in it (`study.failed_missions`)."""

    def folder(self, variant: str, seed: int) -> str:
        """The folder of a run, in that of the comparison."""
        return folder_of(variant, seed, self.seeds)

    def interval(self, variant: str, quantity: str) -> Interval | None:
        """The mean of a measure over the seeds; `None` if no run of the variant has it."""
        runs = (self.measured[variant, seed].values for seed in self.seeds)
        return estimate_mean([values[quantity] for values in runs if quantity in values])

    def delays_s(self, variant: str) -> dict[str, Interval]:
        """The mean delay of each operator's flights over the seeds."""
        found: dict[str, list[float]] = {}
        for seed in self.seeds:
            for operator, delay_s in self.measured[variant, seed].delays_s.items():
                found.setdefault(operator, []).append(delay_s)
        means = {operator: estimate_mean(delays) for operator, delays in found.items()}
        return {operator: mean for operator, mean in means.items() if mean is not None}

    def describe(self) -> dict[str, Any]:
        """As plain data."""
        return {
            "format": FORMAT,
            "name": self.name,
            "seeds": list(self.seeds),
            "failed_missions": list(self.failed_missions),
            "variants": [
                {
                    "name": variant,
                    "changes": list(changes),
                    "measures": {
                        one.name: mean._asdict()
                        for one in QUANTITIES
                        if (mean := self.interval(variant, one.name)) is not None
                    },
                    "delays_s": {name: mean._asdict() for name, mean in self.delays_s(variant).items()},
                }
                for variant, changes in self.changes.items()
            ],
        }


def folder_of(variant: str, seed: int, seeds: Sequence[int]) -> str:
    """The folder of a run."""
    return variant if len(seeds) == 1 else f"seed-{seed}/{variant}"


def read_variants(texts: Sequence[str]) -> dict[str, list[str]]:
    """Variants by name from `NAME:PATH=VALUE`; a name that comes again has another change. Raises `InputError`."""
    found: dict[str, list[str]] = {}
    problems = []
    for text in texts:
        name, colon, change = text.partition(":")
        if not colon or not ID_PATTERN.match(name) or name == UNCHANGED:
            expected = f"NAME:PATH=VALUE, with a name other than {UNCHANGED!r}"
            problems.append(
                Problem("variant", repr(text), expected, "Such as federated:operators.*.approval=federated.")
            )
        else:
            found.setdefault(name, []).append(change.strip())
    if not problems and not 1 <= len(found) <= MAX_VARIANTS:
        problems.append(Problem("variant", str(len(found)), f"1 to {MAX_VARIANTS} variants"))
    if problems:
        raise InputError("compare", problems)
    return found


def compare_variants(
    name: str | Path,
    variants: Mapping[str, Sequence[str]],
    out: str | Path | None = None,
    *,
    seeds: int = 1,
    jobs: int | None = None,
    seed: int | None = None,
    buildings: str | Path | None = None,
    changes: Sequence[str] = (),
    on_progress: OnRunProgress | None = None,
) -> Comparison:
    """Run a scenario as it is and each of its variants, with the same seeds, and measure the runs.

    `name` is a shipped scenario or a file. `variants` has the changes of each, as `--set` has them, in addition to
    `changes` of all. `out` defaults to the first free folder of `runs/NAME-comparison`, `runs/NAME-comparison-2` …
    Raises `InputError` before anything is written, `ComponentError` if a run failed, `ShortfallError` after Ctrl-C.
    """
    jobs = jobs if jobs is not None else os.cpu_count() or 1
    all_changes = {UNCHANGED: list(changes), **{one: [*changes, *more] for one, more in variants.items()}}
    scenarios: dict[str, Scenario] = {}
    for variant, given in all_changes.items():
        scenarios[variant] = load_scenario(str(name), given, seed=seed, buildings=buildings)
        require_level(scenarios[variant], "truth", "compare")
        build(scenarios[variant])  # raises errors in the scenario before a folder is created
    base = scenarios[UNCHANGED]
    numbers = tuple(base.seed + k for k in range(seeds))
    folder = make_new_folder(expand_user(out) if out is not None else free_folder(f"{base.name}-comparison"))
    flights = [(variant, number) for number in numbers for variant in scenarios]
    results = run_all(
        [
            (scenarios[variant].model_copy(update={"seed": number}), folder / folder_of(variant, number, numbers))
            for variant, number in flights
        ],
        jobs,
        on_progress,
    )
    worst = max(results, key=lambda one: one.exit_code)
    if worst.exit_code == ShortfallError.exit_code:
        raise ShortfallError(f"interrupted; the runs so far are in {folder}", folder)
    if worst.exit_code:
        variant, number = flights[results.index(worst)]
        raise ComponentError(f"run {variant}, seed {number}", worst.message)
    measured = {
        (variant, number): measure_run(load_run(folder / folder_of(variant, number, numbers)))
        for variant, number in flights
    }
    failed: list[str] = []
    if not acting_attacks(base):
        runs = (load_run(folder / folder_of(UNCHANGED, number, numbers)) for number in numbers)
        failed = [str(found) for run in runs if (found := find_failed_missions(run, UNCHANGED)) is not None]
    result = Comparison(folder, base.name, numbers, all_changes, measured, failed)
    with atomic_write(folder / MANIFEST) as file:
        file.write(f"{json.dumps(result.describe(), indent=2)}\n".encode())
    return result


class Table(NamedTuple):
    """One table."""

    title: str
    head: list[str]
    rows: list[list[str]]
    notes: list[str]
    """What each row is about, for those who ask."""


def make_tables(result: Comparison) -> list[Table]:
    """The measures that differ somewhere or are not zero, and the delays."""
    variants = list(result.changes)
    rows, notes = [], []
    for one in QUANTITIES:
        means = [result.interval(variant, one.name) for variant in variants]
        if not any(mean is not None and mean.mean for mean in means):
            continue
        rows.append([f"{one.name} ({one.unit})" if one.unit else one.name, *map(format_interval, means)])
        notes.append(one.about)
    tables = [Table("Measures", ["measure", *variants], rows, notes)]
    delays = {variant: result.delays_s(variant) for variant in variants}
    operators = list(dict.fromkeys(name for own in delays.values() for name in own))
    if any(mean.mean for own in delays.values() for mean in own.values()):
        rows = [[name, *(format_interval(delays[variant].get(name)) for variant in variants)] for name in operators]
        title = "Mean delay of the approved flights of each operator (s)"
        tables.append(Table(title, ["operator", *variants], rows, [""] * len(rows)))
    return tables


def format_interval(mean: Interval | None) -> str:
    """A mean with its interval, or why it has none."""
    if mean is None:
        return "–"
    if mean.n == 1:
        return _number(mean.mean)
    if mean.low is None or mean.high is None:
        return f"{_number(mean.mean)} ({mean.without})"
    return f"{_number(mean.mean)} ({_number(mean.low)} to {_number(mean.high)})"


def _number(value: float) -> str:
    if value == round(value):
        return f"{value:,.0f}"
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


_LEFT: Final = 110.0
_TOP: Final = 46.0
_BAR: Final = 13.0
_GAP: Final = 12.0
_WIDE: Final = 560.0
_KEY: Final = 132.0


def draw_delays(result: Comparison) -> Figure | None:
    """Bars by operator and variant, with lines for the intervals; `None` if nobody was delayed."""
    delays = {variant: result.delays_s(variant) for variant in result.changes}
    operators = list(dict.fromkeys(name for own in delays.values() for name in own))
    most = max((mean.high or mean.mean for own in delays.values() for mean in own.values()), default=0.0)
    if most <= 0.0:
        return None
    values, step = svg.ticks(0.0, most)
    scale = _WIDE / most
    high = len(delays) * _BAR + _GAP
    height = _TOP + len(operators) * high + 40
    body = []
    for k, variant in enumerate(delays):
        x = _LEFT + _KEY * (k % 5)
        y = 14.0 + 14.0 * (k // 5)
        body.append(svg.element("rect", {"x": x, "y": y - 8, "width": 10, "height": 10, "fill": _colour(k)}))
        body.append(svg.label(x + 15, y + 1, variant, "start"))
    foot = _TOP + len(operators) * high
    for value in values:
        x = _LEFT + value * scale
        body.append(svg.element("path", {"d": f"M{x:.1f} {_TOP - 6}V{foot:.1f}", **svg.GRID}))
        body.append(svg.label(x, foot + 15, svg.format_tick(value, step)))
    body.append(svg.label(_LEFT + _WIDE, foot + 31, "mean delay (s)", "end", 10.5, {"opacity": ".7"}))
    for n, operator in enumerate(operators):
        top = _TOP + n * high
        body.append(svg.label(_LEFT - 10, top + (high - _GAP) / 2 + 4, operator, "end"))
        for k, (variant, own) in enumerate(delays.items()):
            mean = own.get(operator)
            if mean is None:
                continue
            y, width = top + k * _BAR, max(mean.mean, 0.0) * scale
            said = svg.title(f"{operator}, {variant}: {mean.mean:.1f} s")
            place: svg.Attributes = {"x": _LEFT, "y": y + 1, "width": max(width, 1.0), "height": _BAR - 2}
            body.append(svg.element("rect", {**place, "fill": _colour(k)}, said))
            if mean.low is not None and mean.high is not None:
                line = f"M{_LEFT + mean.low * scale:.1f} {y + _BAR / 2:.1f}H{_LEFT + mean.high * scale:.1f}"
                body.append(svg.element("path", {"d": line, "stroke": "currentColor", "stroke-width": "1.5"}))
    return svg.document(_LEFT + _WIDE + 30, height, f"Delays by operator: {result.name}", body)


def _colour(number: int) -> str:
    return OKABE_ITO[number % len(OKABE_ITO)]


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
