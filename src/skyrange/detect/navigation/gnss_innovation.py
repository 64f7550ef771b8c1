"""GNSS innovation detector: how far satellite fixes are from what the estimator expects.

It reads EKF_STATUS_REPORT (ArduPilot) or ESTIMATOR_STATUS (PX4), GPS_RAW_INT, GLOBAL_POSITION_INT and SYSTEM_TIME. The
stream profile `operator` carries them. `light` has no innovations, and no fixes of its own: with Remote ID, the
companion requests GPS_RAW_INT at 1 Hz and SYSTEM_TIME every 5 s, which arrive at the ground station as well.

The residuals:

- `velocity`, `position`, `height`: the innovation test ratios of the estimator, which it rejects from 1 on (the gates
  EK3_VEL_I_GATE, EK3_POS_I_GATE and EK3_HGT_I_GATE of ArduPilot's EKF3). A false fix within the gates raises them for
  as long as it pulls. Each is standardised by its own past (`self_starting`), because tuning and receiver set its
  level, and a CUSUM of what exceeds 2 standard deviations is compared with 40, which the reversals of course of 100
  nominal aircraft reached once in 70 s. Detection of spoofing by innovations accumulated over time, as against single
  ones, is analysed by Y. Liu, S. Li, Q. Fu, Z. Liu and Q. Zhou, "Analysis of Kalman Filter Innovation-Based GNSS
  Spoofing Detection Method for INS/GNSS Integrated Navigation System", IEEE Sensors Journal 19 (2019), p. 5167-5178;
  the self-starting CUSUM is that of Hawkins (1987).
- `offset`, `speed`: fixes against the fused position and velocity, over the accuracies that the receiver claims. The
  mean of the squares over 5 s (a windowed chi-square test) is compared with 9, three standard deviations. A claimed
  accuracy counts up to 10 m and 1 m/s: a spoofer may claim any.
- `accuracy`: no fix, or claimed accuracies that differ from their own past by more than a factor of two, for 5 s. The
  threshold is above the interruptions of up to 3 s that a receiver in a city has.
- `time`: SYSTEM_TIME against the clock of the ground station, over 2 s: a telemetry link delays by less than a second.

It cannot detect false fixes which the estimator follows without an innovation (a slow drift that begins at speed 0),
fixes that are false from the start, and false telemetry that is consistent. It reports multipath and a failing sensor
as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import ClassVar, Final

import numpy as np

import skyrange.plugin as sky
from skyrange.contracts.frames import Ints
from skyrange.core import elementary_python, elementwise
from skyrange.detect.sensor_values import fix_errors
from skyrange.detect.series import Floats, MovingMean, grown, rounds

_LEAST: Final = 20
"""Values before which there is no result."""
_MOST: Final = 600
"""Values after which old ones are forgotten: 200 s at 3 Hz."""
_OUTSIDE: Final = 4.0
"""Standard deviations from which on a value does not enter the mean."""
_LARGEST: Final = 8.0
"""Greatest result, so that one value alone does not reach a threshold."""


class SelfStarting:
    """Mean and deviation of one quantity at every link end.

    After D. M. Hawkins, "Self-starting CUSUM Charts for Location and Scale", The Statistician 36 (1987), p. 299-315:
    mean and deviation are those of all values so far, so that no flight for training is needed. Here values far outside
    do not enter them, and old values are forgotten, so that a slow change of conditions raises no alert.
    """

    def __init__(self, floor: float) -> None:
        """`floor` is the least standard deviation, in units of the quantity."""
        self._floor = floor
        self._moments: Floats = np.zeros((0, 3))
        """Number, mean and variance of the values."""

    def standardise(self, places: Ints, values: Floats) -> Floats:
        """The (n,) deviations of new values at link ends from what was before them; 0 while too few are known.

        Values of one call are compared with those of earlier calls.
        """
        self._moments = grown(self._moments, int(places.max(initial=-1)) + 1)
        number, mean, variance = self._moments[places].T
        deviations = (values - mean) / np.maximum(np.sqrt(variance), self._floor)
        deviations = np.where(number >= _LEAST, np.minimum(deviations, _LARGEST), 0.0)
        inside = np.flatnonzero(np.abs(deviations) < _OUTSIDE)
        for rows in rounds(places[inside]):
            at = places[inside[rows]]
            number, mean, variance = self._moments[at].T
            number = np.minimum(number + 1.0, _MOST)
            away = values[inside[rows]] - mean
            mean = mean + away / number
            variance = variance + (away * (values[inside[rows]] - mean) - variance) / number
            self._moments[at] = np.column_stack([number, mean, np.maximum(variance, 0.0)])
        return deviations


RATIOS: Final = ("velocity", "position", "height")
OFFSET, SPEED, ACCURACY, TIME = "offset", "speed", "accuracy", "time"
_ARDUPILOT: Final = ("velocity_variance", "pos_horiz_variance", "pos_vert_variance")
_PX4: Final = ("vel_ratio", "pos_horiz_ratio", "pos_vert_ratio")
_FIX: Final = ("lat", "lon", "vel", "cog", "h_acc", "vel_acc", "fix_type", "time_usec")
_FUSED: Final = ("lat", "lon", "vx", "vy")
_RATIO_FLOOR: Final = 0.02
"""Least standard deviation of a ratio: 0.1 of a standard deviation of the innovation, at gates of 5."""
_SQUARES: Final = 9.0
_SQUARES_S: Final = 5.0
_FUSED_M: Final = 1.0
"""Error of the fused position besides that of the fix."""
_FUSED_MPS: Final = 0.5
"""That of the fused velocity: fix and estimate differ in age by some 0.15 s, at up to 3 m/s²."""
_UNKNOWN_M, _UNKNOWN_MPS = 2.5, 0.5
"""Accuracies where the receiver claims none."""
_MOST_M, _MOST_MPS = 10.0, 1.0
_FIX_3D: Final = 3
_AGE_S: Final = 1.5
"""Greatest difference of the times of a fix and of the estimate that is compared with it."""
_DOUBLE: Final = elementary_python.log(2.0)
_ACCURACY_S: Final = 5.0
_GAP_S: Final = 2.0
_CLOCK_SET_US: Final = 1e15
"""Unix time, September 2001: an autopilot's clock is below it until a fix or a ground station sets it."""


@sky.detector("navigation.gnss_innovation")
class GnssInnovation(sky.TelemetryDetector):
    """Compares satellite fixes with the estimate: innovations, offsets, accuracies and time of GNSS."""

    residuals: ClassVar = (*RATIOS, OFFSET, SPEED, ACCURACY, TIME)

    allowance: sky.Number = sky.param(
        "Deviation of an innovation test ratio from its past that adds nothing to its CUSUM, in standard deviations.",
        default=2.0, ge=0.0, le=100.0,
    )  # fmt: skip
    threshold: sky.Number = sky.param(
        "CUSUM of a test ratio, in standard deviations, that scores 1.", default=40.0, gt=0.0, le=1e6
    )
    clock_s: sky.Number = sky.param(
        "Difference of SYSTEM_TIME from the ground station's clock that scores 1, in seconds.",
        default=2.0, gt=0.0, le=1e6,
    )  # fmt: skip
    unix_ns: int
    """UTC of time 0."""
    ardupilot: sky.Series = sky.series("EKF_STATUS_REPORT", *_ARDUPILOT, timed=False)
    px4: sky.Series = sky.series("ESTIMATOR_STATUS", *_PX4, timed=False)
    fixes: sky.Series = sky.series("GPS_RAW_INT", *_FIX, timed=False)
    fused: sky.Series = sky.series("GLOBAL_POSITION_INT", *_FUSED)
    time: sky.Series = sky.series("SYSTEM_TIME", "time_unix_usec")
    normal: list[SelfStarting]
    offsets: MovingMean = sky.state(partial(MovingMean, _SQUARES_S, 0.0))
    speeds: MovingMean = sky.state(partial(MovingMean, _SQUARES_S, 0.0))
    accuracy: MovingMean = sky.state(partial(MovingMean, 60.0))

    def prepare(self, context: sky.DetectorContext) -> None:
        self.unix_ns = context.epoch.unix_ns
        self.normal = [SelfStarting(_RATIO_FLOOR) for _ in RATIOS]

    def compare(self, now: sky.Time, frames: sky.ObservedFrames) -> Sequence[sky.Alert]:
        """Judge ratios, fixes, accuracies and times."""
        self.fused.read(frames)
        alerts = []
        for ratios, power in ((self.ardupilot, 1.0), (self.px4, 0.5)):
            steps = ratios.read(frames)
            alerts += self._judge_ratios(frames, steps, elementwise.power(np.maximum(steps.after, 0.0), power))
        fixes = self.fixes.read(frames)
        alerts += self._judge_fixes(frames, fixes)
        alerts += self._judge_accuracy(frames, fixes)
        return alerts + self._judge_time(frames, self.time.read(frames))

    def _judge_ratios(self, frames: sky.ObservedFrames, steps: sky.Steps, ratios: Floats) -> list[sky.Alert]:
        alerts: list[sky.Alert] = []
        for column, name in enumerate(RATIOS):
            ratio = ratios[:, column]
            away = self.normal[column].standardise(steps.places, ratio)
            scores = self.accumulate(name, steps.places, away - self.allowance, self.threshold)
            alerts += self.alerts(name, frames, steps.places, steps.at_ns, scores, ratio=ratio)
        return alerts

    def _judge_fixes(self, frames: sky.ObservedFrames, steps: sky.Steps) -> list[sky.Alert]:
        fix, fused = steps.after, self.fused.values[steps.places]
        age = fix[:, 7] * 1e-6 - self.fused.time_s[steps.places]
        rows = np.flatnonzero((fix[:, 6] >= _FIX_3D) & (np.abs(age) <= _AGE_S))
        fix, fused, age = fix[rows], fused[rows], age[rows]
        places, at_ns, seconds = steps.places[rows], steps.at_ns[rows], steps.seconds[rows]
        position, velocity = fix_errors(fix, fused, age)
        away, slip = (
            elementwise.hypot(position[:, 0], position[:, 1]),
            elementwise.hypot(velocity[:, 1], velocity[:, 0]),
        )
        alerts: list[sky.Alert] = []
        for name, error, claimed, unknown, most, own_error, mean in (
            (OFFSET, away, fix[:, 4], _UNKNOWN_M, _MOST_M, _FUSED_M, self.offsets),
            (SPEED, slip, fix[:, 5], _UNKNOWN_MPS, _MOST_MPS, _FUSED_MPS, self.speeds),
        ):
            accuracy = np.where(claimed > 0.0, np.minimum(claimed * 1e-3, most), unknown)
            squares = np.minimum(elementary_python.square(error / elementwise.hypot(accuracy, own_error)), 1e6)
            scores = mean.add(places, np.minimum(seconds, _GAP_S), squares) / _SQUARES
            alerts += self.alerts(name, frames, places, at_ns, scores, difference=error)
        return alerts

    def _judge_accuracy(self, frames: sky.ObservedFrames, steps: sky.Steps) -> list[sky.Alert]:
        claimed = elementwise.log(np.maximum(steps.after[:, 4], 1.0))
        fixed = steps.after[:, 6] >= _FIX_3D
        known = np.where(fixed & (steps.after[:, 4] > 0.0), claimed, np.nan)
        usual = self.accuracy.add(steps.places, np.minimum(steps.seconds, _GAP_S), known)
        wrong = np.where(fixed, np.abs(known - usual) - _DOUBLE, 1.0)
        lost = np.where(fixed | np.isfinite(usual), wrong, 0.0)
        excess = lost * np.minimum(steps.seconds, _GAP_S)
        scores = self.accumulate(ACCURACY, steps.places, excess, _ACCURACY_S)
        h_acc_m, fix_type = steps.after[:, 4] * 1e-3, steps.after[:, 6]
        return self.alerts(ACCURACY, frames, steps.places, steps.at_ns, scores, h_acc_m=h_acc_m, fix_type=fix_type)

    def _judge_time(self, frames: sky.ObservedFrames, steps: sky.Steps) -> list[sky.Alert]:
        rows = np.flatnonzero(steps.after[:, 0] >= _CLOCK_SET_US)
        at_ns = steps.at_ns[rows]
        error = steps.after[rows, 0] * 1e-6 - (self.unix_ns / sky.NS_PER_S + at_ns / sky.NS_PER_S)
        scores = np.abs(error) / self.clock_s
        return self.alerts(TIME, frames, steps.places[rows], at_ns, scores, ahead_s=error)
