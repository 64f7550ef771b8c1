"""Base of kinds that transmit on GPS L1 from one place: they affect receivers by the power at their antennas.

What is not a signal that a receiver follows is noise to it: from the noise follow its C/N0, its satellites, its errors
and, in the end, the loss of its fix.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import sqrt
from typing import ClassVar, Final

import numpy as np

from skyrange.attack.bases.gnss.emitter import FIX_NONE, HORIZON_DBIC, LEAST_DBIC, ZENITH_DBIC, Emitter, emitter_at
from skyrange.attack.bases.gnss.fixes import UNALTERED, OnReceivers
from skyrange.attack.bases.gnss.receiver_noise import JammedReceiver, error_growth
from skyrange.attack.contract import Attack, AttackContext, Place
from skyrange.contracts.components import Floats, Sensors
from skyrange.contracts.params import Number
from skyrange.contracts.plugins.form import param
from skyrange.core.chance import Chance
from skyrange.core.elementary_python import add_up
from skyrange.core.ids import hash64
from skyrange.core.time import from_seconds

NOTICEABLE: Final = 1.05
"""A fix with all satellites and less than this times its usual error is left as it is."""
DEGRADED, LOST = range(2)
"""Phases of a receiver."""
ANTENNA: Final = {
    "antenna of the receiver": "cited: attenuation of a patch by elevation (gps-sdr-sim, `ant_pat_db`), "
    f"{HORIZON_DBIC:.1f} dBic at the horizon; assumed: {ZENITH_DBIC:g} dBic at the zenith, never less than "
    f"{LEAST_DBIC:g} dBic, level aircraft",
}
"""Realism of the power that reaches a receiver."""


class Radiation(OnReceivers):
    """Has a transmitter on GPS L1. A kind calls `radiate` in `prepare`, and sets `shown`."""

    needs: ClassVar[tuple[str, ...]] = ("receive", "stream")
    stream: ClassVar[str]
    """The stream of chance of the errors."""

    wall_loss_db: Number = param(
        "Loss in dB where a building of the city blocks the line of sight.", default=30.0, ge=0, le=100
    )
    reacquire_s: float
    """Seconds to a new fix once a receiver that has lost its own finds signals."""
    emitter: Emitter
    shown: Mapping[str, Place]
    """Places to mark on a map, by label."""
    chance: Chance
    receivers: list[JammedReceiver]
    error_mps: Floats
    """(n, 3) Added to velocities."""

    def radiate(self, place: Place, power_dbm: float, context: AttackContext) -> None:
        """Set the transmitter. Raises `InputError` for a place inside a building."""
        self.emitter, self.chance = emitter_at(place, power_dbm, self.wall_loss_db, context), context.chance
        self.receivers = [JammedReceiver(from_seconds(self.reacquire_s)) for _ in self.vehicles]
        self.error_mps = np.zeros((len(self.vehicles), 3))

    def build(self, context: AttackContext) -> Attack:
        """See `AltersSensors`."""
        return Attack(sensor_hooks=super().build(context).sensor_hooks, shown=self.shown)

    def alter(self, sensors: Sensors) -> None:
        """See `OnReceivers`."""
        super().alter(sensors)
        sensors.gnss_vel_enu_mps += self.error_mps

    def restore(self, row: int) -> None:
        """See `OnReceivers`."""
        super().restore(row)
        self.error_mps[row] = 0.0

    def degrade(self, row: int, db_hz: Floats, accuracy: Floats) -> int:
        """What one receiver makes of its satellites, whose C/N0 is `db_hz`; returns its phase."""
        self.restore(row)
        receiver = self.receivers[row]
        used = receiver.track(int(self.seen[row]), db_hz)
        self.satellites[row] = len(used)
        if not receiver.has_fix:
            self.fix[row] = FIX_NONE
            return LOST
        growth = error_growth(used, db_hz, float(accuracy[0]))
        if len(used) == len(db_hz) and growth < NOTICEABLE:
            return UNALTERED
        self.scale[row] = growth
        self.offset[row], self.error_mps[row] = self.errors(row, accuracy * sqrt(growth * growth - 1.0))
        return DEGRADED

    def errors(self, row: int, accuracy: Floats) -> tuple[Floats, Floats]:
        """Random errors of a fix, position m and velocity m/s, (3,) each; `accuracy` is that of a claim, one sigma."""
        horizontal, vertical, speed = accuracy.tolist()
        sizes = np.array([horizontal, horizontal, vertical, speed, speed, speed])
        errors = self.deviates(row) * sizes
        return errors[:3], errors[3:]

    def deviates(self, row: int, block: int = 0) -> Floats:
        """Six deviates of mean 0 and variance 1 of the latest fix, each a sum of three uniforms; others by `block`."""
        who, time = hash64(self.vehicles[row]), int(self.seen[row])
        places = range(6 * block, 6 * block + 6)
        return np.array([2.0 * (add_up(self.chance.uniform4(self.stream, who, time, k)[:3]) - 1.5) for k in places])
