"""Measures of a detector on a set of flights and attacks: false alarms, recall, delay, time to act, precision."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from skyrange.core.time import NEVER, NS_PER_S
from skyrange.study.scoring.blocks import dense_codes, draw_weights, percentile_limits, ratio_interval
from skyrange.study.scoring.index import STRATA, StudyIndex
from skyrange.study.scoring.intervals import (
    Limits,
    lowest_claimable_rate,
    proportion_interval,
    rate_bound,
    rate_interval,
)
from skyrange.study.scoring.matching import Outcome
from skyrange.study.scoring.precision import precision_at, precision_interval
from skyrange.study.scoring.result_file import (
    BeforeEffect,
    Claim,
    Delay,
    Detection,
    Estimate,
    FalseAlarms,
    FalseAlarmsByFlights,
    GroupDetection,
    Precision,
    ScoreSettings,
    SetScore,
)
from skyrange.study.scoring.survival import survival_curve
from skyrange.study.scoring.thresholds import NS_PER_H


@dataclass(frozen=True, slots=True)
class Selection:
    """A set of subjects and of attacks, as masks of shape (subjects,) and (attacks,)."""

    name: str
    subjects: NDArray[np.bool_]
    attacks: NDArray[np.bool_]


def measure_set(index: StudyIndex, outcome: Outcome, selection: Selection, settings: ScoreSettings) -> SetScore:
    """All measures on a set. Raises InputError if SciPy is missing."""
    alarms = FalseAlarmsByFlights(
        **{
            name: measure_false_alarms(index, outcome, selection.subjects & (index.subjects.strata == number), settings)
            for number, name in enumerate(STRATA)
        }
    )
    nominal = alarms.nominal
    detection = measure_detection(index, outcome, selection.attacks, nominal, settings)
    groups = {
        what: tuple(
            GroupDetection(
                name=str(name),
                **dict(measure_detection(index, outcome, selection.attacks & (of == name), nominal, settings)),
            )
            for name in np.unique(of[selection.attacks])
        )
        for what, of in (("kinds", index.attacks.kinds), ("families", index.attacks.families))
    }
    where = np.flatnonzero(selection.subjects)
    return SetScore(
        name=selection.name,
        runs=len({index.subjects.runs[number] for number in where.tolist()}),
        blocks=int(np.unique(index.subjects.blocks[where]).shape[0]),
        false_alarms=alarms,
        claim=judge_claim(nominal.episodes, nominal.hours, settings.target_per_h, settings.confidence),
        detection=detection,
        kinds=groups["kinds"],
        families=groups["families"],
        precision=measure_precision(detection, nominal, settings),
    )


def measure_false_alarms(
    index: StudyIndex, outcome: Outcome, subjects: NDArray[np.bool_], settings: ScoreSettings
) -> FalseAlarms:
    """The false alarms about the subjects of a mask."""
    counts = outcome.false_alarms[subjects].astype(np.float64)
    hours = index.subjects.exposure_ns[subjects] / NS_PER_H
    count, total = int(counts.sum()), float(index.subjects.exposure_ns[subjects].sum()) / NS_PER_H
    if total <= 0.0:
        return FalseAlarms(episodes=count, hours=0.0, per_h=None)
    rate = count / total
    by_blocks = _sum_ratio(counts, hours, index.subjects.blocks[subjects], rate, settings)
    exact = rate_interval(count, total, settings.confidence)
    return FalseAlarms(episodes=count, hours=total, per_h=Estimate(value=rate, exact=exact, blocks=by_blocks))


def judge_claim(episodes: int, hours: float, target_per_h: float, confidence: float) -> Claim:
    """What `episodes` false alarms in `hours` of nominal flight show of the target rate."""
    lowest, upper = lowest_claimable_rate(hours, confidence), rate_bound(episodes, hours, confidence)
    low = rate_interval(episodes, hours, confidence)[0]
    verdict: Literal["claimed", "not shown", "exceeded", "cannot be claimed"]
    if low > target_per_h:
        verdict = "exceeded"
    elif target_per_h < lowest:
        verdict = "cannot be claimed"
    else:
        verdict = "claimed" if upper <= target_per_h else "not shown"
    return Claim(lowest_per_h=_finite(lowest), upper_per_h=_finite(upper), verdict=verdict)


def measure_detection(
    index: StudyIndex, outcome: Outcome, chosen: NDArray[np.bool_], nominal: FalseAlarms, settings: ScoreSettings
) -> Detection:
    """What was detected of the attacks of a mask; `nominal` gives the rate of alarms that hit by chance."""
    attacks = index.attacks
    seen = np.flatnonzero(chosen & attacks.observable)
    hits = outcome.detected_ns[seen] != NEVER
    detected, observable = int(hits.sum()), int(seen.shape[0])
    if not observable:
        return Detection(
            attacks=int(chosen.sum()), unobservable=int(chosen.sum()), detected=0, recall=None, by_chance=None,
            delay=None, before_effect=None,
        )  # fmt: skip
    spans_h = (attacks.end_ns[seen] - attacks.begin_ns[seen]) / NS_PER_H
    return Detection(
        attacks=int(chosen.sum()),
        unobservable=int(chosen.sum()) - observable,
        detected=detected,
        recall=_proportion(hits, attacks.blocks[seen], settings),
        by_chance=None
        if nominal.per_h is None
        else float(np.mean(-np.expm1(-nominal.per_h.value * spans_h * attacks.affected[seen]))),
        delay=measure_delay(index, outcome, seen, settings),
        before_effect=measure_before_effect(index, outcome, seen, settings),
    )


def measure_delay(index: StudyIndex, outcome: Outcome, seen: NDArray[np.int64], settings: ScoreSettings) -> Delay:
    """The delays of some observable attacks, given by index, at least one; misses are censored."""
    begins, ends = index.attacks.begin_ns[seen], index.attacks.end_ns[seen]
    found = outcome.detected_ns[seen]
    hits = found != NEVER
    delays = (np.where(hits, found, ends) - begins) / NS_PER_S
    horizon = min(settings.horizon_s, float((ends - begins).max()) / NS_PER_S)
    curve = survival_curve(delays, hits)
    median, mean = float(curve.medians_s()[0]), float(curve.restricted_means_s(horizon)[0])
    codes = dense_codes(index.attacks.blocks[seen])
    blocks = int(codes.max()) + 1
    of_median = of_mean = None
    if blocks > 1:
        weights = draw_weights(blocks, settings.replicates, settings.seed)[:, codes]
        drawn = survival_curve(delays, hits, weights)
        of_median = _limits(percentile_limits(drawn.medians_s(), median, settings.confidence))
        of_mean = percentile_limits(drawn.restricted_means_s(horizon), mean, settings.confidence)
        if math.isinf(of_median[0]):  # no replicate has a median
            of_median = None
    return Delay(
        median_s=_finite(median),
        median_blocks=of_median,
        restricted_mean_s=mean,
        restricted_mean_blocks=of_mean,
        horizon_s=horizon,
    )


def measure_before_effect(
    index: StudyIndex, outcome: Outcome, seen: NDArray[np.int64], settings: ScoreSettings
) -> BeforeEffect | None:
    """Detections before effects, of some observable attacks, given by index; None if none of them had an effect."""
    rows = seen[index.attacks.effect_ns[seen] != NEVER]
    if not rows.size:
        return None
    effects, found = index.attacks.effect_ns[rows], outcome.detected_ns[rows]
    leads_s = np.sort(np.where(found == NEVER, -math.inf, (effects - found) / NS_PER_S))
    return BeforeEffect(
        attacks=int(rows.shape[0]),
        unavoidable=int((effects <= index.attacks.begin_ns[rows]).sum()),
        share=_proportion(found < effects, index.attacks.blocks[rows], settings),
        lead_quartiles_s=(_quantile(leads_s, 0.25), _quantile(leads_s, 0.5), _quantile(leads_s, 0.75)),
    )


def measure_precision(detection: Detection, nominal: FalseAlarms, settings: ScoreSettings) -> tuple[Precision, ...]:
    """Precision at each prevalence of the settings; empty without recall or without nominal hours."""
    if detection.recall is None or nominal.per_h is None:
        return ()
    observable = detection.attacks - detection.unobservable
    return tuple(
        Precision(
            prevalence_per_h=prevalence,
            value=precision_at(prevalence, detection.recall.value, nominal.per_h.value),
            limits=precision_interval(
                prevalence, detection.detected, observable, nominal.episodes, nominal.hours, settings.confidence
            ),
        )
        for prevalence in settings.prevalences_per_h
    )


def _proportion(hits: NDArray[np.bool_], blocks: NDArray[np.int64], settings: ScoreSettings) -> Estimate:
    tops = hits.astype(np.float64)
    share = float(tops.mean())
    return Estimate(
        value=share,
        exact=proportion_interval(int(hits.sum()), hits.shape[0], settings.confidence),
        blocks=_sum_ratio(tops, np.ones_like(tops), blocks, share, settings),
    )


def _sum_ratio(
    tops: NDArray[np.float64], bottoms: NDArray[np.float64], blocks: NDArray[np.int64], ratio: float,
    settings: ScoreSettings,
) -> Limits | None:  # fmt: skip
    """The interval of `ratio`, which contains it to the last bit, in whatever order its sums were taken."""
    found = ratio_interval(tops, bottoms, blocks, settings.replicates, settings.seed, settings.confidence)
    return None if found is None else (min(found[0], ratio), max(found[1], ratio))


def _quantile(ordered: NDArray[np.float64], share: float) -> float | None:
    """The least of the `ordered` values that `share` of them do not exceed; None if it is infinite."""
    return _finite(float(ordered[math.ceil(share * ordered.shape[0]) - 1]))


def _limits(limits: Limits) -> tuple[float, float | None]:
    return limits[0], _finite(limits[1])


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
