"""Comparison of variants of a scenario: runs of the same seeds with some values changed, their tables and page."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple

from pydantic import Field
from typing_extensions import TypedDict

from skyrange.assembly.build import build
from skyrange.core.errors import InputError, Problem
from skyrange.core.files import atomic_write, expand_user
from skyrange.core.ids import ID_PATTERN
from skyrange.core.typed_json import Finite, check_type
from skyrange.figures import svg
from skyrange.figures.palette import OKABE_ITO
from skyrange.figures.svg import Figure
from skyrange.record import RunRecord
from skyrange.report.rendering import asset, content_policy, render
from skyrange.runtime.run import free_folder
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.shipped import load as load_scenario
from skyrange.scenario.toml_files import load_text, to_toml
from skyrange.statistics.means import Interval, estimate_mean
from skyrange.study.execution.executors import Executor
from skyrange.study.execution.plan import PlannedBlock, PlannedRun, RunPlan, digest_plan
from skyrange.study.execution.plan_run import (
    OnPlanProgress,
    choose_executor,
    forget_failures,
    require_success,
    run_plan,
)
from skyrange.study.execution.store import BLOCKS, RunStore, claim_store
from skyrange.study.execution.store import MANIFEST as PLAN
from skyrange.study.pairing import require_level, work_of
from skyrange.study.plan_size import MAX_RUNS, check_size
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
        samples: dict[str, list[float]] = {}
        for seed in self.seeds:
            for operator, delay_s in self.measured[variant, seed].delays_s.items():
                samples.setdefault(operator, []).append(delay_s)
        means = {operator: estimate_mean(delays) for operator, delays in samples.items()}
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
                        quantity.name: mean._asdict()
                        for quantity in QUANTITIES
                        if (mean := self.interval(variant, quantity.name)) is not None
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
    variants: dict[str, list[str]] = {}
    problems = []
    for text in texts:
        name, colon, change = text.partition(":")
        if not colon or not ID_PATTERN.fullmatch(name) or name == UNCHANGED:
            expected = f"NAME:PATH=VALUE, with a name other than {UNCHANGED!r}"
            problems.append(
                Problem("variant", repr(text), expected, "Such as federated:operators.*.approval=federated.")
            )
        else:
            variants.setdefault(name, []).append(change.strip())
    if not problems and not 1 <= len(variants) <= MAX_VARIANTS:
        problems.append(Problem("variant", str(len(variants)), f"1 to {MAX_VARIANTS} variants"))
    if problems:
        raise InputError("compare", problems)
    return variants


@dataclass(frozen=True)
class VariantPlan(RunPlan):
    """The runs of a comparison: a block for each variant with each seed."""

    scenarios: Mapping[str, Scenario]
    """By variant; the first is the scenario as it is."""
    changes: Mapping[str, Sequence[str]]
    """By variant, in order: the changes of the scenario."""
    seeds: tuple[int, ...]

    kind = "compare"

    @property
    def name(self) -> str:
        """The name of the scenario as it is."""
        return self.scenarios[UNCHANGED].name

    @property
    def blocks(self) -> Sequence[PlannedBlock]:
        """One for each variant with each seed, seed by seed."""
        return list(self.flights)

    @cached_property
    def flights(self) -> dict[PlannedBlock, tuple[str, int]]:
        """The variant and the seed of each block, in order."""
        return {
            PlannedBlock(
                f"seed-{seed}/{variant}",
                (folder_of(variant, seed, self.seeds),),
                work_of(scenario),
                alike=variant,
            ): (variant, seed)
            for seed in self.seeds
            for variant, scenario in self.scenarios.items()
        }

    def digest(self) -> str:
        """See `RunPlan.digest`."""
        return digest_plan(self.kind, self.tell(), self.scenarios.values())

    def tell(self) -> dict[str, Any]:
        """The scenario of each variant as TOML, what was changed for it, and the number of seeds."""
        scenarios = {variant: to_toml(scenario) for variant, scenario in self.scenarios.items()}
        changes = {variant: list(variant_changes) for variant, variant_changes in self.changes.items()}
        return {"scenarios": scenarios, "changes": changes, "seeds": len(self.seeds)}

    def plan_runs(self, block: PlannedBlock, store: RunStore) -> list[PlannedRun]:
        """The one run of a block."""
        variant, seed = self.flights[block]
        scenario = self.scenarios[variant].model_copy(update={"seed": seed})
        return [PlannedRun(block.folders[0], scenario, report=True)]

    def measure(
        self, block: PlannedBlock, records: Mapping[str, RunRecord], errors: Mapping[str, str], store: RunStore
    ) -> dict[str, Any] | None:
        """The measures of the run, and the missions that failed in the unchanged scenario if nothing acts in it."""
        variant, _ = self.flights[block]
        for record in records.values():
            watched = variant == UNCHANGED and not acting_attacks(self.scenarios[variant])
            failed = find_failed_missions(record, UNCHANGED) if watched else None
            return {"measures": measure_run(record)._asdict(), "failed_missions": str(failed) if failed else None}
        return None


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
    max_runs: int = MAX_RUNS,
    executor: Executor | None = None,
    on_progress: OnPlanProgress | None = None,
) -> Comparison:
    """Run a scenario as it is and each of its variants, with the same seeds, and measure the runs.

    `name` is a shipped scenario or a file. `variants` has the changes of each, as `--set` has them, in addition to
    `changes` of all. `out` defaults to the first free folder of `runs/NAME-comparison`, `runs/NAME-comparison-2` …; a
    folder in which the same was begun is gone on with. One of `jobs` is flown in this process; `executor` flies them
    elsewhere. Raises `InputError` before anything is written, `ComponentError` if a run failed, `ShortfallError` after
    Ctrl-C. More runs than `max_runs` raise `InputError`.
    """
    jobs = jobs if jobs is not None else os.cpu_count() or 1
    for option, value in (("seeds", seeds), ("jobs", jobs)):
        if value < 1:
            raise InputError.one("compare", option, value, "1 or more")
    check_size("compare", {"variants": len(variants) + 1, "seeds": seeds}, max_runs, "Say --max-runs N.")
    all_changes = {UNCHANGED: list(changes), **{variant: [*changes, *more] for variant, more in variants.items()}}
    scenarios: dict[str, Scenario] = {}
    for variant, given in all_changes.items():
        scenarios[variant] = load_scenario(str(name), given, seed=seed, buildings=buildings)
        require_level(scenarios[variant], "truth", "compare")
        build(scenarios[variant])  # raises errors in the scenario before a folder is created
    plan = _plan_variants(scenarios, all_changes, seeds)
    folder = expand_user(out) if out is not None else free_folder(f"{plan.name}-comparison")
    store = claim_store(plan, folder)
    return _fly(plan, store, executor if executor is not None else choose_executor(jobs), on_progress)


def resume_comparison(store: RunStore, executor: Executor, on_progress: OnPlanProgress | None = None) -> Comparison:
    """Go on with the comparison in a folder: `skyrange resume`. Raises the errors of `compare_variants`."""
    plan = open_plan(store)
    return _fly(plan, claim_store(plan, store.path), executor, on_progress)


def open_plan(store: RunStore) -> VariantPlan:
    """The plan of the comparison in a folder."""
    who = str(store.path)
    told: _Told = check_type(store.told, _Told, who, f"{PLAN}: told")
    if UNCHANGED not in told["scenarios"] or told["scenarios"].keys() != told["changes"].keys():
        value = ", ".join(told["scenarios"]) or "none"
        expected = f"{UNCHANGED} and variants, with the changes of each"
        raise InputError.one(who, f"{PLAN}: told.scenarios", value, expected, "The file is damaged.")
    sizes = {"variants": len(told["scenarios"]), "seeds": told["seeds"]}
    check_size(who, sizes, max(MAX_RUNS, int(store.manifest["blocks"])), "The file was changed by hand or is damaged.")
    scenarios = {variant: load_text(text) for variant, text in told["scenarios"].items()}
    return _plan_variants(scenarios, told["changes"], told["seeds"])


class _Told(TypedDict):
    """What `VariantPlan.tell` says."""

    scenarios: dict[str, str]
    changes: dict[str, list[str]]
    seeds: Annotated[int, Field(ge=1)]


class _StoredMeasures(TypedDict):
    """The measures in `_StoredBlock`."""

    values: dict[str, Finite]
    delays_s: dict[str, Finite]


class _StoredBlock(TypedDict):
    """What `VariantPlan.measure` makes of a block."""

    measures: _StoredMeasures
    failed_missions: str | None


def _read_block(store: RunStore, name: str) -> _StoredBlock:
    """What a block measured. Raises `InputError` for a damaged file."""
    _, data = store.read(name, _StoredBlock)
    if data is None:
        where = f"{BLOCKS}/{name}.json: data"
        raise InputError.one(str(store.path), where, "nothing", "the measures of a run", "Delete it and resume.")
    stored: _StoredBlock = data
    return stored


def _plan_variants(scenarios: Mapping[str, Scenario], changes: Mapping[str, Sequence[str]], seeds: int) -> VariantPlan:
    first = scenarios[UNCHANGED].seed
    return VariantPlan(scenarios, changes, tuple(first + k for k in range(seeds)))


def _fly(plan: VariantPlan, store: RunStore, executor: Executor, on_progress: OnPlanProgress | None) -> Comparison:
    forget_failures(store)
    require_success(plan, run_plan(plan, store, executor, on_progress))
    measured: dict[tuple[str, int], RunMeasures] = {}
    failed: list[str] = []
    for block, flight in plan.flights.items():
        data = _read_block(store, block.name)
        measured[flight] = RunMeasures(**data["measures"])
        failed += [data["failed_missions"]] if data["failed_missions"] else []
    result = Comparison(store.path, plan.name, plan.seeds, plan.changes, measured, failed)
    with atomic_write(store.path / MANIFEST) as file:
        file.write(f"{json.dumps(result.describe(), indent=2)}\n".encode())
    return result


class Table(NamedTuple):
    """One table."""

    title: str
    head: list[str]
    rows: list[list[str]]
    notes: list[str]
    """What each row is about, for those who ask."""
    commands: Sequence[str] = ()
    """Commands that show the runs of each row."""
    anchors: Sequence[str] = ()
    """Ids of the rows."""


_FIRST: Final = ("missions complete", "collisions", "near misses", "delay, mean")
"""Measures that the sentence is about."""


def describe_comparison(result: Comparison) -> str:
    """The comparison in a sentence: missions, mishaps and delays of all variants, or that they are the same."""
    parts = []
    for quantity in QUANTITIES:
        means = {variant: result.interval(variant, quantity.name) for variant in result.changes}
        known = {variant: mean.mean for variant, mean in means.items() if mean is not None}
        if quantity.name not in _FIRST or not (any(known.values()) or (known and quantity.name == _FIRST[0])):
            continue
        unit = f" {quantity.unit}" if quantity.unit else ""
        if len(set(known.values())) == 1 and len(known) == len(means):
            parts.append(f"{quantity.name} {_number(next(iter(known.values())))}{unit} in each variant")
        else:
            values = ", ".join(f"{variant} {_number(value)}{unit}" for variant, value in known.items())
            parts.append(f"{quantity.name}: {values}")
    text = "; ".join(parts) or "no run has measures"
    return f"{text[0].upper()}{text[1:]}."


def make_tables(result: Comparison) -> list[Table]:
    """The measures that differ somewhere or are not zero, and the delays."""
    variants = list(result.changes)
    rows, notes = [], []
    for quantity in QUANTITIES:
        means = [result.interval(variant, quantity.name) for variant in variants]
        if not any(mean is not None and mean.mean for mean in means):
            continue
        rows.append(
            [f"{quantity.name} ({quantity.unit})" if quantity.unit else quantity.name, *map(format_interval, means)]
        )
        notes.append(quantity.about)
    tables = [Table("Measures", ["measure", *variants], rows, notes)]
    delays = {variant: result.delays_s(variant) for variant in variants}
    operators = list(dict.fromkeys(name for variant_delays in delays.values() for name in variant_delays))
    if any(mean.mean for variant_delays in delays.values() for mean in variant_delays.values()):
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
    operators = list(dict.fromkeys(name for variant_delays in delays.values() for name in variant_delays))
    longest = max(
        (mean.high or mean.mean for variant_delays in delays.values() for mean in variant_delays.values()), default=0.0
    )
    if longest <= 0.0:
        return None
    values, step = svg.ticks(0.0, longest)
    scale = _WIDE / longest
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
        for k, (variant, variant_delays) in enumerate(delays.items()):
            mean = variant_delays.get(operator)
            if mean is None:
                continue
            y, width = top + k * _BAR, max(mean.mean, 0.0) * scale
            title = svg.title(f"{operator}, {variant}: {mean.mean:.1f} s")
            place: svg.Attributes = {"x": _LEFT, "y": y + 1, "width": max(width, 1.0), "height": _BAR - 2}
            body.append(svg.element("rect", {**place, "fill": _colour(k)}, title))
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
        verdict=describe_comparison(result),
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
