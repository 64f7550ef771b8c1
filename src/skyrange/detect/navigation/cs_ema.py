"""CS-EMA detector: small lasting innovations of satellite fixes, barometer and magnetometer.

It reads GPS_RAW_INT, GLOBAL_POSITION_INT, SCALED_PRESSURE, RAW_IMU and ATTITUDE. The stream profile `operator` carries
them. `light` has no fixes of its own: with Remote ID the companion requests them at 1 Hz, and they alone are judged.

The algorithm is CS-EMA of Y. Wang, C. Sun, Q. Liu, B. Su, Z. Zhang, M. Norris, G. Tan and J. Ma, "VIMU: Effective
Physics-based Realtime Detection and Recovery against Stealthy Attacks on UAVs", ACSAC 2024 (arXiv 2504.20569), in the
form of its authors' implementation (github.com/wangwwno1/Project-VIMU, `src/lib/fault_detector`). For each axis of a
sensor, r is the innovation over its standard deviation:

- CUSUM: S = max(0, S + |r| - b), an alarm above a limit;
- EMA: M = (1 - λ) M + λ min(max(r, -R), R), an alarm if |M| is above a limit. It finds a bias below b, which never
  raises S; the clip R keeps a large error, which S finds, from filling M.

| sensor | least standard deviation | b | limit of S | λ | R | limit of M |
|---|---|---|---|---|---|---|
| `position` of fixes | 0.5 m | 0.5 | 3 | 0.01 | 0.85 | 0.45 |
| `velocity` of fixes | 0.3 m/s | 1 | none | 0.01 | 1.1 | 0.5 |
| `barometer` | 3.5 m | 0.25 | 3 | 0.05 | 0.52 | 0.15 |
| `magnetometer` | 0.05 gauss | 0.25 | 3 | 0.01 | 0.52 | 0.3 |

All values are those that the authors set for their evaluation (README of the repository; b of the velocity is its
default, for no CUSUM is used there). As there, a claimed accuracy of a fix counts if it is larger, the height of a
fix has 1.5 times as much, and heights count from the first fix on.

The differences to VIMU:

- It runs at the ground station on what telemetry carries. The charts are updated with each message (2 Hz), not with
  each sample of the sensor, so delays in seconds are longer; in samples they are the same.
- The reference is the autopilot's own estimate, not one by a model of motors and airframe ("virtual IMU"), whose
  inputs telemetry does not carry at its rate. So gyroscopes and accelerometers are not judged. For the magnetometer,
  the field and the bias of the compass are estimated as PX4 does (`FieldReference`), turned by ATTITUDE.
- VIMU adds the variance of the reference. Telemetry does not report that of position, velocity and height; there the
  variance of the measurement is taken, which it does not exceed while the estimator uses the sensor.
- Heights of fixes are not judged by default (`heights`): their errors change by metres within a minute, and with the
  published limits an alarm was raised in each of twenty nominal flights.
- S is cut at 10 limits, in VIMU at 1.05, so that higher thresholds can be evaluated. There is no recovery.

It cannot detect fixes that the estimate follows without a lasting innovation (`gnss.drift`), sensors that were false
from the first message on, and errors within a claimed accuracy. It reports multipath and failing sensors as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import ClassVar, Final, NamedTuple

import numpy as np

import skyrange.plugin as sky
from skyrange.contracts.frames import Ints
from skyrange.core import elementwise
from skyrange.detect.bases import MOST_SCORE
from skyrange.detect.sensor_values import fix_errors, pressure_altitude_m
from skyrange.detect.series import Floats, grown, rounds

NOISE_GAUSS: Final = 0.05
"""EKF2_MAG_NOISE, its default: of a measurement, and of the states at the beginning."""
_GROWTH: Final = np.repeat([1e-8, 1e-10], 3)
"""Growth of variances in gauss²/s: EKF2_MAG_E_NOISE and EKF2_MAG_B_NOISE, 1e-3 and 1e-4 gauss/s, in steps of 10 ms."""
_MOST_S: Final = 60.0


class FieldReference:
    """Estimates of the magnetic field that each aircraft should measure, of all link ends.

    Each end at most once in a call; its first field begins the estimate. A Kalman filter with six states for each link
    end, as the magnetic states of PX4's EKF2: the field north, east and down, and the bias forward, right and down,
    both nearly constant. Attitudes are taken as exact.
    """

    def __init__(self) -> None:
        self._states: Floats = np.zeros((0, 6))
        self._covariances: Floats = np.zeros((0, 6, 6))

    def predict(self, places: Ints, fields: Floats, turns: Floats, seconds: Floats) -> Floats:
        """Innovations (n, 3) of fields in the body frame, in standard deviations of each.

        `fields` are (n, 3) in gauss; `turns` are (n, 3, 3), from the body to north, east and down; `seconds` since the
        last field of the end, which may be NaN.
        """
        count = int(places.max(initial=-1)) + 1
        self._states = grown(self._states, count, np.nan)
        self._covariances = grown(self._covariances, count)
        fresh = np.flatnonzero(np.isnan(self._states[places, 0]))
        ends = places[fresh]
        self._states[ends, :3] = (turns[fresh] * fields[fresh, None, :]).sum(axis=2)
        self._states[ends, 3:] = 0.0
        self._covariances[ends] = np.eye(6) * (NOISE_GAUSS * NOISE_GAUSS)
        growth = np.clip(np.nan_to_num(seconds), 0.0, _MOST_S)
        self._covariances[places] += growth[:, None, None] * np.diag(_GROWTH)
        ratios = np.empty((len(places), 3))
        for axis in range(3):
            innovation, variance, _ = self._compare(places, fields, turns, axis)
            ratios[:, axis] = innovation / np.sqrt(variance)
        return ratios

    def update(self, places: Ints, fields: Floats, turns: Floats) -> None:
        """Fuse fields, one axis after another."""
        for axis in range(3):
            innovation, variance, cross = self._compare(places, fields, turns, axis)
            gain = cross / variance[:, None]
            self._states[places] += gain * innovation[:, None]
            self._covariances[places] -= gain[:, :, None] * cross[:, None, :]

    def _compare(self, places: Ints, fields: Floats, turns: Floats, axis: int) -> tuple[Floats, Floats, Floats]:
        """Of one axis: (n,) innovations, their (n,) variances, and their (n, 6) covariances with the states."""
        row = np.concatenate([turns[:, :, axis], np.broadcast_to(np.eye(3)[axis], (len(places), 3))], axis=1)
        cross = (self._covariances[places] * row[:, None, :]).sum(axis=2)
        innovation = fields[:, axis] - (self._states[places] * row).sum(axis=1)
        return innovation, (cross * row).sum(axis=1) + (NOISE_GAUSS * NOISE_GAUSS), cross


def turns_to_earth(roll: Floats, pitch: Floats, yaw: Floats) -> Floats:
    """The (n, 3, 3) matrices from the body frame (forward, right, down) to north, east and down, by angles in rad."""
    (cr, cp, cy), (sr, sp, sy) = (
        (elementwise.cos(a) for a in (roll, pitch, yaw)),
        (elementwise.sin(a) for a in (roll, pitch, yaw)),
    )
    rows = (
        (cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy),
        (cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy),
        (-sp, sr * cp, cr * cp),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


class Chart(NamedTuple):
    """The design of the charts of a sensor; all but `weight` in standard deviations of the innovation."""

    weight: float
    """λ, the weight of a new value in the moving average."""
    cap: float
    """R, the greatest absolute value that enters the moving average."""
    ema_limit: float
    """The control limit of the moving average; 0 leaves it out."""
    shift: float
    """b, the part of an absolute value that the CUSUM does not add."""
    cusum_limit: float
    """The control limit of the CUSUM; 0 leaves it out."""


class CsEma:
    """The charts of the axes of one sensor at every link end."""

    def __init__(self, chart: Chart, axes: int) -> None:
        self._chart = chart
        self._sums: Floats = np.zeros((0, axes))
        self._means: Floats = np.zeros((0, axes))

    def add(self, places: Ints, ratios: Floats) -> tuple[Floats, Floats]:
        """Take in innovations at link ends; returns the statistics after each, over their limits.

        `places` are (n,) link ends, and rows of one end are in order of time. `ratios` are (n, axes) finite
        innovations in standard deviations. Returns the CUSUM and the absolute moving average, (n, axes) each; 0 where
        the chart is left out.
        """
        chart, count = self._chart, int(places.max(initial=-1)) + 1
        self._sums, self._means = grown(self._sums, count), grown(self._means, count)
        sums, means = np.zeros(ratios.shape), np.zeros(ratios.shape)
        capped = np.clip(ratios, -chart.cap, chart.cap)
        excess = np.abs(ratios) - chart.shift
        for rows in rounds(places):
            at = places[rows]
            if chart.cusum_limit > 0.0:
                kept = np.clip(self._sums[at] + excess[rows] / chart.cusum_limit, 0.0, MOST_SCORE)
                self._sums[at] = sums[rows] = kept
            if chart.ema_limit > 0.0:
                self._means[at] = (1.0 - chart.weight) * self._means[at] + chart.weight * capped[rows]
                means[rows] = np.abs(self._means[at]) / chart.ema_limit
        return sums, means


SENSORS: Final = ("position", "velocity", "barometer", "magnetometer")
CHARTS: Final = ("cusum", "ema")
_POSITION_M, _VELOCITY_MPS, _BAROMETER_M = 0.5, 0.3, 3.5
"""EKF2_GPS_P_NOISE, EKF2_GPS_V_NOISE and EKF2_BARO_NOISE of the authors."""
_VERTICAL: Final = 1.5
_STATE: Final = float(np.sqrt(2.0))
"""Standard deviation of an innovation over that of the measurement, if the reference is as uncertain."""
_MOST_RATIO: Final = 1e6
_MOST_GAUSS: Final = 100.0
_AGE_S: Final = 1.5
"""Greatest difference of the times of a measurement and of the estimate that is compared with it."""
_ATTITUDE_AGE_S: Final = 0.15
"""The same for the magnetometer: more than an interval of ATTITUDE at 10 Hz."""
_SPAN_S: Final = 2.0**26
"""More than the time since boot, whole as a float beside the number of a link end: two years."""
_FIX_3D: Final = 3
_FIX: Final = ("lat", "lon", "vel", "cog", "alt", "h_acc", "v_acc", "vel_acc", "fix_type", "time_usec")
_FUSED: Final = ("lat", "lon", "vx", "vy", "vz", "alt")
_ATTITUDE: Final = ("roll", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed")


def _limit(default: float, sensor: str, chart: str) -> sky.Number:
    limit: sky.Number = sky.param(
        f"Limit of the {chart} of the {sensor}, in standard deviations, that scores 1; 0 leaves it out.",
        default=default, ge=0.0, le=1e6,
    )  # fmt: skip
    return limit


class _First:
    """The first value of a quantity at each link end."""

    def __init__(self, axes: int) -> None:
        self._values: Floats = np.zeros((0, axes))

    def keep(self, places: sky.Ints, values: Floats) -> Floats:
        """The (n, axes) first values of the link ends of (n, axes) new ones, which are in order of time."""
        self._values = grown(self._values, int(places.max(initial=-1)) + 1, np.nan)
        ends, rows = np.unique(places, return_index=True)
        fresh = np.isnan(self._values[ends, 0])
        self._values[ends[fresh]] = values[rows[fresh]]
        first: Floats = self._values[places]
        return first


@sky.detector(
    "navigation.cs_ema",
    reduced="VIMU runs on board at the rate of sensors, against a model of motors and airframe; this is at the "
    "station, at the rate of telemetry (2 Hz), against the autopilot's own estimate, without gyroscopes and "
    "accelerometers",
)
class CsEmaDetector(sky.TelemetryDetector):
    """Finds small lasting innovations of fixes, barometer and magnetometer by CS-EMA charts (VIMU, 2024).

    `data` of an alert has the sensor and the chart as `residual`, such as `position_ema`, and `ratio`, the last
    innovation.
    """

    residuals: ClassVar = tuple(f"{name}_{chart}" for name in SENSORS for chart in CHARTS)

    position_cusum: sky.Number = _limit(3.0, "position", "CUSUM")
    position_ema: sky.Number = _limit(0.45, "position", "moving average")
    velocity_cusum: sky.Number = _limit(0.0, "velocity", "CUSUM")
    velocity_ema: sky.Number = _limit(0.5, "velocity", "moving average")
    barometer_cusum: sky.Number = _limit(3.0, "barometer", "CUSUM")
    barometer_ema: sky.Number = _limit(0.15, "barometer", "moving average")
    magnetometer_cusum: sky.Number = _limit(3.0, "magnetometer", "CUSUM")
    magnetometer_ema: sky.Number = _limit(0.3, "magnetometer", "moving average")
    heights: bool = sky.param("Whether the heights of fixes are judged.", default=False, strict=True)
    charts: dict[str, CsEma]
    """By sensor."""
    fixes: sky.Series = sky.series("GPS_RAW_INT", *_FIX, timed=False)
    fused: sky.Series = sky.series("GLOBAL_POSITION_INT", *_FUSED)
    pressure: sky.Series = sky.series("SCALED_PRESSURE", "press_abs")
    inertial: sky.Series = sky.series("RAW_IMU", "xmag", "ymag", "zmag", "time_usec", timed=False)
    attitude: sky.Series = sky.series("ATTITUDE", *_ATTITUDE)
    fix_height: _First = sky.state(partial(_First, 1))
    baro_height: _First = sky.state(partial(_First, 1))
    field: FieldReference = sky.state(FieldReference)

    def prepare(self, context: sky.DetectorContext) -> None:
        self.charts = {
            "position": CsEma(Chart(0.01, 0.85, self.position_ema, 0.5, self.position_cusum), 3),
            "velocity": CsEma(Chart(0.01, 1.1, self.velocity_ema, 1.0, self.velocity_cusum), 2),
            "barometer": CsEma(Chart(0.05, 0.52, self.barometer_ema, 0.25, self.barometer_cusum), 1),
            "magnetometer": CsEma(Chart(0.01, 0.52, self.magnetometer_ema, 0.25, self.magnetometer_cusum), 3),
        }

    def compare(self, now: sky.Time, frames: sky.ObservedFrames) -> Sequence[sky.Alert]:
        """Judge fixes, barometer and magnetometer."""
        self.fused.read(frames)
        attitudes = self.attitude.read(frames)
        alerts = self._judge_fixes(frames, self.fixes.read(frames))
        alerts += self._judge_pressure(frames, self.pressure.read(frames))
        return alerts + self._judge_field(frames, self.inertial.read(frames), attitudes)

    def _judge_fixes(self, frames: sky.ObservedFrames, steps: sky.Steps) -> list[sky.Alert]:
        fix, fused = steps.after, self.fused.values[steps.places]
        age = fix[:, 9] * 1e-6 - self.fused.time_s[steps.places]
        rows = np.flatnonzero((fix[:, 8] >= _FIX_3D) & (np.abs(age) <= _AGE_S))
        places, at_ns, fix, fused, age = steps.places[rows], steps.at_ns[rows], fix[rows], fused[rows], age[rows]
        away, slip = fix_errors(fix[:, :4], fused[:, :4], age)
        above = (fix[:, 4] - fused[:, 5]) * 1e-3 + fused[:, 4] * 1e-2 * age
        above -= self.fix_height.keep(places, above[:, None])[:, 0]
        spread = np.maximum(fix[:, 5:8] * 1e-3, (_POSITION_M, _POSITION_M, _VELOCITY_MPS))
        height = above / (_VERTICAL * spread[:, 1]) if self.heights else np.zeros(len(rows))
        position = np.column_stack([away / spread[:, :1], height])
        alerts = self._judge("position", frames, places, at_ns, position)
        return alerts + self._judge("velocity", frames, places, at_ns, slip / spread[:, 2:])

    def _judge_pressure(self, frames: sky.ObservedFrames, steps: sky.Steps) -> list[sky.Alert]:
        fused = self.fused.values[steps.places]
        age = steps.time_s - self.fused.time_s[steps.places]
        rows = np.flatnonzero((steps.after[:, 0] > 0.0) & (np.abs(age) <= _AGE_S))
        places, fused, age = steps.places[rows], fused[rows], age[rows]
        altitude = pressure_altitude_m(steps.after[rows, 0])
        above = (altitude - fused[:, 5] * 1e-3 + fused[:, 4] * 1e-2 * age)[:, None]
        above = above - self.baro_height.keep(places, above)
        return self._judge("barometer", frames, places, steps.at_ns[rows], above / _BAROMETER_M)

    def _judge_field(self, frames: sky.ObservedFrames, steps: sky.Steps, attitudes: sky.Steps) -> list[sky.Alert]:
        nearest, age = _nearest(attitudes, steps.places, steps.after[:, 3] * 1e-6)
        rows = np.flatnonzero((np.abs(age) <= _ATTITUDE_AGE_S) & steps.after[:, :3].any(axis=1))
        places, attitude = steps.places[rows], attitudes.after[nearest[rows]]
        fields = np.clip(steps.after[rows, :3] * 1e-3, -_MOST_GAUSS, _MOST_GAUSS)
        turns = turns_to_earth(*(attitude[:, :3] + attitude[:, 3:] * age[rows, None]).T)
        charts, seconds = self.charts["magnetometer"], steps.seconds[rows]
        ratios, sums, means = np.empty((3, len(rows), 3))
        for chosen_rows in rounds(places):
            at = places[chosen_rows]
            ratios[chosen_rows] = self.field.predict(at, fields[chosen_rows], turns[chosen_rows], seconds[chosen_rows])
            sums[chosen_rows], means[chosen_rows] = charts.add(at, ratios[chosen_rows])
            fit = chosen_rows[np.maximum(sums[chosen_rows], means[chosen_rows]).max(axis=1) < 1.0]
            self.field.update(places[fit], fields[fit], turns[fit])
        return self._raise("magnetometer", frames, places, steps.at_ns[rows], ratios, (sums, means))

    def _judge(
        self, sensor: str, frames: sky.ObservedFrames, places: sky.Ints, at_ns: sky.Ints, ratios: Floats
    ) -> list[sky.Alert]:
        ratios = np.clip(ratios / _STATE, -_MOST_RATIO, _MOST_RATIO)
        return self._raise(sensor, frames, places, at_ns, ratios, self.charts[sensor].add(places, ratios))

    def _raise(
        self,
        sensor: str,
        frames: sky.ObservedFrames,
        places: sky.Ints,
        at_ns: sky.Ints,
        ratios: Floats,
        statistics: tuple[Floats, Floats],
    ) -> list[sky.Alert]:
        alerts: list[sky.Alert] = []
        all_rows = np.arange(len(places))
        for chart, values in zip(CHARTS, statistics, strict=True):
            worst = values.argmax(axis=1)
            scores, ratio = values[all_rows, worst], ratios[all_rows, worst]
            alerts += self.alerts(f"{sensor}_{chart}", frames, places, at_ns, scores, ratio=ratio)
        return alerts


def _nearest(steps: sky.Steps, places: sky.Ints, time_s: Floats) -> tuple[sky.Ints, Floats]:
    """Of (n,) times at link ends: the row of `steps` of the same end with the nearest time, and the time less its own.

    The time is NaN where the end has no row.
    """
    if not len(steps.places):
        return np.zeros(len(places), dtype=np.int64), np.full(len(places), np.nan)
    order = np.lexsort((steps.time_s, steps.places))
    keys = steps.places[order] * _SPAN_S + np.clip(steps.time_s[order], 0.0, _SPAN_S / 2)
    after = np.searchsorted(keys, places * _SPAN_S + np.clip(time_s, 0.0, _SPAN_S / 2))
    rows = order[np.clip(np.column_stack([after - 1, after]), 0, len(order) - 1)]
    ages = np.where(steps.places[rows] == places[:, None], time_s[:, None] - steps.time_s[rows], np.nan)
    chosen = np.where(np.isnan(ages), np.inf, np.abs(ages)).argmin(axis=1)
    all_rows = np.arange(len(places))
    return rows[all_rows, chosen], ages[all_rows, chosen]
