"""Inertial dead reckoning of some aircraft: alignment at rest, then strapdown integration, with a short history.

While rotors and body rest, gyroscopes are calibrated, the accelerometers give the vertical and the compass the heading
(TRIAD: Shuster and Oh, Three-axis attitude determination from vector observations, JGCD 4:1, 1981). In flight,
gyroscopes and accelerometers alone are integrated, every 10 ms. Nothing of it depends on GNSS.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.components import Floats, Sensors
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time

STEP_NS: Final = 10 * NS_PER_MS
HISTORY: Final = 128
"""Steps that are kept: 1.28 s, more than the age of any fix that an estimator uses (EK3_HRT_FILT, GPS_DELAY_MS)."""
ALIGN_STEPS: Final = 100
"""Steps at rest that an alignment takes at least: 1 s."""
_REST_RADPS: Final = 0.05
_REST_MPS2: Final = 1.0
"""Rest: rates below 3 deg/s, 30 standard deviations of the gyroscopes at rest, and 1 g to a tenth."""
_LIMIT: Final = 1e4
_POSITION, _VELOCITY, _FORCE, _ROTATION = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 18)
Mask = NDArray[np.bool_]


@dataclass(slots=True, eq=False)
class DeadReckoning:
    """Attitude, velocity and position of each aircraft since it last stood still."""

    count: int
    field_gauss: tuple[float, float, float]
    """The Earth's field, east, north, up."""
    resting: Mask = field(init=False)
    aligned: Mask = field(init=False)
    """Whether it has stood still for long enough since it was last judged to rest."""
    since_ns: list[Time] = field(init=False)
    """When each last began to rest."""
    _last_ns: Time = -1
    _step_ns: Time = -1
    _turn: Floats = field(init=False)
    _push: Floats = field(init=False)
    _means: Floats = field(init=False)
    _steps: Floats = field(init=False)
    _body: Floats = field(init=False)
    _bias: Floats = field(init=False)
    _gravity: Floats = field(init=False)
    _state: Floats = field(init=False)
    _past: Floats = field(init=False)
    _newest: int = 0

    def __post_init__(self) -> None:
        n = self.count
        self.resting, self.aligned = np.zeros(n, dtype=np.bool_), np.zeros(n, dtype=np.bool_)
        self.since_ns = [0] * n
        self._turn, self._push = np.zeros((n, 3)), np.zeros((n, 3))
        self._means, self._steps = np.zeros((n, 9)), np.zeros(n)
        self._body = np.tile(np.eye(3), (n, 1, 1))
        self._bias, self._gravity = np.zeros((n, 3)), np.full(n, 9.80665)
        self._state = np.zeros((n, 18))
        self._past = np.zeros((n, HISTORY, 18))

    def update(self, now: Time, sensors: Sensors) -> None:
        """Take in the readings of a tick; integrate once a step is complete."""
        dt_s = 0.0 if self._last_ns < 0 else (now - self._last_ns) / NS_PER_S
        self._last_ns = now
        gyro = np.nan_to_num(np.clip(sensors.gyro_radps, -_LIMIT, _LIMIT))
        accel = np.nan_to_num(np.clip(sensors.accel_mps2, -_LIMIT, _LIMIT))
        self._turn += gyro * dt_s
        self._push += accel * dt_s
        if self._step_ns < 0:
            self._step_ns = now
            return
        if now - self._step_ns < STEP_NS:
            return
        step_s = (now - self._step_ns) / NS_PER_S
        self._step_ns = now
        self._judge_rest(now, gyro, accel, sensors)
        moving = ~self.resting
        if moving.any():
            self._integrate(moving, step_s)
        self._turn[:], self._push[:] = 0.0, 0.0
        self._newest = (self._newest + 1) % HISTORY
        self._past[:, self._newest] = self._state

    def at(self, row: int, time: Time) -> tuple[Floats, Floats, Floats, Floats] | None:
        """Position (3,), velocity (3,), and since the start the integrals of specific force (3,) and attitude (3, 3).

        `None` for a time that the history does not reach.
        """
        back = (self._step_ns - time) / STEP_NS
        if not 0.0 <= back < HISTORY - 2:
            return None
        whole = int(back)
        part = back - whole
        newer, older = ((self._newest - whole - k) % HISTORY for k in (0, 1))
        state = (1.0 - part) * self._past[row, newer] + part * self._past[row, older]
        return state[_POSITION], state[_VELOCITY], state[_FORCE], state[_ROTATION].reshape(3, 3)

    def attitude(self, row: int) -> Floats:
        """(3, 3) Rotation from body to local."""
        return np.array(self._body[row])

    def _judge_rest(self, now: Time, gyro: Floats, accel: Floats, sensors: Sensors) -> None:
        """Tell aircraft at rest from others, average the readings of those, and align those that begin to move."""
        weight = np.abs(np.linalg.norm(accel, axis=1) - 9.80665)
        still = (np.abs(gyro).max(axis=1) < _REST_RADPS) & (weight < _REST_MPS2)
        still &= np.nan_to_num(sensors.rotor_radps).max(axis=1) < 1.0
        begins, ends = still & ~self.resting, self.resting & ~still
        for row in np.flatnonzero(begins).tolist():
            self._means[row], self._steps[row], self.since_ns[row] = 0.0, 0.0, now
            self._state[row, :6] = 0.0
            self.aligned[row] = False
        if still.any():
            compass = np.nan_to_num(np.clip(sensors.compass_gauss, -_LIMIT, _LIMIT))
            readings = np.concatenate([gyro, accel, compass], axis=1)[still]
            self._steps[still] += 1.0
            self._means[still] += (readings - self._means[still]) / self._steps[still, None]
            self.aligned[still] = self._steps[still] >= ALIGN_STEPS
        for row in np.flatnonzero((still & (self._steps == ALIGN_STEPS)) | (ends & self.aligned)).tolist():
            self._align(row)
        self.resting = still

    def _align(self, row: int) -> None:
        gyro, accel, compass = self._means[row].reshape(3, 3)
        self._bias[row], self._gravity[row] = gyro, np.linalg.norm(accel)
        here = _triad(np.array([0.0, 0.0, 1.0]), np.array(self.field_gauss))
        self._body[row] = here @ _triad(accel, compass).T

    def _integrate(self, moving: Mask, step_s: float) -> None:
        turn = self._turn[moving] - self._bias[moving] * step_s
        push = self._push[moving]
        body = self._body[moving]
        force = np.einsum("nij,nj->ni", body, push + 0.5 * np.cross(turn, push))
        state = self._state[moving]
        change = force.copy()
        change[:, 2] -= self._gravity[moving] * step_s
        state[:, _POSITION] += (state[:, _VELOCITY] + 0.5 * change) * step_s
        state[:, _VELOCITY] += change
        state[:, _FORCE] += force
        state[:, _ROTATION] += body.reshape(-1, 9) * step_s
        self._state[moving] = state
        self._body[moving] = body @ _rotation(turn)


def _triad(first: Floats, second: Floats) -> Floats:
    """(3, 3) Orthonormal columns: along `first`, along first × second, and along the product of both."""
    one = first / max(float(np.linalg.norm(first)), 1e-9)
    two = np.cross(one, second)
    two = two / max(float(np.linalg.norm(two)), 1e-9)
    return np.stack([one, two, np.cross(one, two)], axis=1)


def _rotation(turn: Floats) -> Floats:
    """(n, 3, 3) Rotations by (n, 3) vectors (Rodrigues)."""
    angle = np.linalg.norm(turn, axis=1)
    safe = np.maximum(angle, 1e-12)
    cross = np.zeros((len(turn), 3, 3))
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -turn[:, 2], turn[:, 1], -turn[:, 0]
    cross[:, 1, 0], cross[:, 2, 0], cross[:, 2, 1] = turn[:, 2], -turn[:, 1], turn[:, 0]
    sine, versine = np.sin(angle) / safe, (1.0 - np.cos(angle)) / safe**2
    sine[angle < 1e-9], versine[angle < 1e-9] = 1.0, 0.5
    return np.asarray(np.eye(3) + sine[:, None, None] * cross + versine[:, None, None] * (cross @ cross))
