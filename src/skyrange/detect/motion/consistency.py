"""Motion consistency detector: the telemetry of each aircraft against a motion model of a multirotor.

It reads GLOBAL_POSITION_INT, ATTITUDE and SYS_STATUS, which the stream profiles `light` and `operator` both carry.

The method is that of R. Quinonez, J. Giraldo, L. Salazar, E. Bauman, A. Cardenas and Z. Lin, "SAVIOR: Securing
Autonomous Vehicles with Robust Physical Invariants", USENIX Security 2020, p. 895-912: a nonlinear model of the vehicle
predicts each measurement, and a CUSUM of the residual's absolute value, less a bias b, is compared with a threshold.
The residuals here are:

- `position`: the horizontal step between two positions, less the mean of their velocities times the time;
- `climb`: the same vertically;
- `acceleration`: the part of a change of velocity above 12 m/s², which a multirotor reaches at a lean of 50°;
- `lean`: the acceleration that the lean does not explain, against a drag model identified in flight (`drag_model`);
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
from typing import Final

import numpy as np
from pydantic import Field

from skyrange.contracts.alerts import Alert
from skyrange.contracts.detectors import DetectorContext, DetectorPlugin
from skyrange.contracts.monitors import Monitor, ObservedFrames
from skyrange.contracts.params import Number
from skyrange.core.time import NS_PER_MS, Time
from skyrange.detect.episodes import EpisodeParams
from skyrange.detect.motion.drag_model import DragModels, lean_acceleration
from skyrange.detect.residuals import Residuals
from skyrange.detect.series import Floats, Series, Steps, grown, step_errors

KIND = "motion.consistency"
"""The kind of its alerts."""
ABOUT = "Compares telemetry with a motion model: position, velocity, lean, battery (after SAVIOR, 2020)."
SERVICE_NS: Time = 500 * NS_PER_MS

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


class ConsistencyParams(EpisodeParams):
    """Parameters of the motion consistency detector."""

    allowance: Number = Field(
        default=2.0,
        ge=0.0,
        le=100.0,
        description="The bias b of the CUSUM: a residual in standard deviations that adds nothing to it.",
    )
    threshold: Number = Field(
        default=20.0, gt=0.0, le=1e6, description="CUSUM of a residual, in standard deviations, that scores 1."
    )


class MotionConsistency:
    """A `skyrange.contracts.monitors.Monitor`: alerts for the aircraft whose telemetry does not fit the model.

    The subject of an alert is the owner of the link. Its score is the CUSUM over its threshold. `data` has the link and
    the name of the residual.
    """

    service_ns: Time = SERVICE_NS

    def __init__(self, params: ConsistencyParams) -> None:
        self._allowance, self._threshold = params.allowance, params.threshold
        names = (POSITION, CLIMB, ACCELERATION, LEAN, BATTERY)
        self._residuals = Residuals(KIND, names, params)
        self._position = Series("GLOBAL_POSITION_INT", _FIELDS)
        self._attitude = Series("ATTITUDE", ("roll", "pitch", "yaw"))
        self._status = Series("SYS_STATUS", ("battery_remaining",), timed=False)
        self._drag = DragModels()
        self._begin: Floats = np.zeros((0, 3))
        """Of each link end's window: its time, and the velocity east and north then; NaN without one."""
        self._sums: Floats = np.zeros((0, 3))
        """Of each link end's window: accelerations by the lean, summed, and their number."""

    def observe(self, now: Time, frames: ObservedFrames) -> Sequence[Alert]:
        """Compare what has arrived since the last service."""
        arrived = frames.take(frames.received)
        alerts = self._judge_steps(arrived, self._position.read(arrived))
        alerts += self._judge_lean(now, arrived, self._attitude.read(arrived))
        alerts += self._judge_battery(arrived, self._status.read(arrived))
        return alerts

    def _judge_steps(self, frames: ObservedFrames, steps: Steps) -> list[Alert]:
        rows = np.flatnonzero((steps.seconds > 0.0) & (steps.seconds <= _GAP_S))
        if not len(rows):
            return []
        places, at_ns, seconds = steps.places[rows], steps.at_ns[rows], steps.seconds[rows]
        before, after = steps.before[rows], steps.after[rows]
        errors, spread = step_errors(before, after, seconds)
        aside, above = np.hypot(errors[:, 0], errors[:, 1]), np.abs(errors[:, 2])
        change = np.linalg.norm(after[:, 4:] - before[:, 4:], axis=1) * 1e-2
        judged = (
            (POSITION, aside / spread - self._allowance, self._threshold, {"error_m": aside}),
            (CLIMB, above / spread - self._allowance, self._threshold, {"error_m": above}),
            (ACCELERATION, change - _BEARABLE_MPS2 * seconds, _ACCELERATION_MPS, {"change_mps": change}),
        )
        alerts = []
        for name, excess, threshold, data in judged:
            scores = self._residuals.add(name, places, excess, threshold)
            alerts += self._residuals.raise_alerts(name, frames.ports, places, at_ns, scores, data)
        return alerts

    def _judge_lean(self, now: Time, frames: ObservedFrames, steps: Steps) -> list[Alert]:
        count = len(frames.ports)
        self._drag.grow(count)
        self._begin, self._sums = grown(self._begin, count, np.nan), grown(self._sums, count)
        lean = lean_acceleration(*steps.after.T)
        np.add.at(self._sums, steps.places, np.column_stack([lean, np.ones(len(lean))]))
        time_s, values = self._position.time_s, self._position.values
        velocity = values[:, [5, 4]] * 1e-2
        flying = (values[:, 3] > _AIRBORNE_M * 1e3) | (np.hypot(velocity[:, 0], velocity[:, 1]) > _MOVING_MPS)
        seconds = time_s - self._begin[:, 0]
        usable = flying & (seconds >= 0.0) & (seconds <= _GAP_S)
        places = np.flatnonzero(usable & (seconds >= _WINDOW_S) & (self._sums[:, 2] > 0.0))
        windows, samples = seconds[places], self._sums[places, 2]
        mean = 0.5 * (velocity[places] + self._begin[places, 1:])
        drag = (velocity[places] - self._begin[places, 1:]) / windows[:, None] - self._sums[places, :2] / samples[
            :, None
        ]
        noise = _LEAN_NOISE_MPS2 + _SAMPLING_MPS2 / samples
        size = self._drag.update(places, windows, mean, np.clip(drag, -1e3, 1e3), noise)
        restart = np.union1d(places, np.flatnonzero(~usable))
        self._begin[restart, 0], self._begin[restart, 1:] = time_s[restart], velocity[restart]
        self._sums[restart] = 0.0
        scores = self._residuals.add(LEAN, places, size - self._allowance, _LEAN_SHARE * self._threshold)
        data = {"unexplained_mps2": np.hypot(drag[:, 0], drag[:, 1])}
        return self._residuals.raise_alerts(LEAN, frames.ports, places, now, scores, data)

    def _judge_battery(self, frames: ObservedFrames, steps: Steps) -> list[Alert]:
        known = (steps.before[:, 0] >= 0.0) & (steps.after[:, 0] >= 0.0) & (steps.seconds <= _GAP_S)
        rows = np.flatnonzero(known & (steps.seconds >= 0.0))
        places, at_ns = steps.places[rows], steps.at_ns[rows]
        change = steps.after[rows, 0] - steps.before[rows, 0]
        drained = -change - _DRAIN_PERCENT_PER_S * steps.seconds[rows]
        excess = np.maximum(drained, change) - _QUANTUM_PERCENT
        scores = self._residuals.add(BATTERY, places, excess, _BATTERY_PERCENT)
        return self._residuals.raise_alerts(BATTERY, frames.ports, places, at_ns, scores, {"change_percent": change})


def make_consistency(params: ConsistencyParams, context: DetectorContext | None = None) -> Monitor:
    """A new detector."""
    return MotionConsistency(params)


CONSISTENCY = DetectorPlugin(ConsistencyParams, make_consistency, ABOUT)
