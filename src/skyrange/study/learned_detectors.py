"""Learned detectors of a study, trained on its training blocks and applied to all its runs, and their model cards.

The sections are those of M. Mitchell and others, "Model Cards for Model Reporting", FAT* 2019, p. 220-229.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa

from skyrange.core.errors import InputError
from skyrange.core.files import atomic_write
from skyrange.core.parquet_files import read_table
from skyrange.core.time import NS_PER_S, from_seconds
from skyrange.detect.learned.model_file import ISOLATION_FOREST, Model, ModelFile, write_model
from skyrange.detect.learned.windows import LearnedWindows
from skyrange.detect.series import Floats
from skyrange.detect.window_features import FEATURES, NAMES
from skyrange.scoring.result_file import DetectorScore, Estimate, ScoreFile, SetScore
from skyrange.scoring.tables import ALERTS, NOMINAL, StudyTables
from skyrange.study.detector_training import train
from skyrange.study.feature_windows import SCHEMA, WINDOWS, find_distinct, label_windows
from skyrange.study.folder import KEPT, StudyFolder

_TITLES: Final = {
    "isolation_forest": "isolation forest (Liu, Ting, Zhou, ICDM 2008)",
    "gradient_boosting": "gradient-boosted trees (Ke and others, NIPS 2017)",
}


def write_model_card(name: str, model: ModelFile, score: DetectorScore, scores: ScoreFile, path: Path) -> None:
    """Write the card of a model, in Markdown."""
    with atomic_write(path) as file:
        file.write(format_model_card(name, model, score, scores).encode())


def format_model_card(name: str, model: ModelFile, score: DetectorScore, scores: ScoreFile) -> str:
    """The card of a model, in Markdown: its training, its scores on the test blocks, and its limits."""
    parts = [
        _describe(name, model),
        _describe_training(model, scores),
        _describe_factors(model),
        _describe_scores(score, scores),
        _describe_limits(model),
    ]
    return "\n\n".join(parts) + "\n"


def _describe(name: str, model: ModelFile) -> str:
    training = model.training
    learns = "nominal flights alone" if model.algorithm == ISOLATION_FOREST else "attacked and benign windows by label"
    return f"""# Model card: {name}

| | |
|---|---|
| algorithm | {_TITLES[model.algorithm]} |
| input | {len(model.features)} features of windows of {model.window_s:g} s at an end of a MAVLink link |
| output | the odds {"that the window is an anomaly" if model.algorithm == ISOLATION_FOREST else "of an attack"}; \
an alert above {model.threshold:.6g} |
| learns | {learns} |
| library | {training.get("library")} with {_list_settings(model)}, seed {training.get("seed")} |
| made by | {training.get("software")} from the study `{training.get("study")}` (digest `{training.get("digest")}`) |

## Intended use

A baseline with which detectors are compared, in studies of skyrange. Use it in a scenario with

```toml
[[detectors]]
id = "{name}"
kind = "learned.windows"
params = {{ file = "{name}.json" }}
```

It is not made for aircraft outside of a simulation: it has never seen one."""


def _list_settings(model: ModelFile) -> str:
    return ", ".join(f"{key} {value}" for key, value in model.training.get("settings", {}).items())


def _describe_training(model: ModelFile, scores: ScoreFile) -> str:
    training = model.training
    counts = [
        f"{training[key]:,} {label}"
        for key, label in (
            ("nominal_windows", "nominal windows"),
            ("benign_windows", "benign windows"),
            ("attacked_windows", "attacked windows"),
        )
        if key in training
    ]
    held_out = scores.held_out
    out = [
        f"- held-out {axis}: {_join(values)}"
        for axis, values in (
            ("families", held_out.families),
            ("kinds", held_out.kinds),
            ("cities", held_out.cities),
            ("fleet sizes", held_out.aircraft),
        )
        if values
    ]
    text = f"{' and '.join(counts)} of {training.get('blocks')} blocks, the training part of the study."
    kinds = []
    if model.algorithm != ISOLATION_FOREST:
        text += (
            " Windows that arms of a block share count once. In an attacked run only windows in which the attack acts "
            "on the aircraft are used."
        )
        kinds = [f"- kinds of attack: {_join(training.get('kinds', ()))}"]
    places = [
        f"- cities: {_join(training.get('cities', ()))}",
        f"- fleet sizes: {_join(training.get('aircraft', ()))}",
    ]
    return "\n".join(["## Training data", "", text, "", *kinds, *places, *out])


def _describe_factors(model: ModelFile) -> str:
    about = {feature.name: feature.about for feature in FEATURES}
    gains = model.training.get("gain", {})
    rows = [f"| `{name}` | {about.get(name, '')} | {_share(gains.get(name))} |" for name in model.features]
    head = "## Features\n\nA feature of a message that did not arrive in the window is missing"
    if model.fill is not None:
        rows = [
            f"| `{name}` | {about.get(name, '')} | {value:.4g} |"
            for name, value in zip(model.features, model.fill, strict=True)
        ]
        return "\n".join(
            [
                f"{head}; the median of the training stands for it.",
                "",
                "| feature | meaning | median |",
                "|---|---|---|",
                *rows,
            ]
        )
    return "\n".join(
        [
            f"{head}. The gain is its share of what the splits gained.",
            "",
            "| feature | meaning | gain |",
            "|---|---|---|",
            *rows,
        ]
    )


def _describe_scores(score: DetectorScore, scores: ScoreFile) -> str:
    threshold = score.threshold
    assert threshold is not None
    rate, reached = scores.settings.target_per_h, threshold.reached
    lines = [
        "## Scores",
        "",
        f"On the test blocks, which neither training nor the choice of the threshold used. The threshold is the lowest "
        f"with at most {rate:g} false alarms per aircraft-hour on the validation flights: {reached.episodes} in "
        f"{reached.hours:.2f} aircraft-hours, {_estimate(reached.per_h)} per hour. Intervals are those of "
        f"{100 * scores.settings.confidence:g} % over clusters of flights that share a seed. An "
        'alarm detects an attack until its last act, and in the columns "effect" until its effect ends.',
        "",
        "| set | attacks | recall | recall, effect | false alarms per hour, nominal | of faults | target rate |",
        "|---|---|---|---|---|---|---|",
    ]
    lines += [_score_row(*both) for both in zip(score.sets, score.effect_sets, strict=True)]
    lines += ["", "| kind of attack | attacks | recall | recall, effect |", "|---|---|---|---|"]
    lines += [
        f"| `{kind.name}` | {kind.attacks} | {_estimate(kind.recall)} | {_estimate(lasting.recall)} |"
        for kind, lasting in zip(score.sets[0].kinds, score.effect_sets[0].kinds, strict=True)
    ]
    return "\n".join(lines)


def _score_row(score: SetScore, lasting: SetScore) -> str:
    alarms = score.false_alarms
    recalls = (_estimate(score.detection.recall), _estimate(lasting.detection.recall))
    numbers = (*recalls, _estimate(alarms.nominal.per_h), _estimate(alarms.fault.per_h))
    return f"| {score.name} | {score.detection.attacks} | {' | '.join(numbers)} | {score.claim.verdict} |"


def _describe_limits(model: ModelFile) -> str:
    alone = (
        "- It finds what is rare, not what is hostile: gusts, outages and unusual plans are anomalies as well."
        if model.algorithm == ISOLATION_FOREST
        else "- It has learned the kinds of attack above. Scores on held-out families tell what it does with others."
    )
    return f"""## Limits

{alone}
- It sees one window of one link. Attacks that are slow, or that show only in several aircraft at once, it cannot see.
- All data are simulated, with the plans, links, streams and autopilots of the study. Another stream profile changes
  most features.
- The adversaries of the study do not know the model. One who does can stay below its threshold."""


def _estimate(estimate: Estimate | None) -> str:
    if estimate is None:
        return ""
    low, high = estimate.clustered or estimate.exact
    return f"{estimate.value:.2f} ({low:.2f} to {'∞' if high is None else f'{high:.2f}'})"


def _share(value: float | None) -> str:
    return "" if value is None else f"{100 * value:.1f} %"


def _join(values: object) -> str:
    texts = [str(value) or "(open ground)" for value in values]  # type: ignore[attr-defined]
    return ", ".join(texts) or "none"


MODELS: Final = "models"
"""Folder of the models of a study, and of their cards."""
LEAST_ODDS: Final = 1e-12
"""The threshold of a model of which all windows are alarms."""


class Learned(NamedTuple):
    """The learned detectors of a study."""

    models: dict[str, ModelFile]
    """By the name of the detector."""
    alerts: pa.Table
    """One alert for each window of each run and detector; the score is the odds that the model gives."""


def learn_detectors(folder: StudyFolder, tables: StudyTables) -> Learned:
    """Train the learned detectors on the blocks of the split `train`, and apply them to all runs of `tables`.

    Raises `InputError` if there are too few windows, or a library is missing.
    """
    learned = folder.study.learned
    assert learned is not None
    runs = {row["run"]: row for row in tables.flights.to_pylist()}
    windows = _read_windows(folder, runs)
    features = np.column_stack([windows.column(name).to_numpy() for name in NAMES])
    acts: dict[str, list[dict[str, Any]]] = {row["run"]: [] for row in runs.values() if row["hostile"]}
    for row in tables.attacks.to_pylist():
        acts[row["run"]].append({"vehicle": row["vehicle"], "first_s": row["active_s"], "last_s": row["stop_s"]})
    intruded_s: dict[str, float] = {}
    for row in tables.intrusions.to_pylist():
        intruded_s[row["run"]] = min(row["active_s"], intruded_s.get(row["run"], math.inf))
    labels = label_windows(windows, acts, intruded_s, from_seconds(learned.window_s))
    names = windows.column("run").to_pylist()
    nominal = np.array([runs[run]["arm"] == NOMINAL for run in names], dtype=np.bool_)
    training = np.array([runs[run]["split"] == "train" for run in names], dtype=np.bool_)
    training &= find_distinct([runs[run]["cluster"] for run in names], windows, features, nominal)
    seed = folder.study.first_seed
    models, alerts = {}, []
    for name, algorithm in learned.names.items():
        model = train(algorithm, features[training], labels[training], nominal[training], seed, float(learned.window_s))
        models[name] = model
        alerts.append(_list_alerts(name, windows, Model(model).predict(features)))
    return Learned(models, pa.concat_tables(alerts))


def write_models(folder: StudyFolder, learned: Learned, tables: StudyTables, scores: ScoreFile) -> list[Path]:
    """Write the models with the thresholds that scoring chose, each with its model card; returns the models' files."""
    target = folder.path / MODELS
    target.mkdir(exist_ok=True)
    training = [row for row in tables.flights.to_pylist() if row["split"] == "train"]
    runs = {row["run"] for row in training}
    about = {
        "study": folder.study.name,
        "digest": scores.digest,
        "software": scores.software,
        "blocks": len({row["block"] for row in training}),
        "kinds": sorted({row["kind"] for row in tables.attacks.to_pylist() if row["run"] in runs}),
        "cities": sorted({row["city"] for row in training}),
        "aircraft": sorted({row["aircraft"] for row in training}),
    }
    written = []
    for name, model in learned.models.items():
        score = next(detector for detector in scores.detectors if detector.detector == name)
        assert score.threshold is not None
        chosen = score.threshold.value
        threshold = LEAST_ODDS if chosen is None else max(chosen, LEAST_ODDS)
        file = model.model_copy(update={"threshold": threshold, "training": {**model.training, **about}})
        write_model(file, target / f"{name}.json")
        write_model_card(name, file, score, scores, target / f"{name}.md")
        written.append(target / f"{name}.json")
    return written


def _read_windows(folder: StudyFolder, runs: dict[str, dict[str, Any]]) -> pa.Table:
    """The windows of all runs, with a column of the run's name."""
    tables = []
    for run in sorted(runs):
        path = folder.path / KEPT / WINDOWS / runs[run]["block"] / f"{runs[run]['arm']}.parquet"
        try:
            table = read_table(path, str(folder.path), str(path.relative_to(folder.path)), SCHEMA)
        except InputError as error:
            hint = "Delete the block's file in the folder blocks, and resume the study."
            raise InputError(error.who, [replace(problem, hint=hint) for problem in error.problems]) from error
        tables.append(table.append_column("run", pa.repeat(pa.scalar(run), table.num_rows)))
    return pa.concat_tables(tables)


def _list_alerts(name: str, windows: pa.Table, odds: Floats) -> pa.Table:
    count = windows.num_rows
    columns = {
        "run": windows.column("run"),
        "detector": pa.repeat(pa.scalar(name), count),
        "time_s": pa.array(windows.column("time_ns").to_numpy() / NS_PER_S),
        "subject": windows.column("vehicle"),
        "kind": pa.repeat(pa.scalar(LearnedWindows.name), count),
        "score": pa.array(odds),
    }
    return pa.table(columns).select(ALERTS.names).cast(ALERTS)
