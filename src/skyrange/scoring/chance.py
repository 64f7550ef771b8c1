"""Floors of scores: what alarms detect by chance, and trivial detectors, which look at nothing.

`always` alarms about each aircraft the whole time: it detects every observable attack, with the worst false-alarm rate.
`never` does not alarm. `by-time` alarms once about each aircraft, at the median onset of the attacks in training: it
shows what a study gives away by starting its attacks at much the same time.

An alarm that stands all the time detects everything, and so do its replays. A rate alone does not tell: alarms come in
bursts, at take-off for example, and attacks begin at certain times.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.core.time import NEVER, NS_PER_S
from skyrange.scoring.index import NOMINAL_STRATUM, AlertList, StudyIndex, sort_alerts


def trivial_alerts(index: StudyIndex, episode_ns: int) -> dict[str, AlertList]:
    """By name, the alerts of each trivial detector; without `by-time` if no attack of the training is observable."""
    alerts_by_name = {"always": _alarm_always(index, episode_ns), "never": _list_alerts([])}
    begins = index.attacks.begin_ns[(index.attacks.splits == "train") & index.attacks.observable]
    if begins.size:
        onset = int(np.sort(begins)[(begins.size - 1) // 2])
        flights = np.flatnonzero(index.subjects.duration_ns > 0).tolist()
        alerts_by_name["by-time"] = _list_alerts([(flight, np.array([onset])) for flight in flights])
    return dict(sorted(alerts_by_name.items()))


def _alarm_always(index: StudyIndex, episode_ns: int) -> AlertList:
    """Of an alarm that never ends, the alerts that matter: where episodes and windows begin, and one in each second, so
    that a window anywhere has one.
    """
    windows, durations = index.windows, index.subjects.duration_ns
    last_ns = int(windows.end_ns.max(initial=0)) + 1  # airborne time has no beginning: a window may end after it
    flights = np.flatnonzero(durations > 0).tolist()
    parts = [
        (flight, _multiples(0, max(int(durations[flight]), last_ns), step))
        for flight in flights
        for step in (episode_ns, NS_PER_S)
    ]
    for subject, begin, end in zip(
        windows.subjects.tolist(), windows.begin_ns.tolist(), windows.end_ns.tolist(), strict=True
    ):
        if durations[subject] > 0:
            parts.append((subject, _multiples(end + 1, int(durations[subject]), episode_ns)))
        if index.subjects.vehicles[subject] and begin != NEVER:
            parts.append((subject, np.array([begin])))
    return _list_alerts(parts)


def _multiples(begin: int, end: int, step: int) -> NDArray[np.int64]:
    return begin + step * np.arange(max(0, -(-(end - begin) // step)), dtype=np.int64)


def _list_alerts(parts: list[tuple[int, NDArray[np.int64]]]) -> AlertList:
    subjects = [np.full(times.shape[0], subject, dtype=np.int64) for subject, times in parts]
    none = np.zeros(0, dtype=np.int64)
    times_ns = np.concatenate([none, *(times for _, times in parts)])
    return sort_alerts(np.concatenate([none, *subjects]), times_ns, np.full(times_ns.shape[0], math.inf))


SHUFFLES: Final = 50
"""Onsets at which the window of each attack is replayed."""


def share_hit_by_chance(index: StudyIndex, alerts: AlertList, threshold: float, seed: int) -> NDArray[np.float64]:
    """(attacks,) the share of onsets at which an alarm of a nominal flight is in the window of an attack; alarms are
    alerts with a score above `threshold`.

    The flights are the nominal ones of the attack's cluster with the same aircraft; where there is none, those of the
    same split. The onsets are drawn from those of the attacks in the same split, by `seed`. NaN for an attack that
    cannot be observed and where there is no nominal flight.
    """
    above = alerts.scores > threshold
    alarms = AlertList(alerts.subjects[above], alerts.times_ns[above], alerts.scores[above])
    attacks, subjects, windows = index.attacks, index.subjects, index.windows
    shares = np.full(len(attacks.runs), math.nan)
    chance = np.random.Generator(np.random.Philox(seed))
    bounds = np.searchsorted(alarms.subjects, np.arange(len(subjects.runs) + 1))
    quiet = subjects.strata == NOMINAL_STRATUM
    by_place: dict[tuple[int, str], list[int]] = {}
    by_split: dict[str, list[int]] = {}
    for number in np.flatnonzero(quiet).tolist():
        by_place.setdefault((int(subjects.clusters[number]), subjects.vehicles[number]), []).append(number)
        by_split.setdefault(str(subjects.splits[number]), []).append(number)
    onsets = {
        split: np.sort(attacks.begin_ns[(attacks.splits == split) & attacks.observable])
        for split in np.unique(attacks.splits).tolist()
    }
    firsts = np.searchsorted(windows.attacks, np.arange(len(attacks.runs) + 1))
    for number in np.flatnonzero(attacks.observable).tolist():
        affected = windows.subjects[firsts[number] : firsts[number + 1]].tolist()
        split = str(attacks.splits[number])
        nominal_flights = [
            nominal
            for subject in affected
            for nominal in by_place.get((int(subjects.clusters[subject]), subjects.vehicles[subject]), ())
        ]
        nominal_flights = nominal_flights or [
            nominal for nominal in by_split.get(split, ()) if len(affected) > 1 or subjects.vehicles[nominal]
        ]
        if not nominal_flights:
            continue
        begins = chance.choice(onsets[split], SHUFFLES)
        ends = begins + (attacks.end_ns[number] - attacks.begin_ns[number])
        flights: dict[str, list[int]] = {}
        for nominal in nominal_flights:
            name = (
                subjects.runs[nominal]
                if len(affected) > 1
                else f"{subjects.runs[nominal]} {subjects.vehicles[nominal]}"
            )
            flights.setdefault(name, []).append(nominal)
        shares[number] = np.mean([_any_hit(alarms, bounds, flight, begins, ends) for flight in flights.values()])
    return shares


def _any_hit(
    alarms: AlertList, bounds: NDArray[np.int64], subjects: list[int], begins: NDArray[np.int64],
    ends: NDArray[np.int64],
) -> NDArray[np.bool_]:  # fmt: skip
    """Whether an alarm about any of `subjects` is in each window."""
    hit = np.zeros(len(begins), dtype=np.bool_)
    for subject in subjects:
        times = alarms.times_ns[bounds[subject] : bounds[subject + 1]]
        if times.size:
            place = np.searchsorted(times, begins)
            hit |= (place < times.size) & (times[np.minimum(place, times.size - 1)] <= ends)
    return hit
