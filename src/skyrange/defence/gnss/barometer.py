"""GNSS barometer check: height and climb rate of fixes against the height of the barometer."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import isfinite, sqrt
from typing import Final, NamedTuple

import skyrange.plugin as sky
from skyrange.core import elementary_python
from skyrange.core.elementary import exp
from skyrange.defence import data_sheets
from skyrange.defence.bases.fix_checks import NewFixes
from skyrange.defence.gnss.gates import normal_gate

WINDOWS: Final = (1, 25, 100)
"""Intervals of fixes over which changes of height are compared: 0.2, 5 and 20 s."""
_TESTS: Final = 2 * len(WINDOWS) + 1
_SAMPLES: Final = 64
"""Barometer readings that are kept: 6 s at 10 Hz, 0.6 s of a sensor that is read at 100 Hz."""
_READ_NS: Final = 10_000_000
_LEAST_STEP_S: Final = 0.15
_GAP_S: Final = 5.0


@sky.defence(
    "gnss.barometer",
    surface=("gnss", "baro"),
    place="between sensors and autopilot; knows the readings of receiver and barometer, and not which of them is false",
    effect="raises an alarm, and with action = 'reject' takes the fix away, so that the autopilot fails safe",
    alerts=("barometer.height", "barometer.jump", "barometer.climb"),
    against=("gnss.jump", "gnss.drift", "gnss.capture", "gnss.meacon", "sensor.barometer"),
    evasion="falsifies the level position only, or lets the false height grow slower than the weather may",
    cost="some sums for each fix; a false alarm with action = 'reject' lands the aircraft",
    realism={
        "pressure error by airflow": "assumed: none in the range; pressure_error_m allows for one",
        "barometer's weather drift": "assumed: 1 m in half an hour",
        "barometer's drift by temperature": "assumed: none; [sensors] warming_k makes one that the check does not know",
    },
)
class BarometerCheck(sky.FixCheck):
    """Compares height and climb rate of GNSS fixes with the barometer, at once and over 5 and 20 s."""

    pressure_error_m: sky.Number = sky.param(
        "Change of the barometer's error by the flow of air around the airframe, one sigma, in metres; 0.5 is 6 Pa, "
        "40 % of the dynamic pressure at 5 m/s (ArduPilot corrects it by BARO1_WCF_FWD and others).",
        default=0.5, ge=0, le=100,
    )  # fmt: skip
    baro_noise_m: sky.Number = sky.param(
        "Noise of a reading of the barometer, one sigma, in metres.", default=data_sheets.BARO_NOISE_M, gt=0, le=10
    )
    weather_m: sky.Number = sky.param(
        "Drift of the barometer by weather, one sigma, in metres.", default=data_sheets.WEATHER_M, ge=0, le=100
    )
    weather_s: sky.Number = sky.param(
        "Correlation time of that drift in seconds.", default=data_sheets.WEATHER_S, gt=0, le=1e6
    )
    wander_up_m: sky.Number = sky.param(
        "Slow error of the height of a fix under an open sky, one sigma, in metres.",
        default=data_sheets.WANDER_UP_M, gt=0, le=100,
    )  # fmt: skip
    wander_s: sky.Number = sky.param(
        "Correlation time of that error in seconds.", default=data_sheets.WANDER_S, gt=0, le=3_600
    )
    white_m: sky.Number = sky.param(
        "Error of the height of a fix that the next one does not share, one sigma, in metres.",
        default=data_sheets.WHITE_M, ge=0, le=10,
    )  # fmt: skip
    speed_mps: sky.Number = sky.param(
        "Error of the receiver's climb rate, one sigma, in m/s.", default=data_sheets.SPEED_MPS, gt=0, le=10
    )
    slow: bool = True
    per_fix: bool = True
    fixes: NewFixes
    heights: list[Heights]
    tracker: BarometerReadings

    def prepare(self, context: sky.DefenceContext) -> None:
        gate = normal_gate(self.chance(_TESTS))
        self.fixes = NewFixes(len(self.vehicles))
        self.tracker = BarometerReadings([deque(maxlen=_SAMPLES) for _ in self.vehicles])
        self.heights = [Heights(HeightErrors(self), gate, readings) for readings in self.tracker.of]

    def on_sensors(self, now: sky.Time, sensors: sky.Sensors) -> Sequence[sky.SensorAct | sky.Alert]:
        """Test the new fixes; take away those of aircraft about which an alarm lasts."""
        self.tracker.update(now, sensors)
        acts: list[sky.SensorAct | sky.Alert] = []
        for row in self.fixes.rows(sensors):
            accuracy = claimed_over_usual(sensors, row)
            kind, score, off_m = self.heights[row].compare(
                int(sensors.gnss_time_ns[row]), float(sensors.gnss_enu_m[row, 2]),
                float(sensors.gnss_vel_enu_mps[row, 2]), accuracy,
            )  # fmt: skip
            if score > 1.0:
                acts += self.guard.find(row, now, kind, score, off_m=off_m)
            else:
                self.guard.clear(row, now)
        return [*acts, *self.guard.apply(sensors)]


def claimed_over_usual(sensors: sky.Sensors, row: int) -> float:
    """By how much the receiver claims to be worse than under an open sky, in height or speed; at least 1."""
    _, height_m, speed_mps = sensors.gnss_accuracy[row].tolist()
    ratios = (height_m / data_sheets.CLAIMED[1], speed_mps / data_sheets.CLAIMED[2])
    return max([1.0, *(float(ratio) for ratio in ratios if isfinite(ratio))])


class Sample(NamedTuple):
    """One fix, and what the barometer read at its time."""

    time_ns: sky.Time
    gnss_up_m: float
    climbed_m: float
    """Integral of the climb rate of the fixes."""
    baro_up_m: float
    climb_mps: float
    accuracy: float
    """Accuracies that the receiver claims over those under an open sky, the worse one; at least 1."""


@dataclass(frozen=True, slots=True)
class HeightErrors:
    """Standard deviations of the differences between the two heights."""

    params: BarometerCheck

    def of_barometer(self, seconds: float) -> float:
        """Variance of the change of the barometer's error in so many seconds, m²."""
        params = self.params
        weather = 2.0 * (params.weather_m * params.weather_m) * (1.0 - exp(-seconds / params.weather_s))
        return (
            2.0 * (params.baro_noise_m * params.baro_noise_m)
            + weather
            + (params.pressure_error_m * params.pressure_error_m)
        )

    def of_height(self, seconds: float, accuracy: float) -> float:
        """One sigma of the change of GNSS height minus barometer, metres."""
        wander = (
            2.0 * (self.params.wander_up_m * self.params.wander_up_m) * (1.0 - exp(-seconds / self.params.wander_s))
        )
        white = 2.0 * (self.params.white_m * self.params.white_m)
        worse = 2.0 * ((accuracy * accuracy) - 1.0) * (data_sheets.CLAIMED[1] * data_sheets.CLAIMED[1])
        return sqrt(wander + white + worse + self.of_barometer(seconds))

    def of_climb(self, seconds: float, accuracy: float) -> float:
        """One sigma of the integral of the climb rate minus the change of the barometer, metres."""
        interval_s = data_sheets.FIX_S
        integral = elementary_python.square(accuracy * self.params.speed_mps) * interval_s * max(seconds, interval_s)
        return sqrt(integral + self.of_barometer(seconds))


Readings = deque[tuple[sky.Time, float]]
"""Readings of one barometer, with their times."""


@dataclass(slots=True)
class BarometerReadings:
    """The recent readings of the barometers of some aircraft."""

    of: list[Readings]

    def update(self, now: sky.Time, sensors: sky.Sensors) -> None:
        """Keep new readings; the sensors are read at 10 Hz, so an unchanged value is not a new one."""
        for readings, up_m in zip(self.of, sensors.baro_up_m.tolist(), strict=True):
            if readings:
                last_ns, last_m = readings[-1]
                if up_m == last_m or now < last_ns + _READ_NS:
                    continue
            if isfinite(up_m):
                readings.append((now, up_m))

    def join(self, others: Sequence[BarometerReadings]) -> BarometerReadings:
        """See `ReadingsTracker`."""
        return BarometerReadings([readings for member in (self, *others) for readings in member.of])


@dataclass(slots=True)
class Heights:
    """The recent heights of one aircraft."""

    errors: HeightErrors
    gate: float
    """In standard deviations."""
    readings: Readings
    _past: deque[Sample] = field(init=False)
    _first: Sample | None = None

    def __post_init__(self) -> None:
        self._past = deque(maxlen=WINDOWS[-1] + 1)

    def height_at(self, time: sky.Time) -> float | None:
        """Barometer at the time of a fix, between its two readings; `None` for one that is older than they are."""
        later: tuple[sky.Time, float] | None = None
        for when, up_m in reversed(self.readings):
            if when <= time:
                if later is None:
                    return up_m
                share = (time - when) / (later[0] - when)
                return up_m + share * (later[1] - up_m)
            later = when, up_m
        return None

    def compare(self, time: sky.Time, up_m: float, climb_mps: float, accuracy: float) -> tuple[str, float, float]:
        """Test a fix: the test that it fails most, by how many gates (plausible up to 1), and the metres."""
        baro_m = self.height_at(time)
        if baro_m is None:
            return "", 0.0, 0.0
        last = self._past[-1] if self._past else None
        climbed_m = 0.0
        if last is not None:
            dt_s = (time - last.time_ns) / sky.NS_PER_S
            if not 0.0 < dt_s < _GAP_S:
                self._past.clear()
            climbed_m = last.climbed_m + 0.5 * (climb_mps + last.climb_mps) * dt_s
        sample = Sample(time, up_m, climbed_m, baro_m, climb_mps, accuracy)
        self._first = self._first or sample
        worst = self._test_height(self._first, sample, "barometer.height")
        for window in WINDOWS:
            if window > len(self._past):
                break
            then = self._past[-window]
            worst = max(
                worst, self._test_height(then, sample, "barometer.jump"), self._test_climb(then, sample), key=_score
            )
        self._past.append(sample)
        return worst

    def _test_height(self, then: Sample, sample: Sample, kind: str) -> tuple[str, float, float]:
        seconds = max((sample.time_ns - then.time_ns) / sky.NS_PER_S, 0.0)
        off_m = sample.gnss_up_m - then.gnss_up_m - (sample.baro_up_m - then.baro_up_m)
        sigma = self.errors.of_height(seconds, max(sample.accuracy, then.accuracy))
        return kind, abs(off_m) / sigma / self.gate, off_m

    def _test_climb(self, then: Sample, sample: Sample) -> tuple[str, float, float]:
        seconds = max((sample.time_ns - then.time_ns) / sky.NS_PER_S, 0.0)
        off_m = sample.climbed_m - then.climbed_m - (sample.baro_up_m - then.baro_up_m)
        sigma = self.errors.of_climb(seconds, max(sample.accuracy, then.accuracy))
        return "barometer.climb", abs(off_m) / sigma / self.gate, off_m


def _score(result: tuple[str, float, float]) -> float:
    return result[1]
