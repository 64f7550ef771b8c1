"""Detections by chance: the alarms of flights without an attack, replayed against attacks with other onsets.

An alarm that stands all the time detects everything, and so do its replays. A rate alone does not tell: alarms come in
bursts, at take-off for example, and attacks begin at certain times.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.scoring.index import NOMINAL_STRATUM, AlertList, StudyIndex

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
    found = np.full(len(attacks.runs), math.nan)
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
        own = [one for subject in affected
               for one in by_place.get((int(subjects.clusters[subject]), subjects.vehicles[subject]), ())]  # fmt: skip
        own = own or [one for one in by_split.get(split, ()) if len(affected) > 1 or subjects.vehicles[one]]
        if not own:
            continue
        begins = chance.choice(onsets[split], SHUFFLES)
        ends = begins + (attacks.end_ns[number] - attacks.begin_ns[number])
        flights: dict[str, list[int]] = {}
        for one in own:
            name = subjects.runs[one] if len(affected) > 1 else f"{subjects.runs[one]} {subjects.vehicles[one]}"
            flights.setdefault(name, []).append(one)
        found[number] = np.mean([_any_hit(alarms, bounds, flight, begins, ends) for flight in flights.values()])
    return found


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
