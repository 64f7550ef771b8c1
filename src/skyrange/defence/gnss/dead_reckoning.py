"""Inertial dead reckoning of some aircraft: alignment at rest, then strapdown integration, with a short history.

While rotors and body rest, gyroscopes are calibrated, the accelerometers give the vertical and the compass the heading
(TRIAD: Shuster and Oh, Three-axis attitude determination from vector observations, JGCD 4:1, 1981). In flight,
the angles and velocities that gyroscopes and accelerometers have integrated are added up, every 10 ms. Nothing of it
depends on GNSS.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.components import READINGS_NS, Floats, Sensors
from skyrange.core import elementary, elementwise, matrices
from skyrange.core.compiled import compiled
from skyrange.core.time import NS_PER_S, Time

STEP_NS: Final = READINGS_NS
HISTORY: Final = 128
"""Steps that are kept: 1.28 s, more than the age of any fix that an estimator uses (EK3_HRT_FILT, GPS_DELAY_MS)."""
ALIGN_STEPS: Final = 100
"""Steps at rest that an alignment takes at least: 1 s."""
_REST_RADPS: Final = 0.05
_REST_MPS2: Final = 1.0
_REST_ROTOR_RADPS: Final = 1.0
_GRAVITY_MPS2: Final = 9.80665
"""Rest: rates below 3 deg/s, 30 standard deviations of the gyroscopes at rest, 1 g to a tenth, and no rotor turns."""
_LIMIT: Final = 1e4
_POSITION, _VELOCITY, _FORCE, _ROTATION = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 18)
_NEVER: Final = -(1 << 62)
_OF_ROWS: Final = (
    "resting", "aligned", "since_ns", "_means", "_steps", "_body", "_bias", "_gravity", "_state", "_past", "_due",
)  # fmt: skip
"""Arrays with a row for each aircraft."""
Mask = NDArray[np.bool_]
Times = NDArray[np.int64]


@dataclass(slots=True, eq=False)
class DeadReckoning:
    """Attitude, velocity and position of each aircraft since it last stood still."""

    count: int
    field_gauss: tuple[float, float, float]
    """The Earth's field, east, north, up."""
    resting: Mask = field(init=False)
    aligned: Mask = field(init=False)
    """Whether it has stood still for long enough since it was last judged to rest."""
    since_ns: Times = field(init=False)
    """When each last began to rest."""
    _clock: Times = field(init=False)
    """(2,) The time of the last update, `_NEVER` before the first, and the place of its state in `_past`."""
    _means: Floats = field(init=False)
    _steps: Floats = field(init=False)
    _body: Floats = field(init=False)
    _bias: Floats = field(init=False)
    _gravity: Floats = field(init=False)
    _state: Floats = field(init=False)
    _past: Floats = field(init=False)
    _due: Mask = field(init=False)
    _rest: _Rest = field(init=False)

    def __post_init__(self) -> None:
        n = self.count
        self._clock = np.array([_NEVER, 0], dtype=np.int64)
        self.resting, self.aligned = np.zeros(n, dtype=np.bool_), np.zeros(n, dtype=np.bool_)
        self.since_ns = np.zeros(n, dtype=np.int64)
        self._due = np.zeros(n, dtype=np.bool_)
        self._means, self._steps = np.zeros((n, 9)), np.zeros(n)
        self._body = np.tile(np.eye(3), (n, 1, 1))
        self._bias, self._gravity = np.zeros((n, 3)), np.full(n, _GRAVITY_MPS2)
        self._state = np.zeros((n, 18))
        self._past = np.zeros((n, HISTORY, 18))
        self._rest = self._at_rest()

    def _at_rest(self) -> _Rest:
        return _Rest(self.resting, self.aligned, self.since_ns, self._means, self._steps, self._due)

    def join(self, others: Sequence[DeadReckoning]) -> DeadReckoning:
        """See `ReadingsTracker`."""
        joined = DeadReckoning(self.count + sum(other.count for other in others), self.field_gauss)
        first = 0
        for member in (self, *others):
            rows = slice(first, first + member.count)
            for name in _OF_ROWS:
                setattr(member, name, getattr(joined, name)[rows])
            member._clock, member._rest = joined._clock, member._at_rest()
            first = rows.stop
        return joined

    def update(self, now: Time, sensors: Sensors) -> None:
        """Integrate the readings of a tick if they are new."""
        last, newest = self._clock.tolist()
        if now // STEP_NS == last // STEP_NS:
            return
        self._clock[0] = now
        if last == _NEVER:
            return
        step_s = (now - last) / NS_PER_S
        readings = _Readings(sensors.gyro_radps, sensors.accel_mps2, sensors.compass_gauss, sensors.rotor_radps)
        if _judge_rest(now, readings, self._rest, self._state):
            for row in np.flatnonzero(self._due).tolist():
                self._align(row)
        _integrate(
            step_s, self.resting, sensors.delta_angle_rad, sensors.delta_velocity_mps, self._bias, self._gravity,
            self._body, self._state,
        )  # fmt: skip
        self._clock[1] = newest = (newest + 1) % HISTORY
        self._past[:, newest] = self._state

    def at(self, row: int, time: Time) -> tuple[Floats, Floats, Floats, Floats] | None:
        """Position (3,), velocity (3,), and since the start the integrals of specific force (3,) and attitude (3, 3).

        `None` for a time that the history does not reach.
        """
        last, newest = self._clock.tolist()
        if last == _NEVER:
            return None
        back = (last - time) / STEP_NS
        if not 0.0 <= back < HISTORY - 2:
            return None
        whole = int(back)
        part = back - whole
        newer, older = ((newest - whole - k) % HISTORY for k in (0, 1))
        state = (1.0 - part) * self._past[row, newer] + part * self._past[row, older]
        return state[_POSITION], state[_VELOCITY], state[_FORCE], state[_ROTATION].reshape(3, 3)

    def attitude(self, row: int) -> Floats:
        """(3, 3) Rotation from body to local."""
        return np.array(self._body[row])

    def _align(self, row: int) -> None:
        gyro, accel, compass = self._means[row].reshape(3, 3)
        self._bias[row], self._gravity[row] = gyro, elementwise.length(accel)
        here = _triad(np.array([0.0, 0.0, 1.0]), np.array(self.field_gauss))
        self._body[row] = matrices.multiply(here, _triad(accel, compass).T)


def _triad(first: Floats, second: Floats) -> Floats:
    """(3, 3) Orthonormal columns: along `first`, along first × second, and along the product of both."""
    first_axis = first / max(float(elementwise.length(first)), 1e-9)
    second_axis = np.cross(first_axis, second)
    second_axis = second_axis / max(float(elementwise.length(second_axis)), 1e-9)
    return np.stack([first_axis, second_axis, np.cross(first_axis, second_axis)], axis=1)


class _Readings(NamedTuple):
    """Readings of all aircraft at one tick."""

    gyro_radps: Floats
    accel_mps2: Floats
    compass_gauss: Floats
    rotor_radps: Floats


class _Rest(NamedTuple):
    """What is known of each aircraft at rest, and the means of its readings there."""

    resting: Mask
    aligned: Mask
    since_ns: Times
    means: Floats
    steps: Floats
    """How many readings the means are of."""
    due: Mask
    """Whether it is to be aligned now."""


@compiled
def _limited(reading: float) -> float:
    """A reading within the limits of any sensor; 0 for one that is not a number."""
    if np.isnan(reading):
        return 0.0
    return min(max(reading, -_LIMIT), _LIMIT)


@compiled
def _judge_rest(now: int, readings: _Readings, rest: _Rest, state: Floats) -> bool:
    """Tell aircraft at rest from others, and average the readings of those; whether any is `due` to be aligned."""
    gyro_radps, accel_mps2, compass_gauss, rotor_radps = readings
    resting, aligned, since_ns, means, steps, due = rest
    any_due = False
    for row in range(len(resting)):
        fastest, square = 0.0, 0.0
        for axis in range(3):
            fastest = max(fastest, abs(_limited(gyro_radps[row, axis])))
            square += _limited(accel_mps2[row, axis]) ** 2
        still = fastest < _REST_RADPS and abs(np.sqrt(square) - _GRAVITY_MPS2) < _REST_MPS2
        for rotor in range(rotor_radps.shape[1]):
            if rotor_radps[row, rotor] >= _REST_ROTOR_RADPS:
                still = False
        ends = resting[row] and not still
        due[row] = ends and aligned[row]
        if still and not resting[row]:
            means[row], state[row, :6] = 0.0, 0.0
            steps[row], since_ns[row], aligned[row] = 0.0, now, False
        if still:
            steps[row] += 1.0
            for axis in range(3):
                means[row, axis] += (_limited(gyro_radps[row, axis]) - means[row, axis]) / steps[row]
                means[row, 3 + axis] += (_limited(accel_mps2[row, axis]) - means[row, 3 + axis]) / steps[row]
                means[row, 6 + axis] += (_limited(compass_gauss[row, axis]) - means[row, 6 + axis]) / steps[row]
            aligned[row] = steps[row] >= ALIGN_STEPS
            due[row] = steps[row] == ALIGN_STEPS
        resting[row] = still
        any_due = any_due or due[row]
    return any_due


@compiled
def _integrate(  # noqa: PLR0917
    step_s: float,
    resting: Mask,
    turn: Floats,
    push: Floats,
    bias: Floats,
    gravity: Floats,
    body: Floats,
    state: Floats,
) -> None:
    """Strapdown integration of the aircraft that move, over one step, by its turns and pushes (n, 3)."""
    force, change = np.empty(3), np.empty(3)
    cross, rotated = np.zeros((3, 3)), np.empty((3, 3))
    for row in range(len(resting)):
        if resting[row]:
            continue
        x = _limited(turn[row, 0]) - bias[row, 0] * step_s
        y = _limited(turn[row, 1]) - bias[row, 1] * step_s
        z = _limited(turn[row, 2]) - bias[row, 2] * step_s
        px, py, pz = _limited(push[row, 0]), _limited(push[row, 1]), _limited(push[row, 2])
        # the push in the attitude of half the step: rotation by half of the turn, to first order
        px, py, pz = px + 0.5 * (y * pz - z * py), py + 0.5 * (z * px - x * pz), pz + 0.5 * (x * py - y * px)
        for axis in range(3):
            force[axis] = body[row, axis, 0] * px + body[row, axis, 1] * py + body[row, axis, 2] * pz
            change[axis] = force[axis]
        change[2] -= gravity[row] * step_s
        for axis in range(3):
            state[row, axis] += (state[row, 3 + axis] + 0.5 * change[axis]) * step_s
            state[row, 3 + axis] += change[axis]
            state[row, 6 + axis] += force[axis]
            for other in range(3):
                state[row, 9 + 3 * axis + other] += body[row, axis, other] * step_s
        cross[0, 1], cross[0, 2], cross[1, 0], cross[1, 2], cross[2, 0], cross[2, 1] = -z, y, z, -x, -y, x
        size = np.sqrt(x * x + y * y + z * z)
        sine, versine = 1.0, 0.5
        if size >= 1e-9:
            sine, versine = elementary.sin(size) / size, (1.0 - elementary.cos(size)) / size**2
        # Rodrigues' rotation by the turn
        for i in range(3):
            for j in range(3):
                product = 0.0
                for k in range(3):
                    turned = sine * cross[k, j]
                    for m in range(3):
                        turned += versine * cross[k, m] * cross[m, j]
                    product += body[row, i, k] * (turned + (1.0 if k == j else 0.0))
                rotated[i, j] = product
        body[row] = rotated
