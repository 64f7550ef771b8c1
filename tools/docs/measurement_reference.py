"""Reference of what is measured: benchmarks and their formats, scores of detectors, files and measures of studies."""

from __future__ import annotations

from pathlib import Path

from tools.docs.markdown_tables import keys, table

DOCS = Path(__file__).parents[2] / "docs"


def benchmark_results() -> str:
    """The shipped results of all benchmarks."""
    from skyrange.bench.suite.page import make_markdown
    from skyrange.bench.suite.results import read_results

    return make_markdown(read_results(DOCS / "data" / "benchmarks.json"))


def gazebo_benchmark() -> str:
    """The shipped results of the benchmark of Gazebo, of each set-up that was measured."""
    import json

    from tools.agreement.gazebo_bench.page import make_markdown

    parts = []
    for file in sorted((DOCS / "data" / "gazebo").glob("*.json")):
        data = json.loads(file.read_text())
        first = data["rows"][0]
        title = f"### {first['versions']['gazebo']}{', with its window' if first['window'] else ''}"
        parts += [title, "", make_markdown(data, f"../images/gazebo-{file.stem}.svg"), ""]
    return "\n".join(parts)


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
