"""Drag model of multirotors: the acceleration that the lean does not explain, identified in flight.

A multirotor accelerates where it leans, g tan(lean) in level flight, less the drag of its motion through the air. The
drag is taken as linear in the air speed: d = -k (v - w) with a coefficient k and the wind w, so d = -k v + c with
c = k w. A Kalman filter of k and c (east, north), which wander slowly, predicts d for the velocity of each window.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from skyrange.contracts.frames import Ints
from skyrange.detect.series import Floats, grown

GRAVITY_MPS2: Final = 9.80665
_PRIOR: Final = (0.3, 0.0, 0.0)
_PRIOR_VARIANCE: Final = (0.15**2, 2.0**2, 2.0**2)
"""k in 1/s: 0.1 to 0.5 for multirotors of 0.5 to 2 kg; c in m/s²: a wind of 6 m/s."""
_WANDER: Final = (0.01**2, 0.1**2, 0.1**2)
"""Variance per second: c follows gusts of moderate turbulence within 10 s."""


class DragModels:
    """The drag models of all link ends, (ends,) each."""

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
        innovation = drag - (model @ state[:, :, None])[:, :, 0]
        spread = model @ covariance @ model.transpose(0, 2, 1)
        spread[:, 0, 0] += noise**2
        spread[:, 1, 1] += noise**2
        determinant = spread[:, 0, 0] * spread[:, 1, 1] - spread[:, 0, 1] * spread[:, 1, 0]
        inverse = np.empty_like(spread)
        inverse[:, 0, 0], inverse[:, 1, 1] = spread[:, 1, 1], spread[:, 0, 0]
        inverse[:, 0, 1], inverse[:, 1, 0] = -spread[:, 0, 1], -spread[:, 1, 0]
        inverse /= determinant[:, None, None]
        square = (innovation[:, None, :] @ inverse @ innovation[:, :, None])[:, 0, 0]
        gain = covariance @ model.transpose(0, 2, 1) @ inverse
        corrected = covariance - gain @ model @ covariance
        self._state[places] = state + (gain @ innovation[:, :, None])[:, :, 0]
        self._covariance[places] = 0.5 * (corrected + corrected.transpose(0, 2, 1))
        size: Floats = np.sqrt(np.maximum(0.5 * square, 0.0))
        return size


def lean_acceleration(roll: Floats, pitch: Floats, yaw: Floats) -> Floats:
    """(n, 2) acceleration in m/s², east and north, of level flight at an attitude (rad, MAVLink's ATTITUDE).

    Leans count to 60°.
    """
    steepest = np.pi / 3.0
    roll, pitch = np.clip(roll, -steepest, steepest), np.clip(pitch, -steepest, steepest)
    ahead, right = -GRAVITY_MPS2 * np.tan(pitch), GRAVITY_MPS2 * np.tan(roll) / np.cos(pitch)
    east = ahead * np.sin(yaw) + right * np.cos(yaw)
    north = ahead * np.cos(yaw) - right * np.sin(yaw)
    return np.stack([east, north], axis=1)
