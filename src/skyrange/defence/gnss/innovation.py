"""GNSS innovation check: fixes against inertial dead reckoning, by a filter of the error of the dead reckoning.

The filter is the loosely coupled integration of Groves, Principles of GNSS, Inertial, and Multisensor Integrated
Navigation Systems (2nd ed., 2013, ch. 14): errors of position, velocity, attitude and accelerometers, and the slow
error of the receiver. Its noises are those of the sensors, not the larger ones with which an estimator is made robust;
so it finds what passes the gates of EKF3. It corrects nothing that the autopilot uses.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

import skyrange.plugin as sky
from skyrange.core import elementary_python, elementwise, matrices
from skyrange.core.elementary import exp
from skyrange.defence import data_sheets
from skyrange.defence.bases.fix_checks import FIXES_PER_H, NewFixes
from skyrange.defence.gnss.dead_reckoning import ALIGN_STEPS, DeadReckoning
from skyrange.defence.gnss.gates import chi_square_gate, cusum_gate
from skyrange.world.sensing.geomagnetism import magnetic_field_at

_GRAVITY: Final = 9.80665
_AXES: Final = 6
"""Components of an innovation: velocity and position."""
_WINDOW: Final = 25
"""Fixes in the window of the second test: 5 s."""
_SHIFT: Final = 0.5
"""The shift of the mean that the CUSUM is made for, in standard deviations of an innovation."""
_TESTS: Final = 3
_BIAS_S: Final = 60.0
"""A bias of a gyroscope that calibration at rest leaves is a random walk that reaches the same in a minute."""
_YAW_RAD: Final = 0.05
"""One sigma of the heading at rest: 5 mgauss over a level field of 0.2 gauss, and a degree of declination."""
P, V, A, B, W = (slice(first, first + 3) for first in (0, 3, 6, 9, 12))
"""States: position m, velocity m/s, attitude rad, accelerometer bias m/s², slow error of the receiver m."""
_WORST: Final = 50.0
"""Most by which a claimed accuracy widens the gates: about 100 m, as EKF3 limits it."""
_CLIP: Final = 5.0
"""Most that one fix adds to a cumulative sum: an outlier alone is for the other tests."""
_OBSERVED: Final = np.zeros((_AXES, 15))
_OBSERVED[:3, V] = _OBSERVED[3:, P] = _OBSERVED[3:, W] = np.eye(3)


@dataclass(frozen=True, slots=True)
class Gates:
    """Gates of the three tests."""

    fix: float
    window: float
    drift: float


@sky.defence(
    "gnss.innovation",
    surface=("gnss",),
    place="between sensors and autopilot; knows the readings of gyroscopes, accelerometers, compass and receiver",
    effect="raises an alarm, and with action = 'reject' takes the fix away, so that the autopilot fails safe",
    alerts=("innovation.fix", "innovation.window", "innovation.drift"),
    against=("gnss.jump", "gnss.drift", "gnss.pull_off", "gnss.capture", "gnss.meacon"),
    evasion="drifts at 0.25 m/s from the first false fix on, or lets the false velocity grow by 0.1 m/s in a second",
    cost="a filter of 15 states for each fix; a false alarm with action = 'reject' lands the aircraft",
    realism={
        "inertial sensors": "simulated: noise, and a bias that is constant unless [sensors] has warming_k or "
        "instability, which the check does not know",
        "bias by vibration": "assumed: none; with it the gates have to be wider",
        "the Earth's field": "assumed: that of the world's model, exactly",
    },
)
class InnovationCheck(sky.FixCheck):
    """Tests every GNSS fix against inertial dead reckoning, for jumps by chi-square and for drifts by a cumulative
    sum.
    """

    coast_s: sky.Number = sky.param(
        "Time in seconds for which dead reckoning without fixes can clear a receiver after an alarm; later fixes stay "
        "rejected until the aircraft stands still. A bias of 0.05 m/s² makes 2.5 m in 10 s.",
        default=10.0, gt=0, le=600,
    )  # fmt: skip
    wander_m: sky.Number = sky.param(
        "Slow error of a fix under an open sky along a level axis, one sigma, in metres; 1.27 is 1.5 m circular error "
        "probable (data sheet of the u-blox SAM-M10Q). 1.5 times that in height.",
        default=data_sheets.WANDER_M, gt=0, le=100,
    )  # fmt: skip
    wander_s: sky.Number = sky.param(
        "Correlation time of that error in seconds.", default=data_sheets.WANDER_S, gt=0, le=3_600
    )
    speed_mps: sky.Number = sky.param(
        "Error of the receiver's velocity along an axis, one sigma, in m/s (same data sheet).",
        default=data_sheets.SPEED_MPS, gt=0, le=10,
    )  # fmt: skip
    accel_bias_mps2: sky.Number = sky.param(
        "Bias of an accelerometer after calibration, one sigma, in m/s²; 0.05 is 5 mg.",
        default=data_sheets.ACCEL_BIAS_MPS2, gt=0, le=5,
    )  # fmt: skip
    accel_noise_mps2: sky.Number = sky.param(
        "Noise of an accelerometer at 100 Hz and full throttle, one sigma, in m/s².",
        default=data_sheets.ACCEL_FLIGHT_MPS2, gt=0, le=50,
    )  # fmt: skip
    gyro_noise_radps: sky.Number = sky.param(
        "Noise of a gyroscope at 100 Hz and full throttle, one sigma, in rad/s.",
        default=data_sheets.GYRO_FLIGHT_RADPS, gt=0, le=1,
    )  # fmt: skip
    gyro_bias_radps: sky.Number = sky.param(
        "Bias of a gyroscope that calibration at rest leaves or that comes within a minute, one sigma, in rad/s; the "
        "default is the noise at rest over a second of samples.",
        default=data_sheets.GYRO_REST_RADPS / math.sqrt(ALIGN_STEPS), gt=0, le=1,
    )  # fmt: skip
    white_m: sky.Number = sky.param(
        "Error of a fix that the next one does not share, one sigma, in metres.",
        default=data_sheets.WHITE_M, ge=0, le=10,
    )  # fmt: skip
    slow: bool = True
    per_fix: bool = True
    gates: Gates
    tracker: DeadReckoning
    fixes: NewFixes
    filters: list[ErrorFilter]
    fused_ns: list[sky.Time]

    def prepare(self, context: sky.DefenceContext) -> None:
        count = len(self.vehicles)
        self.gates, self.fixes = self.find_gates(), NewFixes(count)
        self.tracker = DeadReckoning(count, magnetic_field_at(context.origin))
        self.filters, self.fused_ns = [ErrorFilter(self) for _ in self.vehicles], [0] * count

    @property
    def gyro_walk(self) -> float:
        """Growth of the variance of attitude, in rad²/s."""
        return (self.gyro_noise_radps * self.gyro_noise_radps) * data_sheets.IMU_S + (
            self.gyro_bias_radps * self.gyro_bias_radps
        ) * _BIAS_S

    def find_gates(self) -> Gates:
        """Gates that noise alone passes once in `false_alarm_h`, shared by the tests."""
        chance, samples = self.chance(_TESTS), self.false_alarm_h * FIXES_PER_H * _TESTS * 2 * _AXES
        return Gates(
            chi_square_gate(_AXES, chance),
            chi_square_gate(_AXES * _WINDOW, chance),
            cusum_gate(_SHIFT / 2.0, samples),
        )

    def on_sensors(self, now: sky.Time, sensors: sky.Sensors) -> Sequence[sky.SensorAct | sky.Alert]:
        """Test the new fixes; take away those of aircraft about which an alarm lasts."""
        self.tracker.update(now, sensors)
        acts: list[sky.SensorAct | sky.Alert] = []
        for row in self.fixes.rows(sensors):
            acts += self._test(row, now, sensors)
        return [*acts, *self.guard.apply(sensors)]

    def _test(self, row: int, now: sky.Time, sensors: sky.Sensors) -> list[sky.Alert]:
        time = int(sensors.gnss_time_ns[row])
        error_filter, reckoning = self.filters[row], self.tracker
        reckoned = reckoning.at(row, time)
        if reckoned is None or time < reckoning.since_ns[row] or not reckoning.aligned[row]:
            return []
        position, velocity, force, rotation = reckoned
        resting = bool(reckoning.resting[row])
        fix_m, fix_mps = sensors.gnss_enu_m[row].copy(), sensors.gnss_vel_enu_mps[row].copy()
        if error_filter.time_ns < reckoning.since_ns[row]:  # it has just come to rest
            error_filter.start(time, fix_m, force, rotation, reckoning.attitude(row))
            self.guard.release(row)
            self.fused_ns[row] = now
            return []
        error_filter.predict(time, force, rotation, resting=resting)
        innovation, spread, white = error_filter.innovate(
            fix_m - position, fix_mps - velocity, sensors.gnss_accuracy[row]
        )
        closed = self.guard.closed(row)
        if closed:
            return self._coast(row, now, white, innovation, spread, (fix_m, fix_mps, position, velocity))
        square, window, drift = error_filter.judge(white)
        off_m, off_mps = float(elementwise.length(innovation[3:])), float(elementwise.length(innovation[:3]))
        if square > self.gates.fix:
            return self.guard.find(row, now, "innovation.fix", square / self.gates.fix, off_m=off_m, off_mps=off_mps)
        if window > self.gates.window or drift > self.gates.drift:
            score = max(window / self.gates.window, drift / self.gates.drift)
            kind = "innovation.window" if window > self.gates.window else "innovation.drift"
            return self.guard.find(row, now, kind, score, latch=True, off_m=off_m, off_mps=off_mps)
        error_filter.fuse(innovation, spread)
        self.fused_ns[row] = now
        return []

    def _coast(
        self,
        row: int,
        now: sky.Time,
        white: sky.Floats,
        innovation: sky.Floats,
        spread: sky.Floats,
        fix: tuple[sky.Floats, ...],
    ) -> list[sky.Alert]:
        """While an alarm lasts, no fix is fused: dead reckoning alone may clear the receiver, for as long as it can."""
        square, coast_ns = matrices.dot(white, white), sky.from_seconds(self.coast_s)
        error_filter = self.filters[row]
        if now > self.fused_ns[row] + coast_ns + self.guard.recover_ns:
            if self.guard.rejects:
                return []
            error_filter.restart(*fix)
            self.guard.release(row)
            self.fused_ns[row] = now
            return []
        if square > self.gates.fix:
            latch = now > self.fused_ns[row] + coast_ns
            off_m, off_mps = float(elementwise.length(innovation[3:])), float(elementwise.length(innovation[:3]))
            score = square / self.gates.fix
            return self.guard.find(row, now, "innovation.fix", score, latch=latch, off_m=off_m, off_mps=off_mps)
        self.guard.clear(row, now)
        if not self.guard.closed(row):
            error_filter.forget()
            error_filter.fuse(innovation, spread)
            self.fused_ns[row] = now
        return []


@dataclass(slots=True, eq=False)
class ErrorFilter:
    """The error of one aircraft's dead reckoning, and the statistics of the innovations of its fixes."""

    params: InnovationCheck
    state: sky.Floats = field(init=False)
    covariance: sky.Floats = field(init=False)
    time_ns: sky.Time = -1
    """When the last fix was measured; -1 before the first."""
    base_m: sky.Floats = field(init=False)
    """Position of the first fix: where dead reckoning began."""
    force: sky.Floats = field(init=False)
    rotation: sky.Floats = field(init=False)
    _squares: deque[float] = field(init=False)
    _sums: sky.Floats = field(init=False)

    def __post_init__(self) -> None:
        self.base_m, self.force, self.rotation = np.zeros(3), np.zeros(3), np.zeros((3, 3))
        self.state, self.covariance = np.zeros(15), np.zeros((15, 15))
        self._squares, self._sums = deque(maxlen=_WINDOW), np.zeros(2 * _AXES)

    @property
    def _wander(self) -> sky.Floats:
        return self.params.wander_m * np.array([1.0, 1.0, data_sheets.WANDER_UP_M / data_sheets.WANDER_M])

    def start(
        self, time: sky.Time, position: sky.Floats, force: sky.Floats, rotation: sky.Floats, attitude: sky.Floats
    ) -> None:
        """Begin at rest with a fix: its slow error is that of the place at which dead reckoning begins.

        `attitude` (3, 3) is the rotation from body to local.
        """
        self.time_ns, self.base_m = time, position
        self.force, self.rotation = force, rotation
        self.state, self.covariance = np.zeros(15), np.zeros((15, 15))
        self._place()
        # levelling by a biased accelerometer makes no error until the aircraft turns: the tilt hides the bias
        level = self.params.accel_bias_mps2 * attitude[:, :2]
        source = np.zeros((15, 2))
        source[A.start], source[A.start + 1] = -level[1] / _GRAVITY, level[0] / _GRAVITY
        source[B.start : B.start + 2] = self.params.accel_bias_mps2 * np.eye(2)
        self.covariance += matrices.multiply(source, source.T)
        self.covariance[8, 8] = _YAW_RAD * _YAW_RAD
        self.forget()

    def restart(
        self, position: sky.Floats, velocity: sky.Floats, reckoned_m: sky.Floats, reckoned_mps: sky.Floats
    ) -> None:
        """Take position and velocity from a fix; attitude and biases stay."""
        for part in (P, V, W):
            self.state[part] = 0.0
            self.covariance[part, :], self.covariance[:, part] = 0.0, 0.0
        self.state[P], self.state[V] = position - self.base_m - reckoned_m, velocity - reckoned_mps
        self._place()
        self.covariance[V, V] = (self.params.speed_mps * self.params.speed_mps) * np.eye(3)
        self.forget()

    def _place(self) -> None:
        """The error of a place that was taken from a fix is that of the fix, with the other sign."""
        variance = np.diag(self._wander * self._wander)
        self.covariance[P, P], self.covariance[W, W] = variance, variance
        self.covariance[P, W], self.covariance[W, P] = -variance, -variance

    def forget(self) -> None:
        """Forget the innovations so far."""
        self._squares.clear()
        self._sums[:] = 0.0

    def predict(self, time: sky.Time, force: sky.Floats, rotation: sky.Floats, *, resting: bool) -> None:
        """Go on to the time of a fix; `force` and `rotation` are the integrals since the start."""
        dt_s = max((time - self.time_ns) / sky.NS_PER_S, 0.0)
        push, turned = force - self.force, rotation - self.rotation
        self.time_ns, self.force, self.rotation = time, force, rotation
        keep = exp(-dt_s / self.params.wander_s)
        move, noise = np.eye(15), np.zeros(15)
        move[W, W] *= keep
        noise[W] = (1.0 - (keep * keep)) * (self._wander * self._wander)
        if not resting:
            cross = np.array([[0, push[2], -push[1]], [-push[2], 0, push[0]], [push[1], -push[0], 0]])
            move[V, A], move[V, B] = cross, -turned
            move[P, V], move[P, A], move[P, B] = dt_s * np.eye(3), 0.5 * dt_s * cross, -0.5 * dt_s * turned
            noise[V] = (self.params.accel_noise_mps2 * self.params.accel_noise_mps2) * data_sheets.IMU_S * dt_s
            noise[A] = self.params.gyro_walk * dt_s
        self.state = matrices.multiply(move, self.state)
        self.covariance = matrices.multiply(move, self.covariance, move.T) + np.diag(noise)

    def innovate(
        self, offset_m: sky.Floats, offset_mps: sky.Floats, accuracy: sky.Floats
    ) -> tuple[sky.Floats, sky.Floats, sky.Floats]:
        """Innovation (6,) velocity first, its covariance, and its whitened form, for a fix minus dead reckoning.

        Where the receiver claims a worse accuracy than under an open sky, its noise is so much larger.
        """
        usual = np.array(data_sheets.CLAIMED)
        claimed = np.clip(np.nan_to_num(accuracy, nan=np.inf), usual, _WORST * usual) / usual
        worse = ((claimed[:2] * claimed[:2]) - 1.0) * elementary_python.square(np.array(data_sheets.CLAIMED[:2]))
        position = (self.params.white_m * self.params.white_m) + np.array([worse[0], worse[0], worse[1]])
        velocity = np.full(3, elementary_python.square(self.params.speed_mps * claimed[2]))
        observation_matrix = _OBSERVED
        spread = matrices.multiply(observation_matrix, self.covariance, observation_matrix.T) + np.diag(
            np.concatenate([velocity, position])
        )
        innovation = np.concatenate([offset_mps, offset_m - self.base_m]) - matrices.multiply(
            observation_matrix, self.state
        )
        white = matrices.solve(matrices.factor(spread), innovation)
        return innovation, spread, white

    def fuse(self, innovation: sky.Floats, spread: sky.Floats) -> None:
        """Correct the error by a fix."""
        gain = matrices.solve(spread, matrices.multiply(_OBSERVED, self.covariance)).T
        self.state = self.state + matrices.multiply(gain, innovation)
        after = self.covariance - matrices.multiply(gain, spread, gain.T)
        self.covariance = 0.5 * (after + after.T)

    def judge(self, white: sky.Floats) -> tuple[float, float, float]:
        """Sum of squares of this fix and of the window, and the largest of the cumulative sums."""
        square = matrices.dot(white, white)
        self._squares.append(square)
        both = np.concatenate([white, -white])
        self._sums = np.maximum(self._sums + np.clip(both, -_CLIP, _CLIP) - _SHIFT / 2.0, 0.0)
        return square, elementary_python.add_up(self._squares), float(self._sums.max())
