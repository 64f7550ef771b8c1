"""Reference of what is measured: benchmarks and their formats, scores of detectors, files and measures of studies."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

from tools.docs.markdown_tables import keys, table

DOCS = Path(__file__).parents[2] / "docs"


def benchmark_results() -> str:
    """The shipped results of all benchmarks."""
    from skyrange.bench.suite.page import make_markdown
    from skyrange.bench.suite.results import read_results

    return make_markdown(read_results(DOCS / "data" / "benchmarks.json"))


def gazebo_benchmark() -> str:
    """The shipped results of the benchmark of Gazebo, of each set-up that was measured."""
    from tools.agreement.gazebo_bench.page import make_markdown

    parts = []
    for file in sorted((DOCS / "data" / "gazebo").glob("*.json")):
        data = json.loads(file.read_text())
        first = data["rows"][0]
        title = f"### {first['versions']['gazebo']}{', with its window' if first['window'] else ''}"
        parts += [title, "", make_markdown(data, f"../images/gazebo-{file.stem}.svg"), ""]
    return "\n".join(parts)


@cache
def _parity() -> dict[str, Any]:
    tables: dict[str, Any] = json.loads((DOCS / "data" / "parity.json").read_text(encoding="utf-8"))
    return tables


def parity_tables() -> dict[str, Callable[[], str]]:
    """The blocks about the missions that the builtin and ArduCopter fly: each measured table, and a summary of two."""
    return {**{f"parity-{name}": partial(_parity_table, name) for name in _parity()}, "parity-summary": _parity_summary}


def _parity_table(name: str) -> str:
    return table(_parity()[name]["heads"], _parity()[name]["rows"])


def _parity_summary() -> str:
    """For each measure the largest difference, in calm air and in wind."""
    cells: dict[str, list[str]] = {}
    for column, name in enumerate(("measures-calm", "measures-wind")):
        for words, _, mission, _, _, difference, relative in _parity()[name]["rows"]:
            cells.setdefault(words, ["", ""])[column] = f"{difference}, {relative} ({mission})"
    rows = [(words, *both) for words, both in cells.items()]
    return table(("measure", "no wind", "wind of 8 m/s"), rows)


def parity_counts() -> dict[str, Callable[[], int]]:
    """Numbers of attacks in the table of reactions: compared, effective, and those in which the autopilots agree."""
    names = ("kinds", "effective", "same", "effective_same", "alike", "effective_alike")
    return {f"parity-attacks-{name.replace('_', '-')}": partial(_count_attacks, name) for name in names}


def _count_attacks(name: str) -> int:
    from skyrange.parity.attacks.page import read_agreement

    return int(getattr(read_agreement(DOCS / "reference" / "parity-results.md"), name))


def benchmark_sizes() -> str:
    """Every benchmark with its cases, those of `--quick` beside them."""
    from skyrange.bench.suite.cases import BENCHMARKS

    rows = [
        (
            f"`{benchmark.name}`",
            benchmark.about,
            "; ".join(case.name for case in benchmark.cases),
            "; ".join(case.name for case in benchmark.quick) or "none",
        )
        for benchmark in BENCHMARKS
    ]
    return table(("name", "what it measures", "cases", "cases with `--quick`"), rows)


def benchmark_format() -> str:
    """Every key of the JSON document of results."""
    from skyrange.bench.suite import results as described

    schema = described.Results.model_json_schema()
    models = {"Results": schema, **schema["$defs"]}
    names = ("Results", "Machine", "BenchmarkResult", "CaseResult", "Row", "Measure", "Load", "Memory")
    assert set(names) == set(models) - {"JsonValue"}
    places = ("the document", "`machine`", "`benchmarks`", "`cases`", "`rows`", "`measures`", "`load`", "`memory`")
    return "\n".join(
        f"### {place}\n\n{keys(models[name], getattr(described, name).model_fields)}"
        for name, place in zip(names, places, strict=True)
    )


def learned_features() -> str:
    """The features of windows that learned detectors read."""
    from skyrange.detect.window_features import FEATURES

    return table(("feature", "meaning"), [(f"`{feature.name}`", feature.about) for feature in FEATURES])


def score_tables() -> str:
    """The columns of the tables that scoring reads."""
    from skyrange.scoring.tables import ALERTS, ATTACKS, FLIGHTS, INTRUSIONS

    about = {
        "flights": "One row for each aircraft of each run.",
        "attacks": "One row for each attack on each aircraft that it affects, or for each attack on a whole run.",
        "intrusions": "One row for each harmless intrusion about each aircraft, or about a whole run.",
        "alerts": "One row for each alert, of all detectors and with all scores: scoring applies the threshold.",
    }
    parts = []
    for (name, text), schema in zip(about.items(), (FLIGHTS, ATTACKS, INTRUSIONS, ALERTS), strict=True):
        rows = [(f"`{field.name}`", field.type, field.metadata[b"about"].decode()) for field in schema]
        parts.append(f"### {name}\n\n{text}\n\n{table(('column', 'type', 'meaning'), rows)}")
    return "\n".join(parts)


def score_format() -> str:
    """Every key of the result file of a scoring."""
    from skyrange.scoring import result_file as described

    schema = described.ScoreFile.model_json_schema()
    models = {"ScoreFile": schema, **schema["$defs"]}
    places = {
        "ScoreFile": "the document",
        "ScoreSettings": "`settings`",
        "HeldOut": "`held_out`",
        "DetectorScore": "`detectors`",
        "Threshold": "`threshold`",
        "SetScore": "`sets` and `effect_sets`",
        "FalseAlarmsByFlights": "`false_alarms`",
        "FalseAlarms": "`nominal`, `sham`, `fault`, `hostile`; `reached`",
        "Claim": "`claim`",
        "Detection": "`detection`",
        "GroupDetection": "`kinds` and `families`",
        "Delay": "`delay`",
        "BeforeEffect": "`before_effect`",
        "HarmlessIntrusions": "`harmless_intrusions`",
        "Precision": "`precision`",
        "EqualRate": "`equal_rate`",
        "Estimate": "ratios: `per_h`, `recall`, `share`",
    }
    assert set(places) == set(models)
    return "\n".join(
        f"### {place}\n\n{keys(models[name], getattr(described, name).model_fields)}" for name, place in places.items()
    )


def study_file() -> str:
    """The keys of a study's file."""
    from skyrange.study.design import model as described
    from skyrange.study.design.model import Study

    schema = Study.model_json_schema()
    places = {
        "Study": "The file",
        "Factor": "`[[factors]]` and `[[draws]]`",
        "StudyArm": "`[[arms]]`",
        "Registration": "`[registration]`",
        "LearnedTable": "`[learned]`",
        "HeldOutTraits": "`[held_out]`",
    }
    models = {"Study": schema, **{name: schema["$defs"][name] for name in list(places)[1:]}}
    return "\n".join(
        f"### {places[name]}\n\n{keys(part, getattr(described, name).model_fields)}" for name, part in models.items()
    )


def study_measures() -> str:
    """The measures in the table `runs` of a study."""
    from skyrange.study.columns import column_of
    from skyrange.study.run_measures import QUANTITIES

    return table(
        ("column", "unit", "meaning"),
        [(f"`{column_of(quantity.name)}`", quantity.unit, quantity.about) for quantity in QUANTITIES],
    )
