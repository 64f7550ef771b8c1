"""Multi-sensor detector: sensors of one aircraft that measure the same, against each other.

It reads SCALED_PRESSURE, GPS_RAW_INT, GLOBAL_POSITION_INT, VFR_HUD and ATTITUDE. The stream profile `operator` carries
all of them. `light` has ATTITUDE and GLOBAL_POSITION_INT, hence the residuals `heading` and `turn` alone.

The residuals:

- `gnss_height`, `fused_height`: the altitude of fixes, and that of the estimate, less the altitude of the barometer in
  the standard atmosphere (ISO 2533), relative to their usual difference (mean over 300 s: weather). The mean over 5 s
  is compared with 8 m, three standard deviations of a difference of two heights of GNSS: one is 1.9 m (1.5 times 1.5 m
  circular error probable, data sheet of the u-blox SAM-M10Q), two are 2.7 m.
- `heading`: the compass heading against the course over ground, in straight flight above 3 m/s. By default
  (ArduCopter's WP_YAW_BEHAVIOR) a multirotor in AUTO and in GUIDED faces its next waypoint. What exceeds 30° (wind, a
  corner) is added up over time, and compared with 150 degree-seconds: 60° for 5 s.
- `turn`: the change of heading against the rate of the gyroscope, by a CUSUM of what exceeds 3 standard deviations:
  0.03 rad, and the error of the trapezoid rule at 2 rad/s² (t²/12). The threshold is 25.
- `air_speed`: the air speed less the ground speed, relative to its usual difference (mean over 60 s: wind). The mean
  over 5 s is compared with 12 m/s, the wind in which multirotors of up to 2 kg may fly: so a turn in the wind is below.
  Without an air speed sensor ArduCopter sends the receiver's ground speed, and the two agree.

Air speed and drag by the lean are compared in `motion.consistency`, its residual `lean`.

It cannot detect horizontal false fixes that the aircraft follows, nor a false compass from before the take-off on in
hover. A barometer that ages, a pilot who flies sideways and a crash are reported as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import ClassVar, Final

import numpy as np

import skyrange.plugin as sky
from skyrange.core import elementwise
from skyrange.detect.sensor_values import pressure_altitude_m
from skyrange.detect.series import Flags, Floats, MovingMean

GNSS_HEIGHT, FUSED_HEIGHT, HEADING, TURN, AIR_SPEED = "gnss_height", "fused_height", "heading", "turn", "air_speed"
_MEAN_S: Final = 5.0
_USUAL_HEIGHT_S: Final = 300.0
_USUAL_WIND_S: Final = 60.0
_STALE_S: Final = 2.0
_FAST_MPS: Final = 3.0
_STRAIGHT_RAD_PER_S: Final = 0.2
_HEADING_RAD: Final = np.radians(30.0)
_HEADING_SUM: Final = np.radians(150.0)
_NO_HEADING: Final = 65_535
_TURN_RAD: Final = 0.03
_TURN_RAD_PER_S2: Final = 2.0
_TURN_ALLOWANCE: Final = 3.0
_TURN_SUM: Final = 25.0
_FIX_3D: Final = 3


class _Change:
    """The change of a difference from what is usual: a short mean less a long one, of each link end."""

    def __init__(self, usual_s: float) -> None:
        self._usual, self._recent = MovingMean(usual_s), MovingMean(_MEAN_S)

    def add(self, steps: sky.Steps, difference: Floats) -> Floats:
        """The (n,) changes after each of n values; 0 where there is none."""
        seconds = np.minimum(steps.seconds, _STALE_S)
        usual = self._usual.add(steps.places, seconds, difference)
        recent = self._recent.add(steps.places, seconds, difference)
        return np.nan_to_num(recent - usual)


@sky.detector("navigation.multi_sensor")
class MultiSensor(sky.TelemetryDetector):
    """Compares the sensors of an aircraft: barometer and GNSS, compass and course, gyroscope, air speed."""

    residuals: ClassVar = (GNSS_HEIGHT, FUSED_HEIGHT, HEADING, TURN, AIR_SPEED)

    height_m: sky.Number = sky.param(
        "Change of a difference of altitudes that scores 1, in metres.", default=8.0, gt=0.0, le=1e5
    )
    air_speed_mps: sky.Number = sky.param(
        "Change of air speed less ground speed that scores 1, in m/s.", default=12.0, gt=0.0, le=1e3
    )
    pressure: sky.Series = sky.series("SCALED_PRESSURE", "press_abs")
    fix: sky.Series = sky.series("GPS_RAW_INT", "alt", "fix_type", "time_usec", timed=False)
    fused: sky.Series = sky.series("GLOBAL_POSITION_INT", "alt", "vx", "vy", "hdg")
    hud: sky.Series = sky.series("VFR_HUD", "airspeed", "groundspeed", timed=False)
    attitude: sky.Series = sky.series("ATTITUDE", "yaw", "yawspeed")
    gnss_height: _Change = sky.state(partial(_Change, _USUAL_HEIGHT_S))
    fused_height: _Change = sky.state(partial(_Change, _USUAL_HEIGHT_S))
    wind: _Change = sky.state(partial(_Change, _USUAL_WIND_S))

    def compare(self, now: sky.Time, frames: sky.ObservedFrames) -> Sequence[sky.Alert]:
        """Judge heights, headings, turns and air speeds."""
        self.pressure.read(frames)
        fixes, fused = self.fix.read(frames), self.fused.read(frames)
        has_fix = fixes.after[:, 1] >= _FIX_3D
        alerts = self._judge_height(frames, GNSS_HEIGHT, self.gnss_height, fixes, fixes.after[:, 2] * 1e-6, has_fix)
        has_estimate = np.ones(len(fused.places), dtype=np.bool_)
        alerts += self._judge_height(frames, FUSED_HEIGHT, self.fused_height, fused, fused.time_s, has_estimate)
        alerts += self._judge_heading(frames, fused)
        alerts += self._judge_turn(frames, self.attitude.read(frames))
        hud = self.hud.read(frames)
        change = np.abs(self.wind.add(hud, hud.after[:, 0] - hud.after[:, 1]))
        scores = change / self.air_speed_mps
        return alerts + self.alerts(AIR_SPEED, frames, hud.places, hud.at_ns, scores, change_mps=change)

    def _judge_height(
        self, frames: sky.ObservedFrames, name: str, change: _Change, steps: sky.Steps, time_s: Floats, usable: Flags
    ) -> list[sky.Alert]:
        pressure = self.pressure.values[steps.places, 0]
        fresh = usable & (np.abs(time_s - self.pressure.time_s[steps.places]) <= _STALE_S) & (pressure > 0.0)
        height = pressure_altitude_m(np.where(fresh, pressure, np.nan))
        moved = np.abs(change.add(steps, steps.after[:, 0] * 1e-3 - height))
        scores = moved / self.height_m
        return self.alerts(name, frames, steps.places, steps.at_ns, scores, change_m=moved)

    def _judge_heading(self, frames: sky.ObservedFrames, steps: sky.Steps) -> list[sky.Alert]:
        before, after = steps.before, steps.after
        course, previous = (
            elementwise.atan2(after[:, 2], after[:, 1]),
            elementwise.atan2(before[:, 2], before[:, 1]),
        )
        speed = (
            np.minimum(elementwise.hypot(after[:, 1], after[:, 2]), elementwise.hypot(before[:, 1], before[:, 2]))
            * 1e-2
        )
        straight = np.abs(_wrapped(course - previous)) <= _STRAIGHT_RAD_PER_S * steps.seconds
        judged = straight & (speed >= _FAST_MPS) & (steps.seconds > 0.0) & (after[:, 3] < _NO_HEADING)
        away = np.abs(_wrapped(np.radians(after[:, 3] * 1e-2) - course))
        excess = np.where(judged, (away - _HEADING_RAD) * np.minimum(steps.seconds, _STALE_S), 0.0)
        scores = self.accumulate(HEADING, steps.places, excess, _HEADING_SUM)
        return self.alerts(HEADING, frames, steps.places, steps.at_ns, scores, difference_deg=np.degrees(away))

    def _judge_turn(self, frames: sky.ObservedFrames, steps: sky.Steps) -> list[sky.Alert]:
        seconds = np.where((steps.seconds > 0.0) & (steps.seconds <= _STALE_S), steps.seconds, np.nan)
        rate = 0.5 * (steps.before[:, 1] + steps.after[:, 1])
        away = np.abs(_wrapped(steps.after[:, 0] - steps.before[:, 0] - rate * seconds))
        spread = elementwise.hypot(_TURN_RAD, _TURN_RAD_PER_S2 * (seconds * seconds) / 12.0)
        scores = self.accumulate(TURN, steps.places, away / spread - _TURN_ALLOWANCE, _TURN_SUM)
        return self.alerts(TURN, frames, steps.places, steps.at_ns, scores, difference_deg=np.degrees(away))


def _wrapped(angle: Floats) -> Floats:
    """The angle in -π … π."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi
