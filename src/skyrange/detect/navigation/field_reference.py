"""Magnetic field that each aircraft should measure: the field of the Earth and the bias of its compass, estimated.

A Kalman filter with six states for each link end, as the magnetic states of PX4's EKF2: the field north, east and down,
and the bias forward, right and down, both nearly constant. Attitudes are taken as exact.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from skyrange.contracts.frames import Ints
from skyrange.detect.series import Floats, grown

NOISE_GAUSS: Final = 0.05
"""EKF2_MAG_NOISE, its default: of a measurement, and of the states at the beginning."""
_GROWTH: Final = np.repeat([1e-8, 1e-10], 3)
"""Growth of variances in gauss²/s: EKF2_MAG_E_NOISE and EKF2_MAG_B_NOISE, 1e-3 and 1e-4 gauss/s, in steps of 10 ms."""
_MOST_S: Final = 60.0


class FieldReference:
    """The estimates of all link ends. Each end at most once in a call; its first field begins the estimate."""

    def __init__(self) -> None:
        self._states: Floats = np.zeros((0, 6))
        self._covariances: Floats = np.zeros((0, 6, 6))

    def predict(self, places: Ints, fields: Floats, turns: Floats, seconds: Floats) -> Floats:
        """Innovations (n, 3) of fields in the body frame, in standard deviations of each.

        `fields` are (n, 3) in gauss; `turns` are (n, 3, 3), from the body to north, east and down; `seconds` since the
        last field of the end, which may be NaN.
        """
        count = int(places.max(initial=-1)) + 1
        self._states = grown(self._states, count, np.nan)
        self._covariances = grown(self._covariances, count)
        fresh = np.flatnonzero(np.isnan(self._states[places, 0]))
        ends = places[fresh]
        self._states[ends, :3] = (turns[fresh] * fields[fresh, None, :]).sum(axis=2)
        self._states[ends, 3:] = 0.0
        self._covariances[ends] = np.eye(6) * NOISE_GAUSS**2
        growth = np.clip(np.nan_to_num(seconds), 0.0, _MOST_S)
        self._covariances[places] += growth[:, None, None] * np.diag(_GROWTH)
        ratios = np.empty((len(places), 3))
        for axis in range(3):
            innovation, variance, _ = self._compare(places, fields, turns, axis)
            ratios[:, axis] = innovation / np.sqrt(variance)
        return ratios

    def update(self, places: Ints, fields: Floats, turns: Floats) -> None:
        """Fuse fields, one axis after another."""
        for axis in range(3):
            innovation, variance, cross = self._compare(places, fields, turns, axis)
            gain = cross / variance[:, None]
            self._states[places] += gain * innovation[:, None]
            self._covariances[places] -= gain[:, :, None] * cross[:, None, :]

    def _compare(self, places: Ints, fields: Floats, turns: Floats, axis: int) -> tuple[Floats, Floats, Floats]:
        """Of one axis: (n,) innovations, their (n,) variances, and their (n, 6) covariances with the states."""
        row = np.concatenate([turns[:, :, axis], np.broadcast_to(np.eye(3)[axis], (len(places), 3))], axis=1)
        cross = (self._covariances[places] * row[:, None, :]).sum(axis=2)
        innovation = fields[:, axis] - (self._states[places] * row).sum(axis=1)
        return innovation, (cross * row).sum(axis=1) + NOISE_GAUSS**2, cross


def turns_to_earth(roll: Floats, pitch: Floats, yaw: Floats) -> Floats:
    """The (n, 3, 3) matrices from the body frame (forward, right, down) to north, east and down, by angles in rad."""
    (cr, cp, cy), (sr, sp, sy) = (np.cos(a) for a in (roll, pitch, yaw)), (np.sin(a) for a in (roll, pitch, yaw))
    rows = (
        (cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy),
        (cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy),
        (-sp, sr * cp, cr * cp),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
