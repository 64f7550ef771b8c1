"""Motion consistency detector: the telemetry of each aircraft against a motion model of a multirotor.

It reads GLOBAL_POSITION_INT, ATTITUDE and SYS_STATUS, which the stream profiles `light` and `operator` both carry.

The method is that of R. Quinonez, J. Giraldo, L. Salazar, E. Bauman, A. Cardenas and Z. Lin, "SAVIOR: Securing
Autonomous Vehicles with Robust Physical Invariants", USENIX Security 2020, p. 895-912: a nonlinear model of the vehicle
predicts each measurement, and a CUSUM of the residual's absolute value, less a bias b, is compared with a threshold.
The residuals here are:

- `position`: the horizontal step between two positions, less the mean of their velocities times the time;
- `climb`: the same vertically;
- `acceleration`: the part of a change of velocity above 12 m/s², which a multirotor reaches at a lean of 50°;
- `lean`: the acceleration that the lean does not explain, against a drag model identified in flight (`DragModels`);
- `battery`: the part of a change of the remaining charge above 1 % (its quantisation) and 1 % per second (ten times a
  multirotor's consumption, a battery empty in 100 s), or a gain in flight.

The differences to SAVIOR: it runs at the ground station at the rate of telemetry, not on board at 400 Hz. So attitude
is an input of the model, not one of its outputs; the motors' commands are not known. Drag and wind are identified in
flight by a Kalman filter, where SAVIOR identifies a model from earlier flights. Biases and thresholds are not trained
but stated:

- a step's standard deviation is 0.05 m, the sum of the quantisations of position (11 mm) and velocity (1 cm/s) and the
  corrections by an estimator (nominal flights have 0.015 m), and the error of the trapezoid rule at an acceleration
  that changes by 5 m/s² within the step, 5 t²/12;
- b is 2 standard deviations, and a CUSUM of 20 is the threshold. Independent normal residuals reach a tenth of that
  less than once in 10⁹ steps; what decides is the correction by an estimator after 3 s without fixes, as a receiver in
  a city has them, which comes to 12. For `lean`, of which a window of 2 s has one, the threshold is 0.45 of that:
  severe turbulence (MIL-F-8785C, wind 5 m/s) comes to 0.9 of it, and a false lean of 25° to 1.9.

It cannot detect false telemetry that is consistent: a displaced position after its onset, a track with fitting
velocities, slow false fixes which an aircraft follows. It reports a crash and a reset of the estimator as well, because
the motion then does not fit either.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Final

import numpy as np

import skyrange.plugin as sky
from skyrange.contracts.frames import Ints
from skyrange.core import elementwise, matrices
from skyrange.detect.series import Floats, grown, step_errors

GRAVITY_MPS2: Final = 9.80665
_PRIOR: Final = (0.3, 0.0, 0.0)
_PRIOR_VARIANCE: Final = (0.15 * 0.15, 4.0, 4.0)
"""k in 1/s: 0.1 to 0.5 for multirotors of 0.5 to 2 kg; c in m/s²: a wind of 6 m/s."""
_WANDER: Final = (0.01 * 0.01, 0.1 * 0.1, 0.1 * 0.1)
"""Variance per second: c follows gusts of moderate turbulence within 10 s."""


class DragModels:
    """The drag models of all link ends, (ends,) each: the acceleration that the lean does not explain.

    A multirotor accelerates where it leans, g tan(lean) in level flight, less the drag of its motion through the air.
    The drag is taken as linear in the air speed: d = -k (v - w) with a coefficient k and the wind w, so d = -k v + c
    with c = k w. A Kalman filter of k and c (east, north), which wander slowly, predicts d for the velocity of each
    window.
    """

    def __init__(self) -> None:
        self._state: Floats = np.zeros((0, 3))
        self._covariance: Floats = np.zeros((0, 3, 3))

    def grow(self, count: int) -> None:
        """Have models for `count` link ends."""
        old = len(self._state)
        if count > old:
            self._state, self._covariance = grown(self._state, count), grown(self._covariance, count)
            self.reset(np.arange(old, count))

    def reset(self, places: Ints) -> None:
        """Forget what was identified at some link ends."""
        self._state[places] = _PRIOR
        self._covariance[places] = np.diag(_PRIOR_VARIANCE)

    def update(self, places: Ints, seconds: Floats, velocity: Floats, drag: Floats, noise: Floats) -> Floats:
        """Take in one window of each of n link ends; returns the (n,) normalised innovation.

        `seconds` are (n,) since the window before, `velocity` and `drag` (n, 2) in m/s and m/s², east and north, and
        `noise` the (n,) standard deviation of `drag` along an axis. The innovation has two degrees of freedom; the
        result is the root of the half of its square, so about 1 if the model holds.
        """
        state, covariance = self._state[places], self._covariance[places]
        covariance = covariance + np.diag(_WANDER) * np.minimum(seconds, 600.0)[:, None, None]
        model = np.zeros((len(places), 2, 3))
        model[:, :, 0] = -velocity
        model[:, 0, 1] = model[:, 1, 2] = 1.0
        innovation = drag - matrices.multiply(model, state[:, :, None])[:, :, 0]
        spread = matrices.multiply(model, covariance, model.transpose(0, 2, 1))
        spread[:, 0, 0] += noise * noise
        spread[:, 1, 1] += noise * noise
        determinant = spread[:, 0, 0] * spread[:, 1, 1] - spread[:, 0, 1] * spread[:, 1, 0]
        inverse = np.empty_like(spread)
        inverse[:, 0, 0], inverse[:, 1, 1] = spread[:, 1, 1], spread[:, 0, 0]
        inverse[:, 0, 1], inverse[:, 1, 0] = -spread[:, 0, 1], -spread[:, 1, 0]
        inverse /= determinant[:, None, None]
        square = matrices.multiply(innovation[:, None, :], inverse, innovation[:, :, None])[:, 0, 0]
        gain = matrices.multiply(covariance, model.transpose(0, 2, 1), inverse)
        corrected = covariance - matrices.multiply(gain, model, covariance)
        self._state[places] = state + matrices.multiply(gain, innovation[:, :, None])[:, :, 0]
        self._covariance[places] = 0.5 * (corrected + corrected.transpose(0, 2, 1))
        size: Floats = np.sqrt(np.maximum(0.5 * square, 0.0))
        return size


def lean_acceleration(roll: Floats, pitch: Floats, yaw: Floats) -> Floats:
    """(n, 2) acceleration in m/s², east and north, of level flight at an attitude (rad, MAVLink's ATTITUDE).

    Leans count to 60°.
    """
    steepest = np.pi / 3.0
    roll, pitch = np.clip(roll, -steepest, steepest), np.clip(pitch, -steepest, steepest)
    ahead, right = (
        -GRAVITY_MPS2 * elementwise.tan(pitch),
        GRAVITY_MPS2 * elementwise.tan(roll) / elementwise.cos(pitch),
    )
    east = ahead * elementwise.sin(yaw) + right * elementwise.cos(yaw)
    north = ahead * elementwise.cos(yaw) - right * elementwise.sin(yaw)
    return np.stack([east, north], axis=1)


POSITION, CLIMB, ACCELERATION, LEAN, BATTERY = "position", "climb", "acceleration", "lean", "battery"
_FIELDS: Final = ("lat", "lon", "alt", "relative_alt", "vx", "vy", "vz")
_GAP_S: Final = 30.0
"""Longer steps are not judged."""
_BEARABLE_MPS2: Final = 12.0
_ACCELERATION_MPS: Final = 2.0
"""Threshold of the sum of excess changes of velocity: two gusts, or 0.4 s at 5 m/s² above the bound."""
_WINDOW_S: Final = 2.0
_LEAN_NOISE_MPS2: Final = 0.5
_SAMPLING_MPS2: Final = 0.4
"""Error of a mean lean by one sample; that of n samples is n times less, because a manoeuvre's errors cancel."""
_LEAN_SHARE: Final = 0.45
_QUANTUM_PERCENT: Final = 1.0
_DRAIN_PERCENT_PER_S: Final = 1.0
_BATTERY_PERCENT: Final = 5.0
_AIRBORNE_M: Final = 2.0
_MOVING_MPS: Final = 1.0


@sky.detector(
    "motion.consistency",
    reduced="SAVIOR runs on board at 400 Hz with the commands of the motors and a model identified from earlier "
    "flights; this is at the station, at the rate of telemetry (2 Hz), without these commands",
)
class MotionConsistency(sky.TelemetryDetector):
    """Compares telemetry with a motion model: position, velocity, lean, battery (after SAVIOR, 2020)."""

    residuals: ClassVar = (POSITION, CLIMB, ACCELERATION, LEAN, BATTERY)

    allowance: sky.Number = sky.param(
        "The bias b of the CUSUM: a residual in standard deviations that adds nothing to it.",
        default=2.0, ge=0.0, le=100.0,
    )  # fmt: skip
    threshold: sky.Number = sky.param(
        "CUSUM of a residual, in standard deviations, that scores 1.", default=20.0, gt=0.0, le=1e6
    )
    position: sky.Series = sky.series("GLOBAL_POSITION_INT", *_FIELDS)
    attitude: sky.Series = sky.series("ATTITUDE", "roll", "pitch", "yaw")
    status: sky.Series = sky.series("SYS_STATUS", "battery_remaining", timed=False)
    drag: DragModels = sky.state(DragModels)
    begin: Floats = sky.table(3, dtype=np.float64)
    """Of each link end's window: its time, and the velocity east and north then; NaN without one."""
    leans: Floats = sky.table(3, dtype=np.float64)
    """Of each link end's window: accelerations by the lean, summed, and their number."""

    def compare(self, now: sky.Time, frames: sky.ObservedFrames) -> Sequence[sky.Alert]:
        """Judge the steps, the leans and the battery."""
        alerts = self._judge_steps(frames, self.position.read(frames))
        alerts += self._judge_lean(now, frames, self.attitude.read(frames))
        return alerts + self._judge_battery(frames, self.status.read(frames))

    def _judge_steps(self, frames: sky.ObservedFrames, steps: sky.Steps) -> list[sky.Alert]:
        steps = steps.take(np.flatnonzero((steps.seconds > 0.0) & (steps.seconds <= _GAP_S)))
        if not len(steps.places):
            return []
        errors, spread = step_errors(steps.before, steps.after, steps.seconds)
        aside, above = elementwise.hypot(errors[:, 0], errors[:, 1]), np.abs(errors[:, 2])
        change = elementwise.length(steps.after[:, 4:] - steps.before[:, 4:]) * 1e-2
        judged = (
            (POSITION, aside / spread - self.allowance, self.threshold, {"error_m": aside}),
            (CLIMB, above / spread - self.allowance, self.threshold, {"error_m": above}),
            (ACCELERATION, change - _BEARABLE_MPS2 * steps.seconds, _ACCELERATION_MPS, {"change_mps": change}),
        )
        alerts = []
        for name, excess, threshold, data in judged:
            scores = self.accumulate(name, steps.places, excess, threshold)
            alerts += self.alerts(name, frames, steps.places, steps.at_ns, scores, **data)
        return alerts

    def _judge_lean(self, now: sky.Time, frames: sky.ObservedFrames, steps: sky.Steps) -> list[sky.Alert]:
        count = len(frames.ports)
        self.drag.grow(count)
        self.begin, self.leans = grown(self.begin, count, np.nan), grown(self.leans, count)
        lean = lean_acceleration(*steps.after.T)
        np.add.at(self.leans, steps.places, np.column_stack([lean, np.ones(len(lean))]))
        time_s, values = self.position.time_s, self.position.values
        velocity = values[:, [5, 4]] * 1e-2
        flying = (values[:, 3] > _AIRBORNE_M * 1e3) | (elementwise.hypot(velocity[:, 0], velocity[:, 1]) > _MOVING_MPS)
        seconds = time_s - self.begin[:, 0]
        usable = flying & (seconds >= 0.0) & (seconds <= _GAP_S)
        places = np.flatnonzero(usable & (seconds >= _WINDOW_S) & (self.leans[:, 2] > 0.0))
        windows, samples = seconds[places], self.leans[places, 2]
        mean = 0.5 * (velocity[places] + self.begin[places, 1:])
        change = (velocity[places] - self.begin[places, 1:]) / windows[:, None]
        drag = change - self.leans[places, :2] / samples[:, None]
        noise = _LEAN_NOISE_MPS2 + _SAMPLING_MPS2 / samples
        size = self.drag.update(places, windows, mean, np.clip(drag, -1e3, 1e3), noise)
        restart = np.union1d(places, np.flatnonzero(~usable))
        self.begin[restart, 0], self.begin[restart, 1:] = time_s[restart], velocity[restart]
        self.leans[restart] = 0.0
        scores = self.accumulate(LEAN, places, size - self.allowance, _LEAN_SHARE * self.threshold)
        return self.alerts(
            LEAN, frames, places, now, scores, unexplained_mps2=elementwise.hypot(drag[:, 0], drag[:, 1])
        )

    def _judge_battery(self, frames: sky.ObservedFrames, steps: sky.Steps) -> list[sky.Alert]:
        known = (steps.before[:, 0] >= 0.0) & (steps.after[:, 0] >= 0.0) & (steps.seconds <= _GAP_S)
        steps = steps.take(np.flatnonzero(known & (steps.seconds >= 0.0)))
        change = steps.after[:, 0] - steps.before[:, 0]
        drained = -change - _DRAIN_PERCENT_PER_S * steps.seconds
        excess = np.maximum(drained, change) - _QUANTUM_PERCENT
        scores = self.accumulate(BATTERY, steps.places, excess, _BATTERY_PERCENT)
        return self.alerts(BATTERY, frames, steps.places, steps.at_ns, scores, change_percent=change)
