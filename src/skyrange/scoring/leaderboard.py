"""Leaderboard: the detectors of one or several result files as rows of a table, the best first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from skyrange.core.errors import InputError, Problem
from skyrange.scoring.result_file import DetectorScore, OpenLimits, ScoreFile, SetScore


@dataclass(frozen=True, slots=True)
class LeaderboardRow:
    """One detector on one set. Rates are per aircraft-hour, times in seconds; None where there is no such value."""

    rank: int | None
    """From 1, by recall at a rate that is the same for all; equal if nothing tells the detectors apart. None where they
    cannot be compared, because the set has no attacks or no nominal hours.
    """
    detector: str
    study: str
    file: int
    """Number of its result file, from 0."""
    trivial: bool
    reduced: str
    """What it lacks of the published method that it is named after; "" for nothing. Print a mark with its rank."""
    same_study: bool
    """Whether it was scored on the same flights and attacks as the first file."""
    recall: float | None
    recall_exact: OpenLimits | None
    recall_clustered: OpenLimits | None
    equal_rate_recall: float | None
    """Recall at the threshold that keeps to the target rate on the nominal flights of this set."""
    equal_rate_per_h: float | None
    """The rate that is reached with it: at most the target."""
    by_chance: float | None
    false_per_h: float | None
    false_exact: OpenLimits | None
    false_clustered: OpenLimits | None
    fault_false_per_h: float | None
    claim: str
    median_delay_s: float | None
    mean_delay_s: float | None
    """Restricted to the horizon; misses included."""
    before_effect: float | None
    effect_recall: float | None
    """With windows that last as long as effects."""
    effect_recall_exact: OpenLimits | None
    effect_by_chance: float | None
    effect_median_delay_s: float | None
    hostile_false_per_h: float | None
    """Of attacked runs, outside of attacks."""
    effect_hostile_false_per_h: float | None
    """Of attacked runs, outside of attacks and their effects."""


def rank_detectors(files: Sequence[ScoreFile], name: str = "all") -> list[LeaderboardRow]:
    """The detectors on the set `name` by recall at the target rate of false alarms, which each keeps to with a
    threshold of its own for this set; ties by restricted mean delay, then by name. Detectors that cannot be compared
    come last.

    With the thresholds that were chosen on other flights rates differ, and so recalls do not compare. Raises InputError
    if the files differ in settings, so that their numbers do not compare, or if none has the set.
    """
    problems = [
        Problem(
            f"file {number + 1}, settings", str(score_file.settings), f"those of the first file, {files[0].settings}"
        )
        for number, score_file in enumerate(files)
        if score_file.settings != files[0].settings
    ]
    if problems:
        raise InputError("leaderboard", problems)
    entries = [
        (number, score, on)
        for number, file in enumerate(files)
        for score in file.detectors
        if (on := score.on(name)) is not None
    ]
    if not entries:
        known = sorted({score_set.name for file in files for score in file.detectors for score_set in score.sets})
        raise InputError.one("leaderboard", "set", name, f"one of {', '.join(known)}" if known else "files with scores")
    entries.sort(key=lambda entry: (*_place(entry[2]), entry[1].detector, files[entry[0]].study))
    rows: list[LeaderboardRow] = []
    for position, (number, score, on) in enumerate(entries):
        tied = position > 0 and _place(entries[position - 1][2]) == _place(on)
        rank = None if on.equal_rate is None else rows[-1].rank if tied else position + 1
        rows.append(_row(rank, files, number, score, on))
    return rows


def _place(score: SetScore) -> tuple[bool, float, float]:
    at = score.equal_rate
    return (True, 0.0, 0.0) if at is None else (False, -at.recall, at.restricted_mean_s)


def _row(
    rank: int | None, files: Sequence[ScoreFile], number: int, score: DetectorScore, on: SetScore
) -> LeaderboardRow:
    recall, delay, before = on.detection.recall, on.detection.delay, on.detection.before_effect
    nominal, fault, hostile = on.false_alarms.nominal.per_h, on.false_alarms.fault.per_h, on.false_alarms.hostile.per_h
    effect = score.effect_on(on.name)
    lasting = effect.detection if effect else None
    quieter = effect.false_alarms.hostile.per_h if effect else None
    return LeaderboardRow(
        rank=rank,
        detector=score.detector,
        study=files[number].study,
        file=number,
        trivial=score.trivial,
        reduced=score.reduced,
        same_study=files[number].digest == files[0].digest,
        recall=recall.value if recall else None,
        recall_exact=recall.exact if recall else None,
        recall_clustered=recall.clustered if recall else None,
        equal_rate_recall=on.equal_rate.recall if on.equal_rate else None,
        equal_rate_per_h=on.equal_rate.per_h if on.equal_rate else None,
        by_chance=on.detection.by_chance,
        false_per_h=nominal.value if nominal else None,
        false_exact=nominal.exact if nominal else None,
        false_clustered=nominal.clustered if nominal else None,
        fault_false_per_h=fault.value if fault else None,
        claim=on.claim.verdict,
        median_delay_s=delay.median_s if delay else None,
        mean_delay_s=delay.restricted_mean_s if delay else None,
        before_effect=before.share.value if before else None,
        effect_recall=lasting.recall.value if lasting and lasting.recall else None,
        effect_recall_exact=lasting.recall.exact if lasting and lasting.recall else None,
        effect_by_chance=lasting.by_chance if lasting else None,
        effect_median_delay_s=lasting.delay.median_s if lasting and lasting.delay else None,
        hostile_false_per_h=hostile.value if hostile else None,
        effect_hostile_false_per_h=quieter.value if quieter else None,
    )
