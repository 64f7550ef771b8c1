"""Model card: what a model is for, what it was trained on, how well it did, and where it must not be trusted.

The sections are those of M. Mitchell and others, "Model Cards for Model Reporting", FAT* 2019, p. 220-229.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from skyrange.core.files import atomic_write
from skyrange.detect.learned.model_file import ISOLATION_FOREST, ModelFile
from skyrange.detect.window_features import FEATURES
from skyrange.scoring.result_file import DetectorScore, Estimate, ScoreFile, SetScore

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
        f"{training[key]:,} {what}"
        for key, what in (
            ("nominal_windows", "nominal windows"),
            ("benign_windows", "benign windows"),
            ("attacked_windows", "attacked windows"),
        )
        if key in training
    ]
    held = scores.held_out
    out = [
        f"- held-out {what}: {_join(values)}"
        for what, values in (
            ("families", held.families),
            ("kinds", held.kinds),
            ("cities", held.cities),
            ("fleet sizes", held.aircraft),
        )
        if values
    ]
    told = f"{' and '.join(counts)} of {training.get('blocks')} blocks, the training part of the study."
    kinds = []
    if model.algorithm != ISOLATION_FOREST:
        told += (
            " Windows that arms of a block share count once. In an attacked run only windows in which the attack acts "
            "on the aircraft are used."
        )
        kinds = [f"- kinds of attack: {_join(training.get('kinds', ()))}"]
    places = [
        f"- cities: {_join(training.get('cities', ()))}",
        f"- fleet sizes: {_join(training.get('aircraft', ()))}",
    ]
    return "\n".join(["## Training data", "", told, "", *kinds, *places, *out])


def _describe_factors(model: ModelFile) -> str:
    about = {one.name: one.about for one in FEATURES}
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
        f"| `{one.name}` | {one.attacks} | {_estimate(one.recall)} | {_estimate(lasting.recall)} |"
        for one, lasting in zip(score.sets[0].kinds, score.effect_sets[0].kinds, strict=True)
    ]
    return "\n".join(lines)


def _score_row(one: SetScore, lasting: SetScore) -> str:
    alarms = one.false_alarms
    recalls = (_estimate(one.detection.recall), _estimate(lasting.detection.recall))
    numbers = (*recalls, _estimate(alarms.nominal.per_h), _estimate(alarms.fault.per_h))
    return f"| {one.name} | {one.detection.attacks} | {' | '.join(numbers)} | {one.claim.verdict} |"


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


def _estimate(one: Estimate | None) -> str:
    if one is None:
        return ""
    low, high = one.clustered or one.exact
    return f"{one.value:.2f} ({low:.2f} to {'∞' if high is None else f'{high:.2f}'})"


def _share(value: float | None) -> str:
    return "" if value is None else f"{100 * value:.1f} %"


def _join(values: object) -> str:
    found = [str(value) or "(open ground)" for value in values]  # type: ignore[attr-defined]
    return ", ".join(found) or "none"
