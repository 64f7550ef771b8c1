"""Trivial detectors, which look at nothing: the floors that any detector has to be better than.

`always` alarms about each aircraft the whole time: it detects every observable attack, with the worst false-alarm rate.
`never` does not alarm. `by-time` alarms once about each aircraft, at the median onset of the attacks in training: it
shows what a study gives away by starting its attacks at much the same time.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from skyrange.core.time import NEVER, NS_PER_S
from skyrange.scoring.index import AlertList, StudyIndex, sort_alerts


def trivial_alerts(index: StudyIndex, episode_ns: int) -> dict[str, AlertList]:
    """By name, the alerts of each trivial detector; without `by-time` if no attack of the training is observable."""
    found = {"always": _alarm_always(index, episode_ns), "never": _list_alerts([])}
    begins = index.attacks.begin_ns[(index.attacks.splits == "train") & index.attacks.observable]
    if begins.size:
        onset = int(np.sort(begins)[(begins.size - 1) // 2])
        flights = np.flatnonzero(index.subjects.duration_ns > 0).tolist()
        found["by-time"] = _list_alerts([(flight, np.array([onset])) for flight in flights])
    return dict(sorted(found.items()))


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
