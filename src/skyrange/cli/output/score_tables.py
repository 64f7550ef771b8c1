"""Leaderboard of detectors on the terminal: scores on the whole test, and on held-out and seen parts of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from rich.table import Table

    from skyrange.scoring.leaderboard import LeaderboardRow
    from skyrange.scoring.result_file import DetectorScore, ScoreFile, SetScore

_ALL: Final = "all"
_REDUCED: Final = "reduced"
_HELD, _SEEN = "held-out", "seen"
_AXES: Final = ("families", "cities", "fleet sizes", "kinds")
"""What can be held out, as the names of sets say it."""
_BY_FLIGHT: Final = ("cities", "fleet sizes")
"""Of these, what restricts the flights, so that false alarms differ too."""


def tabulate_scores(files: Sequence[ScoreFile]) -> Iterator[Table]:
    """The tables of result files: scores on the test, the same while effects last, then recall and false alarms on
    held-out and seen parts of it.

    What was held out is that of the first file. Raises `InputError` for files that do not compare.
    """
    from skyrange.scoring.leaderboard import rank_detectors

    first = files[0]
    rows = rank_detectors(files, _ALL)
    table = _begin(f"{first.study}: scores on the test split")
    heads = ("", "detector", "at equal rate", "recall", "by chance", "false per h", "of faults", "delay, s", "in time")
    for head in heads:
        table.add_column(head, no_wrap=head in ("", "detector"))
    for row in rows:
        rank = "–" if row.rank is None else str(row.rank)
        at_rate = f"{_share(row.equal_rate_recall)}\nat {_rate(row.equal_rate_per_h)}"
        shares = at_rate, _share(row.recall), _share(row.by_chance)
        rates = _rate_with_limits(row), _rate(row.fault_false_per_h), _rate(row.median_delay_s)
        table.add_row(rank, _name(row), *shares, *rates, _share(row.before_effect))
    table.caption = _describe(files)
    table.caption_justify = "left"
    yield table
    yield _tabulate_effect_scores(first.study, rows)
    scores = {(number, detector.detector): detector for number, file in enumerate(files) for detector in file.detectors}
    ordered = [scores[row.file, row.detector] for row in rows]
    if any(on.harmless_intrusions.intrusions for detector in ordered if (on := detector.on(_ALL)) is not None):
        yield _tabulate_intrusions(first.study, ordered)
    axes = [axis for axis in _AXES if any(detector.on(f"{_HELD} {axis}") for detector in ordered)]
    if _AXES[0] in axes:
        axes = axes[:-1] if axes[-1] == _AXES[-1] else axes  # kinds of these families, and what the draw left out
    if not axes:
        return
    parts = [f"{part} {axis}" for axis in axes for part in (_HELD, _SEEN)]
    held_out = (first.held_out.families, first.held_out.cities, map(str, first.held_out.aircraft), first.held_out.kinds)
    named = [f"{axis}: {', '.join(names)}" for axis, names in zip(_AXES, held_out, strict=True) if axis in axes]
    table = _begin(f"{first.study}: recall, detected of attacks; new is held out: {'; '.join(named)}")
    _add_heads(table, parts)
    for detector in ordered:
        table.add_row(_name(detector), *(_recall(detector.on(part)) for part in parts))
    yield table
    parts = [f"{part} {axis}" for axis in axes if axis in _BY_FLIGHT for part in (_HELD, _SEEN)]
    if parts:
        table = _begin(f"{first.study}: false alarms per aircraft-hour of nominal flight")
        _add_heads(table, parts)
        for detector in ordered:
            table.add_row(_name(detector), *(_false(detector.on(part)) for part in parts))
        yield table


def _tabulate_effect_scores(study: str, rows: Sequence[LeaderboardRow]) -> Table:
    """What differs if the window of an attack ends with its effect, and not with its last act."""
    table = _begin(f"{study}: scores while effects last, against windows that end with the last act")
    table.add_column("detector", no_wrap=True)
    for head in ("recall", "acts", "by chance", "delay, s", "false per h of attacked runs", "acts"):
        table.add_column(head)
    for row in rows:
        table.add_row(
            _name(row), _share(row.effect_recall), _share(row.recall), _share(row.effect_by_chance),
            _rate(row.effect_median_delay_s), _rate(row.effect_hostile_false_per_h), _rate(row.hostile_false_per_h),
        )  # fmt: skip
    return table


def _tabulate_intrusions(study: str, detectors: Sequence[DetectorScore]) -> Table:
    """How many harmless intrusions each detector reports, which are neither detections nor false alarms."""
    table = _begin(f"{study}: alarms about harmless intrusions, neither detections nor false alarms")
    for head in ("detector", "reported", "of"):
        table.add_column(head, no_wrap=True)
    for detector in detectors:
        on = detector.on(_ALL)
        if on is not None:
            intrusions = on.harmless_intrusions
            table.add_row(_name(detector), str(intrusions.reported), str(intrusions.intrusions))
    return table


def _describe(files: Sequence[ScoreFile]) -> str:
    """What a reader has to know of the numbers."""
    settings, first = files[0].settings, files[0]
    sentences = [
        f"Rank, at equal rate: each detector with the threshold for at most {settings.target_per_h:g} per h on the "
        "nominal test flights. Other columns: with that of the validation flights, at the rates in the table.",
        f"Limits are {100 * settings.confidence:g} %, if the coefficient of variation of rates between clusters is "
        f"{settings.variation:g}.",
    ]
    on = first.detectors[0].on(_ALL) if first.detectors else None
    if on is not None:
        sentences.append(f"The test split has {on.runs} runs in {on.clusters} independent clusters.")
    if first.repeated_runs:
        sentences.append(f"{first.repeated_runs} runs are the same flight as another one, and do not count.")
    lacks = {detector.detector: detector.reduced for file in files for detector in file.detectors if detector.reduced}
    if lacks:
        sentences.append(
            f"{_REDUCED}: not the method as published. " + " ".join(f"{name}: {lacks[name]}." for name in lacks)
        )
    return "\n".join(sentences)


def _name(of: LeaderboardRow | DetectorScore) -> str:
    """The name of a detector, with a mark if it is reduced."""
    return f"{of.detector}\n({_REDUCED})" if of.reduced else of.detector


def _rate_with_limits(row: LeaderboardRow) -> str:
    limits = row.false_clustered or row.false_exact
    if row.false_per_h is None or limits is None:
        return "–"
    high = "∞" if limits[1] is None else f"{limits[1]:.3g}"
    return f"{row.false_per_h:.3g}\n{limits[0]:.2g}–{high}"


def _begin(title: str) -> Table:
    from rich.table import Table

    return Table(title=title, title_justify="left", title_style="bold")


def _add_heads(table: Table, parts: Sequence[str]) -> None:
    """The names of parts, short enough for a terminal of 80 columns."""
    table.add_column("detector", no_wrap=True)
    for part in parts:
        table.add_column(part.replace(_HELD, "new").replace(" sizes", "s").replace(" ", "\n"))


def _recall(score: SetScore | None) -> str:
    if score is None or score.detection.recall is None:
        return "–"
    detection = score.detection
    return f"{_share(score.detection.recall.value)}\n{detection.detected}/{detection.attacks - detection.unobservable}"


def _false(score: SetScore | None) -> str:
    if score is None or score.false_alarms.nominal.per_h is None:
        return "–"
    return _rate(score.false_alarms.nominal.per_h.value)


def _share(value: float | None) -> str:
    return "–" if value is None else f"{100.0 * value:.0f} %"


def _rate(value: float | None) -> str:
    return "–" if value is None else f"{value:.3g}"
