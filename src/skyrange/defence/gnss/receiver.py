"""GNSS receiver check: what a receiver reports of itself, its time, and fixes before and after a gap."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf, isfinite, sqrt
from statistics import median
from typing import ClassVar, Final

import skyrange.plugin as sky
from skyrange.core.elementary_python import distance
from skyrange.defence import data_sheets
from skyrange.defence.bases.fix_checks import LEAST_INTERVAL_NS
from skyrange.defence.gnss.gates import normal_gate

_FIX_3D: Final = data_sheets.FIX_3D
_FUTURE_NS: Final = 20 * sky.NS_PER_MS
_USUAL: Final = 150
"""Fixes whose median is the usual accuracy and count of satellites: 30 s."""
_LEAST_USUAL: Final = 25
_TESTS: Final = 1


@sky.defence(
    "gnss.receiver",
    surface=("gnss",),
    place="between sensors and autopilot; knows what the receiver reports, and the autopilot's own clock",
    effect="raises an alarm, and with action = 'reject' takes fixes of a wrong time or an impossible place away",
    alerts=("receiver.utc", "receiver.time", "receiver.jump", "receiver.lost", "receiver.worse"),
    against=("gnss.time", "gnss.jam", "gnss.capture", "gnss.meacon", "gnss.jump"),
    evasion="is there before the first fix, or takes over without a loss of lock and moves time and place slowly",
    cost="some comparisons for each fix; a false alarm with action = 'reject' lands the aircraft",
    realism={
        "own clock": "assumed: set at the first fix, then within clock_ppm; a run has no error of it",
        "satellites, claimed accuracy": "assumed: what attacks write of them",
    },
)
class ReceiverCheck(sky.FixCheck):
    """Checks a GNSS receiver's time, claimed accuracy and satellites, and the place of its fixes after a loss."""

    needs_fixes: ClassVar = True

    clock_error_s: sky.Number = sky.param(
        "Largest change in seconds of the receiver's UTC against the autopilot's own clock at once; 0.5 is from where "
        "on AP_RTC and NTP step a clock.",
        default=0.5, gt=0, le=86_400,
    )  # fmt: skip
    clock_ppm: sky.Number = sky.param(
        "Largest error of the rate of the autopilot's clock, in parts per million; a crystal has 20 to 50.",
        default=100.0, ge=0, le=1e6,
    )  # fmt: skip
    lost_s: sky.Number = sky.param(
        "Time in seconds without a new fix that raises an alarm; receivers lose it for up to 3 s at times.",
        default=data_sheets.LOST_S + 1.0, gt=0, le=3_600,
    )  # fmt: skip
    worse: sky.Number = sky.param(
        "Factor by which claimed accuracy gets worse, or satellites get fewer, against the last 30 s that raises an "
        "alarm; it never rejects fixes, because the receiver says itself what they are worth.",
        default=2.0, ge=1.1, le=100,
    )  # fmt: skip
    accel_mps2: sky.Number = sky.param(
        "Largest mean acceleration of the aircraft in m/s², by which the place after a gap is judged; 5 is that of a "
        "lean of 30 degrees, ATC_ANGLE_MAX.",
        default=5.0, gt=0, le=100,
    )  # fmt: skip
    speed_max_mps: sky.Number = sky.param(
        "Largest ground speed of the aircraft in m/s, wind included.", default=25.0, gt=0, le=500
    )
    wander_up_m: sky.Number = sky.param(
        "Slow error of the height of a fix under an open sky, one sigma, in metres, by which a place is judged.",
        default=data_sheets.WANDER_UP_M, gt=0, le=100,
    )  # fmt: skip
    receivers: list[Receiver]

    def prepare(self, context: sky.DefenceContext) -> None:
        gate = normal_gate(self.chance(_TESTS))
        self.receivers = [Receiver(self, gate) for _ in self.vehicles]

    def on_sensors(self, now: sky.Time, sensors: sky.Sensors) -> Sequence[sky.SensorAct | sky.Alert]:
        """Test the new fixes and the silence of receivers; take away fixes while an alarm about time or place lasts."""
        acts: list[sky.SensorAct | sky.Alert] = []
        times, fixes = sensors.gnss_time_ns.tolist(), sensors.gnss_fix.tolist()
        for row, receiver in enumerate(self.receivers):
            if receiver.is_new(times[row], fixes[row]):
                acts += self._take(row, now, times[row], sensors)
            else:
                kind, score = receiver.find_loss(now)
                if kind:
                    acts += self.guard.tell(row, now, kind, score)
        return [*acts, *self.guard.apply(sensors)]

    def _take(self, row: int, now: sky.Time, time: sky.Time, sensors: sky.Sensors) -> list[sky.Alert]:
        receiver = self.receivers[row]
        place, velocity = sensors.gnss_enu_m[row].tolist(), sensors.gnss_vel_enu_mps[row].tolist()
        accuracy_m = float(sensors.gnss_accuracy[row, 0])
        if not all(abs(number) < 1e9 for number in (*place, *velocity)):
            return []
        alarms = []
        kind, score = receiver.find_worse(accuracy_m, int(sensors.gnss_satellites[row]))
        if kind:
            alarms += self.guard.tell(row, now, kind, score)
        claimed_m = accuracy_m if isfinite(accuracy_m) else 0.0
        utc_error_ns = int(sensors.gnss_utc_error_ns[row])
        kind, score = receiver.take(now, time, utc_error_ns, place, velocity, claimed_m)
        if kind:
            return [*alarms, *self.guard.find(row, now, kind, score)]
        self.guard.clear(row, now)
        return alarms


@dataclass(slots=True)
class Receiver:
    """What one receiver has reported."""

    params: ReceiverCheck
    gate: float
    _changed_ns: sky.Time | None = None
    """When a new fix last arrived."""
    _seen_ns: sky.Time | None = None
    """When the last fix was measured, and when the last plausible one was."""
    _time_ns: sky.Time | None = None
    _place: tuple[float, ...] = ()
    _velocity: tuple[float, ...] = ()
    _clock: tuple[sky.Time, sky.Time] | None = None
    """Own time at the first fix, and UTC minus own time there, in nanoseconds."""
    _accuracy: deque[float] = field(init=False)
    _satellites: deque[float] = field(init=False)

    def __post_init__(self) -> None:
        self._accuracy, self._satellites = deque(maxlen=_USUAL), deque(maxlen=_USUAL)

    def find_loss(self, now: sky.Time) -> tuple[str, float]:
        """The alarm of a receiver that has not had a new fix for too long; "" for none."""
        if self._changed_ns is None or now <= self._changed_ns + sky.from_seconds(self.params.lost_s):
            return "", 0.0
        gap_s = (now - self._changed_ns) / sky.NS_PER_S
        return "receiver.lost", gap_s / self.params.lost_s

    def is_new(self, time: sky.Time, fix: int) -> bool:
        """Whether a reading is a fix that has not been taken in yet."""
        last_ns = self._seen_ns
        return fix >= _FIX_3D and (last_ns is None or time < last_ns or time >= last_ns + LEAST_INTERVAL_NS)

    def take(
        self,
        now: sky.Time,
        time: sky.Time,
        utc_error_ns: int,
        place: Sequence[float],
        velocity: Sequence[float],
        claimed_m: float,
    ) -> tuple[str, float]:
        """Take in a new fix: the alarm about its time or place, and by how many limits; "" for a plausible one."""
        kind, score = self._test_time(now, time, utc_error_ns)
        if not kind:
            kind, score = self._test_place(time, place, velocity, claimed_m)
        if kind not in ("receiver.time", "receiver.jump"):
            self._place, self._velocity, self._time_ns = tuple(place), tuple(velocity), time
        self._changed_ns, self._seen_ns = now, time
        return kind, score

    def _test_time(self, now: sky.Time, time: sky.Time, utc_error_ns: int) -> tuple[str, float]:
        """UTC against the own clock since the first fix, and the order of fixes."""
        ahead_ns = time + utc_error_ns - now
        if self._clock is None:
            self._clock = now, ahead_ns
        since, first_ns = self._clock
        allowed = self.params.clock_error_s * sky.NS_PER_S + 1e-6 * self.params.clock_ppm * (now - since)
        score = abs(ahead_ns - first_ns) / allowed
        if score > 1.0:
            return "receiver.utc", score
        last_ns = time if self._seen_ns is None else self._seen_ns
        wrong_ns = max(time - now - _FUTURE_NS, last_ns - time)
        return ("receiver.time", 1.0 + wrong_ns / sky.NS_PER_S) if wrong_ns > 0 else ("", 0.0)

    def _test_place(
        self, time: sky.Time, place: Sequence[float], velocity: Sequence[float], claimed_m: float
    ) -> tuple[str, float]:
        """Whether the aircraft can have come here from the last place, at its last velocity and by its thrust."""
        if self._time_ns is None:
            return "", 0.0
        gap_s = (time - self._time_ns) / sky.NS_PER_S
        expected = [at + rate * gap_s for at, rate in zip(self._place, self._velocity, strict=True)]
        reach_m = min(0.5 * self.params.accel_mps2 * (gap_s * gap_s), 2.0 * self.params.speed_max_mps * gap_s)
        worse = max(claimed_m / data_sheets.CLAIMED[0], 1.0)
        sigma = sqrt(2.0) * worse * self.params.wander_up_m
        score = distance(place, expected) / (reach_m + self.gate * sigma)
        return ("receiver.jump", score) if score > 1.0 else ("", 0.0)

    def find_worse(self, accuracy_m: float, satellites: int) -> tuple[str, float]:
        """The alarm of a receiver that suddenly claims to be worse than usual; "" for none."""
        if not isfinite(accuracy_m) or accuracy_m <= 0.0:
            accuracy_m = inf
        factor = 0.0
        if len(self._accuracy) >= _LEAST_USUAL:
            factor = max(accuracy_m / median(self._accuracy), median(self._satellites) / max(satellites, 0.5))
        if isfinite(accuracy_m):
            self._accuracy.append(accuracy_m)
            self._satellites.append(float(satellites))
        return ("receiver.worse", factor / self.params.worse) if factor > self.params.worse else ("", 0.0)
