"""Scoring of detectors on a study: from its tables to the result file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

import skyrange
from skyrange.core.errors import InputError
from skyrange.core.time import from_seconds
from skyrange.scoring.chance import share_hit_by_chance, trivial_alerts
from skyrange.scoring.detector_measures import Selection, measure_false_alarms, measure_set
from skyrange.scoring.index import AlertList, StudyIndex, index_alerts, index_study
from skyrange.scoring.matching import choose_threshold, match_alarms
from skyrange.scoring.result_file import DetectorScore, HeldOut, ScoreFile, ScoreSettings, SetScore, Threshold
from skyrange.scoring.tables import TRIVIAL, StudyTables, keep_each_flight_once
from skyrange.statistics.exact_intervals import lowest_claimable_rate


def score_detectors(
    tables: StudyTables,
    settings: ScoreSettings | None = None,
    detectors: Sequence[str] | None = None,
    study: str = "",
    reduced: Mapping[str, str] | None = None,
) -> ScoreFile:
    """Scores of `detectors` (by default of those that raised alerts) and of the trivial ones, on the test flights.

    Name detectors that may have raised no alert at all: they are scored too. `reduced` says by name what a detector
    lacks of the published method that it is named after. Raises InputError if there are no test
    flights, no validation flights to choose thresholds from, or if SciPy is missing.
    """
    settings = ScoreSettings() if settings is None else settings
    names = sorted(set(tables.detectors() if detectors is None else detectors))
    for name in names:
        if not name or name in TRIVIAL:
            raise InputError.one("scoring", "detectors", name, f"a name that is none of {', '.join(TRIVIAL)}")
    tables, repeated = keep_each_flight_once(tables)
    index, lasting = (index_study(tables, settings.grace_s, window) for window in ("acts", "effect"))
    if not (index.subjects.splits == "test").any():
        raise InputError.one("tables of the study", "flights, split test", "none", "flights to score detectors on")
    held_out = find_held_out(index)
    selections = select_sets(index, held_out)
    episode_ns = from_seconds(settings.episode_s)
    scores = [
        _score_one(index, lasting, index_alerts(index, tables.alerts, name), name, selections, settings).model_copy(
            update={"reduced": (reduced or {}).get(name, "")}
        )
        for name in names
    ]
    trivial = [
        trivial_alerts(each_index, episode_ns) for each_index in (index, lasting)
    ]  # `always` alarms where windows begin
    for name in trivial[0]:
        sets, effect_sets = (
            _measure_sets(each_index, alerts[name], -math.inf, selections, settings)
            for each_index, alerts in zip((index, lasting), trivial, strict=True)
        )
        scores.append(DetectorScore(detector=name, trivial=True, threshold=None, sets=sets, effect_sets=effect_sets))
    return ScoreFile(
        study=study,
        digest=index.digest,
        software=f"skyrange {skyrange.__version__}",
        settings=settings,
        held_out=held_out,
        repeated_runs=repeated,
        detectors=tuple(sorted(scores, key=lambda score: score.detector)),
    )


def find_held_out(index: StudyIndex) -> HeldOut:
    """What occurs in the test part, but neither in training nor in validation."""
    flights, attacks = index.subjects, index.attacks
    test, tests = flights.splits == "test", attacks.splits == "test"
    return HeldOut(
        kinds=tuple(np.setdiff1d(attacks.kinds[tests], attacks.kinds[~tests]).tolist()),
        families=tuple(np.setdiff1d(attacks.families[tests], attacks.families[~tests]).tolist()),
        cities=tuple(np.setdiff1d(flights.cities[test], flights.cities[~test]).tolist()),
        aircraft=tuple(np.setdiff1d(flights.aircraft[test], flights.aircraft[~test]).tolist()),
    )


def select_sets(index: StudyIndex, held_out: HeldOut) -> list[Selection]:
    """The sets to score on: all of the test part; and, of what was held out, the held-out part beside the seen one.

    Kinds and families restrict the attacks, not the flights: false alarms have no kind.
    """
    flights, attacks = index.subjects, index.attacks
    test, tests = flights.splits == "test", attacks.splits == "test"
    selections = [Selection("all", test, tests)]
    for what, values, of in (
        ("kinds", held_out.kinds, attacks.kinds),
        ("families", held_out.families, attacks.families),
    ):
        if values:
            new = np.isin(of, values)
            selections += [
                Selection(f"held-out {what}", test, tests & new),
                Selection(f"seen {what}", test, tests & ~new),
            ]
    for what, held_values, of_flights, of_attacks in (
        ("cities", held_out.cities, flights.cities, attacks.cities),
        ("fleet sizes", held_out.aircraft, flights.aircraft, attacks.aircraft),
    ):
        if held_values:
            new, newly = np.isin(of_flights, held_values), np.isin(of_attacks, held_values)
            selections += [
                Selection(f"held-out {what}", test & new, tests & newly),
                Selection(f"seen {what}", test & ~new, tests & ~newly),
            ]
    return selections


def _measure_sets(
    index: StudyIndex, alerts: AlertList, threshold: float, selections: list[Selection], settings: ScoreSettings
) -> tuple[SetScore, ...]:
    outcome = match_alarms(index, alerts, threshold, from_seconds(settings.episode_s))
    chances = share_hit_by_chance(index, alerts, threshold, settings.seed)
    return tuple(measure_set(index, alerts, outcome, chances, selection, settings) for selection in selections)


def _score_one(
    index: StudyIndex,
    lasting: StudyIndex,
    alerts: AlertList,
    name: str,
    selections: list[Selection],
    settings: ScoreSettings,
) -> DetectorScore:
    """The scores of one detector; `lasting` is the index with windows that last as long as effects."""
    episode_ns = from_seconds(settings.episode_s)
    choice = choose_threshold(index, alerts, settings.target_per_h, episode_ns)
    reached = measure_false_alarms(index, choice.episodes, choice.used, settings)
    return DetectorScore(
        detector=name,
        trivial=False,
        threshold=Threshold(
            value=None if math.isinf(choice.threshold) else choice.threshold,
            reached=reached,
            lowest_per_h=lowest_claimable_rate(reached.hours, settings.confidence),
        ),
        sets=_measure_sets(index, alerts, choice.threshold, selections, settings),
        effect_sets=_measure_sets(lasting, alerts, choice.threshold, selections, settings),
    )
