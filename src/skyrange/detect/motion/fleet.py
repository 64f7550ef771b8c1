"""Fleet consistency detector: the telemetry of the aircraft of one ground station, against each other.

It reads GLOBAL_POSITION_INT, which the stream profiles `light` and `operator` both carry. A fleet is the aircraft whose
links end at one ground station; with one aircraft only `replayed` can be found. The residuals, of each aircraft:

- `common_step`: positions step against their velocities, as in `motion.consistency`, in several aircraft within 2 s and
  in directions that differ by less than 60°. A GNSS spoofer or a meaconer moves all receivers in its range alike, while
  the errors of two aircraft are independent. The statistic is the residual of the m-th aircraft in order of size, over
  5 standard deviations; m is two, or `share` of the fleet.
- `same_place`: two aircraft in flight report places within 2 m horizontally and 1.5 m vertically (a 5-inch to 15-inch
  multirotor each, and no separation) for 2 s. Positions are taken to one time by their velocities.
- `replayed`: a moving aircraft (above 0.5 m/s) reports a position and velocity that it or another one has reported up
  to ten minutes before, digit by digit (1 cm and 1 cm/s each). Four in a row score 1. A frame that was duplicated
  within 2 s does not count.
- `lost_together`: no telemetry from m aircraft for 5 s (ArduPilot's timeout of a ground station, `FS_GCS_TIMEOUT`), and
  the last of each came within 2 s of the others'. A jammer or a failure of the station causes it; the score is their
  number over m.

It cannot detect a slow common drift that every estimator follows, one aircraft of many that is attacked, or a replay
with altered digits. Aircraft that land at one place, wait and take off in turn are not reported, because they are not
in flight.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil
from typing import ClassVar, Final

import numpy as np

import skyrange.plugin as sky
from skyrange.core import elementwise, matrices
from skyrange.detect.series import Flags, Floats, grown, offset_m, step_errors

COMMON_STEP, SAME_PLACE, REPLAYED, LOST_TOGETHER = "common_step", "same_place", "replayed", "lost_together"
_FIELDS: Final = ("lat", "lon", "alt", "relative_alt", "vx", "vy", "vz")
_STEP_SIGMAS: Final = 5.0
_TOGETHER_S: Final = 2.0
_ALIKE: Final = 0.5
"""Cosine of 60°."""
_GAP_S: Final = 30.0
_NEAR_M, _NEAR_UP_M = 2.0, 1.5
_NEAR_S: Final = 2.0
_AIRBORNE_M: Final = 2.0
_MOVING_CMPS: Final = 50.0
_REMEMBERED_S: Final = 300.0
_RUN: Final = 4.0
_BROKEN_RUN: Final = -0.25
_SILENT_S: Final = 5.0


@sky.detector("motion.fleet")
class FleetConsistency(sky.TelemetryDetector):
    """Compares the aircraft of a fleet: common steps, one place for two, replayed telemetry, links lost together.

    Each aircraft concerned is the subject of an alert of its own. `data` has their number where several are concerned.
    """

    residuals: ClassVar = (COMMON_STEP, SAME_PLACE, REPLAYED, LOST_TOGETHER)

    share: sky.Number = sky.param(
        "Share of the aircraft of a ground station, but at least two, that steps or losses have in common.",
        default=0.3, gt=0.0, le=1.0,
    )  # fmt: skip
    position: sky.Series = sky.series("GLOBAL_POSITION_INT", *_FIELDS)
    seen_s: Floats = sky.table(dtype=np.float64)
    """(ends,) when telemetry arrived last; NaN before any has."""
    steps: Floats = sky.table(4, dtype=np.float64)
    """Of each link end's largest step within 2 s: when, size in standard deviations, direction east and north."""
    near_s: Floats = sky.table(dtype=np.float64)
    """(ends,) since when another aircraft is at the same place; NaN if none is."""
    told: dict[bytes, tuple[int, float]] = sky.state(dict)
    told_before: dict[bytes, tuple[int, float]] = sky.state(dict)
    """Reports → link end and time: since `turned_s`, and of the `_REMEMBERED_S` before."""
    turned_s: float = 0.0

    def compare(self, now: sky.Time, frames: sky.ObservedFrames) -> Sequence[sky.Alert]:
        """Compare the aircraft of each ground station."""
        count = len(frames.ports)
        self.seen_s, self.near_s = grown(self.seen_s, count, np.nan), grown(self.near_s, count, np.nan)
        self.steps = grown(self.steps, count)
        steps = self.position.read(frames)
        self.seen_s[steps.places] = steps.at_ns / sky.NS_PER_S
        now_s = now / sky.NS_PER_S
        self._take_steps(now_s, steps)
        alerts = self._find_replayed(frames, now_s, steps)
        stations = np.unique([port.endpoint for port in frames.ports], return_inverse=True)[1]
        for station in range(int(stations.max(initial=-1)) + 1):
            fleet = np.flatnonzero((stations == station) & np.isfinite(self.seen_s))
            if len(fleet) >= 2:
                alerts += self._find_common_steps(frames, now, fleet)
                alerts += self._find_same_place(frames, now, fleet)
                alerts += self._find_lost(frames, now, fleet)
        return alerts

    def _members(self, fleet: sky.Ints) -> int:
        return max(2, ceil(self.share * len(fleet)))

    def _take_steps(self, now_s: float, steps: sky.Steps) -> None:
        self.steps[self.steps[:, 0] < now_s - _TOGETHER_S] = 0.0
        rows = np.flatnonzero((steps.seconds > 0.0) & (steps.seconds <= _GAP_S))
        if not len(rows):
            return
        errors, spread = step_errors(steps.before[rows], steps.after[rows], steps.seconds[rows])
        size = elementwise.hypot(errors[:, 0], errors[:, 1])
        order = np.argsort(size, kind="stable")  # the largest of a link end is written last
        places, unit = steps.places[rows][order], errors[order, :2] / np.maximum(size[order], 1e-9)[:, None]
        new_steps = np.column_stack([steps.at_ns[rows][order] / sky.NS_PER_S, (size / spread)[order], unit])
        larger = new_steps[:, 1] > self.steps[places, 1]
        self.steps[places[larger]] = new_steps[larger]

    def _find_common_steps(self, frames: sky.ObservedFrames, now: sky.Time, fleet: sky.Ints) -> list[sky.Alert]:
        sizes, directions = self.steps[fleet, 1], self.steps[fleet, 2:]
        alike = matrices.multiply(directions, directions[np.argmax(sizes)]) >= _ALIKE
        sizes = np.where(alike, sizes, 0.0)
        members = self._members(fleet)
        common = np.sort(sizes)[-members] / _STEP_SIGMAS
        scores = np.where(sizes / _STEP_SIGMAS >= common, common, 0.0)
        number = np.full(len(fleet), float(np.count_nonzero(scores)))
        return self.alerts(COMMON_STEP, frames, fleet, now, scores, aircraft=number)

    def _find_same_place(self, frames: sky.ObservedFrames, now: sky.Time, fleet: sky.Ints) -> list[sky.Alert]:
        values = self.position.values[fleet]
        age = now / sky.NS_PER_S - self.seen_s[fleet]
        flying = (values[:, 3] > _AIRBORNE_M * 1e3) & (age <= _TOGETHER_S)
        self.near_s[fleet[~flying]] = np.nan
        fleet, values, age = fleet[flying], values[flying], age[flying]
        if len(fleet) < 2:
            return []
        first = np.broadcast_to(values[0, :2], (len(fleet), 2))
        east, north = offset_m(first[:, 0], first[:, 1], values[:, 0], values[:, 1])
        east, north = east + values[:, 5] * 1e-2 * age, north + values[:, 4] * 1e-2 * age
        up = values[:, 2] * 1e-3 - values[:, 6] * 1e-2 * age
        near = _has_neighbour(east, north, up)
        since = self.near_s[fleet]
        self.near_s[fleet] = np.where(near, np.where(np.isfinite(since), since, now / sky.NS_PER_S), np.nan)
        scores = np.nan_to_num((now / sky.NS_PER_S - self.near_s[fleet]) / _NEAR_S)
        return self.alerts(SAME_PLACE, frames, fleet, now, np.minimum(scores, 10.0))

    def _find_replayed(self, frames: sky.ObservedFrames, now_s: float, steps: sky.Steps) -> list[sky.Alert]:
        if now_s - self.turned_s >= _REMEMBERED_S:
            self.told_before, self.told, self.turned_s = self.told, {}, now_s
        rows = np.flatnonzero(np.abs(steps.after[:, 4:6]).max(axis=1, initial=0.0) >= _MOVING_CMPS)
        reports, told, before = steps.after[rows].astype(np.int64), self.told, self.told_before
        terms = np.zeros(len(rows))
        places, times = steps.places[rows].tolist(), (steps.at_ns[rows] / sky.NS_PER_S).tolist()
        for number, (place, time_s) in enumerate(zip(places, times, strict=True)):
            report = reports[number].tobytes()
            known = told.get(report) or before.get(report)
            if known is None:
                told[report] = (place, time_s)
            is_duplicate = known is not None and known[0] == place and time_s - known[1] <= _TOGETHER_S
            terms[number] = _BROKEN_RUN if known is None else 0.0 if is_duplicate else 1.0
        scores = self.accumulate(REPLAYED, steps.places[rows], terms, _RUN)
        return self.alerts(REPLAYED, frames, steps.places[rows], steps.at_ns[rows], scores)

    def _find_lost(self, frames: sky.ObservedFrames, now: sky.Time, fleet: sky.Ints) -> list[sky.Alert]:
        last = self.seen_s[fleet]
        silent = now / sky.NS_PER_S - last > _SILENT_S
        times = np.sort(last[silent])
        number = np.searchsorted(times, last + _TOGETHER_S, "right") - np.searchsorted(times, last - _TOGETHER_S)
        scores = np.where(silent & (number >= 2), number / self._members(fleet), 0.0)
        return self.alerts(LOST_TOGETHER, frames, fleet, now, scores, aircraft=number.astype(np.float64))


def _has_neighbour(east: Floats, north: Floats, up: Floats) -> Flags:
    """Whether each of n places, in metres, has another one near it; compares each with those near it to the east."""
    order = np.argsort(east, kind="stable")
    east, north, up = east[order], north[order], up[order]
    near = np.zeros(len(order), dtype=np.bool_)
    for shift in range(1, len(order)):
        apart = east[shift:] - east[:-shift]
        if not (apart <= _NEAR_M).any():
            break
        close = elementwise.hypot(apart, north[shift:] - north[:-shift]) <= _NEAR_M
        close &= np.abs(up[shift:] - up[:-shift]) <= _NEAR_UP_M
        near[shift:] |= close
        near[:-shift] |= close
    has_neighbour = np.zeros_like(near)
    has_neighbour[order] = near
    return has_neighbour
