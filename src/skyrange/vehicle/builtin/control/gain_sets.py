"""Gain sets: parameters and gains of the loop, stored once for all aircraft with equal values.

Of a thousand aircraft most have the same parameters. Stored per aircraft, they and the gains computed from them would
be the larger part of the data that the processor loads in every tick.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from skyrange.core.time import NS_PER_MS, Time
from skyrange.vehicle.builtin.control import gains
from skyrange.vehicle.builtin.layout import GAINS, Records, new_records
from skyrange.world.airframes import AIRFRAMES

UPDATE_NS = 100 * NS_PER_MS
"""A parameter changed in flight takes effect in the loop within this time."""


class GainSets:
    """The distinct sets of parameters among some aircraft. A deep copy continues identically."""

    def __init__(self, airframes: Sequence[str], settings: Records) -> None:
        """`airframes` names each aircraft's airframe; `settings` (n,) SETTINGS may change later: see `update`."""
        self._settings = settings
        names = sorted(set(airframes))
        self._names = names
        self._frames = np.array([names.index(name) for name in airframes], dtype=np.int64)
        self._applied = b""
        self._dt_s = 0.0
        self.set_index: NDArray[np.int64] = np.zeros(len(airframes), dtype=np.int64)
        """(n,) row of each aircraft in `settings` and `gains`."""
        self.parameter_sets: Records = settings[:0].copy()
        """(sets,) SETTINGS."""
        self.gains: Records = new_records(GAINS, 0)
        """(sets,) GAINS."""

    def computed_for(self, dt_s: float) -> bool:
        """Whether the gains are those for this step."""
        return dt_s == self._dt_s

    def update(self, now: Time, dt_s: float) -> None:
        """Apply changed parameters; `dt_s` is the step that the gains are computed for."""
        if dt_s == self._dt_s and now % UPDATE_NS != 0:
            return
        seen = self._settings.tobytes()
        if dt_s == self._dt_s and seen == self._applied:
            return
        self._applied, self._dt_s = seen, dt_s
        keys = np.hstack(
            [self._settings.view(np.uint8).reshape(len(self.set_index), -1), self._frames.view(np.uint8).reshape(-1, 8)]
        )
        _, first, set_index = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        self.set_index = set_index.reshape(-1).astype(np.int64)
        self.parameter_sets = self._settings[first]
        self.gains = new_records(GAINS, len(first))
        for row, frame in enumerate(self._frames[first].tolist()):
            gains.set_motor_factors(self.gains, row, AIRFRAMES[self._names[frame]])
            gains.compute_gains(self.gains[row], self.parameter_sets[row], dt_s)
