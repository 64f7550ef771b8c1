"""GNSS integrity: the flags of jamming and spoofing that a receiver raises about its own signals, as alarms.

Receivers of u-blox say in UBX-MON-RF and UBX-SEC-SIG whether they notice jamming, and in UBX-NAV-STATUS and UBX-SEC-SIG
whether they notice spoofing (M10 SPG 5.10 Interface Description, UBX-21035062). Of `spoofDetState` it is said there
that it is about the present epoch alone, and that spoofing is detected most easily at the transition from the authentic
to the false signals: "no spoofing indicated" does not mean that there is none. MAVLink carries both in GNSS_INTEGRITY
(mavlink pull request 2110), which is no message of the dialect `ardupilotmega` yet; PX4 stops to use a receiver that
says so (PX4 pull requests 21244, 26085).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import partial
from math import inf, isfinite, sqrt
from statistics import median
from typing import ClassVar, Final

import skyrange.plugin as sky
from skyrange.core.elementary_python import distance
from skyrange.defence import data_sheets
from skyrange.defence.bases.fix_checks import LEAST_INTERVAL_NS
from skyrange.defence.gnss.gates import normal_gate

STREAM: Final = "defence.gnss_integrity"
UTC_STEP_NS: Final = sky.NS_PER_MS
"""Assumed: a receiver notices a step of its time by its own oscillator, whose error is some microseconds a second."""
ACCEL_MPS2: Final = 5.0
"""Mean acceleration of an aircraft that leans by 30 degrees (ATC_ANGLE_MAX)."""
SPEED_MAX_MPS: Final = 25.0
"""Assumed: largest ground speed, wind included."""
LOCK_LOST_NS: Final = sky.NS_PER_S
"""Assumed: after so long without a fix a receiver has searched for signals anew, and a transition is possible."""
_REPEAT_NS: Final = 60 * sky.NS_PER_S
_USUAL: Final = 150
"""Fixes whose median is the usual accuracy and count of satellites: 30 s."""
_LEAST_USUAL: Final = 25


class Jamming(IntEnum):
    """`jammingState` of UBX-MON-RF."""

    UNKNOWN = 0
    OK = 1
    WARNING = 2
    """Interference is visible, but the fix is good."""
    CRITICAL = 3
    """Interference is visible, and there is no reliable fix."""


class Spoofing(IntEnum):
    """`spoofDetState` of UBX-NAV-STATUS."""

    UNKNOWN = 0
    NONE = 1
    INDICATED = 2
    MULTIPLE = 3
    """Several indications: here, one more within a minute."""


@sky.defence(
    "gnss.integrity",
    surface=("gnss",),
    place="in the GNSS receiver, whose flags the autopilot reads; knows what the signals do to the receiver",
    effect="raises an alarm, and with action = 'reject' takes fixes away once the receiver says that it is spoofed",
    alerts=("integrity.jamming", "integrity.spoofing"),
    against=("gnss.jam", "gnss.capture", "gnss.meacon", "gnss.jump", "gnss.time"),
    evasion="takes over aligned with the authentic signals, without a step of place, velocity or time, and then drifts",
    cost="some comparisons for each fix; a false alarm with action = 'reject' lands the aircraft",
    realism={
        "spoofing flag": "cited: raised at the transition and for one epoch only (u-blox UBX-21035062); assumed: the "
        "chances of a detection and of a false indication, which no manufacturer publishes",
        "jamming flag": "assumed: from lost satellites and claimed accuracy, which are what noise leaves of a fix; the "
        "noise and the gain of the receiver itself are not simulated, so a benign loss of the fix is flagged too",
    },
)
class IntegrityFlags(sky.FixCheck):
    """Raises alarms by the flags of a GNSS receiver that notices jamming, and spoofing while it begins."""

    needs_fixes: ClassVar = True

    detection: sky.Number = sky.param(
        "Chance that the receiver flags a transition to false signals that shows as a step of place, velocity or time.",
        default=0.7, ge=0, le=1,
    )  # fmt: skip
    false_indication: sky.Number = sky.param(
        "Chance that it flags a new lock on authentic signals.", default=0.01, ge=0, le=1
    )
    worse: sky.Number = sky.param(
        "Factor by which claimed accuracy gets worse, or satellites get fewer, against the last 30 s that it flags as "
        "jamming.",
        default=2.0, ge=1.1, le=100,
    )  # fmt: skip
    lost_s: sky.Number = sky.param(
        "Time in seconds without a fix that it flags as critical jamming; receivers lose it for up to 3 s at times.",
        default=data_sheets.LOST_S + 1.0, gt=0, le=3_600,
    )  # fmt: skip
    draws: sky.Chance
    receivers: list[ReceiverFlags]

    def prepare(self, context: sky.DefenceContext) -> None:
        self.draws = context.chance
        gate = normal_gate(self.chance(1))
        self.receivers = [ReceiverFlags(self, gate) for _ in self.vehicles]

    def on_sensors(self, now: sky.Time, sensors: sky.Sensors) -> Sequence[sky.SensorAct | sky.Alert]:
        """Set the flags by new fixes and by their absence; take fixes away while an indication lasts."""
        acts: list[sky.SensorAct | sky.Alert] = []
        times, fixes = sensors.gnss_time_ns.tolist(), sensors.gnss_fix.tolist()
        for row, receiver in enumerate(self.receivers):
            if receiver.is_new(times[row], fixes[row]):
                receiver.take(now, times[row], partial(self._draw, row, times[row]), row, sensors)
                if receiver.spoofing >= Spoofing.INDICATED:
                    acts += self.guard.find(row, now, "integrity.spoofing", receiver.score, state=receiver.spoofing)
                else:
                    self.guard.clear(row, now)
            else:
                receiver.miss(now)
            if receiver.jamming >= Jamming.WARNING:
                score = receiver.jam_score
                acts += self.guard.tell(row, now, "integrity.jamming", score, state=receiver.jamming)
        return [*acts, *self.guard.apply(sensors)]

    def _draw(self, row: int, time: sky.Time) -> float:
        return float(self.draws.uniform4(STREAM, sky.hash64(self.vehicles[row]), time, 0)[0])


@dataclass(slots=True)
class ReceiverFlags:
    """The flags of one receiver, and what it has seen."""

    params: IntegrityFlags
    gate: float
    jamming: Jamming = Jamming.UNKNOWN
    spoofing: Spoofing = Spoofing.UNKNOWN
    score: float = 0.0
    """By how many limits the last transition was a step; 1 for a flag without one."""
    jam_score: float = 0.0
    _arrived_ns: sky.Time | None = None
    """When the last fix arrived."""
    _seen_ns: sky.Time | None = None
    """When it was measured."""
    _place: tuple[float, ...] = ()
    _velocity: tuple[float, ...] = ()
    _utc_error_ns: int = 0
    _indicated_ns: sky.Time | None = None
    _accuracy: deque[float] = field(default_factory=lambda: deque(maxlen=_USUAL))
    _satellites: deque[float] = field(default_factory=lambda: deque(maxlen=_USUAL))

    def is_new(self, time: sky.Time, fix: int) -> bool:
        """Whether a reading is a fix that has not been taken in yet."""
        last_ns = self._seen_ns
        return fix >= data_sheets.FIX_3D and (last_ns is None or time < last_ns or time >= last_ns + LEAST_INTERVAL_NS)

    def miss(self, now: sky.Time) -> None:
        """No new fix: critical jamming, if there was none for too long."""
        if self._arrived_ns is not None:
            waited = (now - self._arrived_ns) / sky.from_seconds(self.params.lost_s)
            if waited > 1.0:
                self.jamming, self.jam_score = Jamming.CRITICAL, waited

    def take(self, now: sky.Time, time: sky.Time, draw: Callable[[], float], row: int, sensors: sky.Sensors) -> None:
        """Set the flags by a new fix; `draw` returns a number that is uniform in 0…1."""
        self.spoofing = Spoofing.NONE
        place, velocity = sensors.gnss_enu_m[row].tolist(), sensors.gnss_vel_enu_mps[row].tolist()
        if not all(abs(number) < 1e9 for number in (*place, *velocity)):
            return
        accuracy_m, utc_error_ns = float(sensors.gnss_accuracy[row, 0]), int(sensors.gnss_utc_error_ns[row])
        self._judge_noise(accuracy_m, float(sensors.gnss_satellites[row]))
        if self._seen_ns is not None:
            self.score = self._step(time, place, velocity, accuracy_m, utc_error_ns)
            lock_lost = time - self._seen_ns >= LOCK_LOST_NS
            chance = self.params.detection if self.score > 1.0 else self.params.false_indication if lock_lost else 0.0
            if chance > 0.0 and draw() < chance:
                again = self._indicated_ns is not None and now - self._indicated_ns < _REPEAT_NS
                self.spoofing = Spoofing.MULTIPLE if again else Spoofing.INDICATED
                self.score, self._indicated_ns = max(self.score, 1.0), now
        self._place, self._velocity, self._utc_error_ns = tuple(place), tuple(velocity), utc_error_ns
        self._arrived_ns, self._seen_ns = now, time

    def _judge_noise(self, accuracy_m: float, satellites: float) -> None:
        """A receiver that suddenly has fewer satellites or a worse accuracy than usual notices interference."""
        if not isfinite(accuracy_m) or accuracy_m <= 0.0:
            accuracy_m = inf
        self.jamming = Jamming.OK
        if len(self._accuracy) >= _LEAST_USUAL:
            factor = max(accuracy_m / median(self._accuracy), median(self._satellites) / max(satellites, 0.5))
            self.jam_score = factor / self.params.worse
            if self.jam_score > 1.0:
                self.jamming = Jamming.WARNING
        if isfinite(accuracy_m):
            self._accuracy.append(accuracy_m)
            self._satellites.append(satellites)

    def _step(
        self, time: sky.Time, place: list[float], velocity: list[float], accuracy_m: float, utc_error_ns: int
    ) -> float:
        """By how many limits place, velocity or time differ from what an aircraft and a clock can have come to."""
        assert self._seen_ns is not None
        gap_s = abs(time - self._seen_ns) / sky.NS_PER_S
        expected = [at + rate * gap_s for at, rate in zip(self._place, self._velocity, strict=True)]
        reach_m = min(0.5 * ACCEL_MPS2 * (gap_s * gap_s), 2.0 * SPEED_MAX_MPS * gap_s)
        worse = max(accuracy_m / data_sheets.CLAIMED[0], 1.0) if isfinite(accuracy_m) else 1.0
        noise_m = self.gate * sqrt(2.0) * worse * data_sheets.WANDER_UP_M
        noise_mps = self.gate * sqrt(2.0) * worse * data_sheets.CLAIMED[2]
        return max(
            distance(place, expected) / (reach_m + noise_m),
            distance(velocity, self._velocity) / (min(ACCEL_MPS2 * gap_s, 2.0 * SPEED_MAX_MPS) + noise_mps),
            abs(utc_error_ns - self._utc_error_ns) / UTC_STEP_NS,
        )
