"""Base of kinds that transmit on GPS L1 from one place: they affect receivers by the power at their antennas."""

from __future__ import annotations

from collections.abc import Mapping

from skyrange.attack.bases.fixes import OnReceivers
from skyrange.attack.contract import Attack, AttackContext, Place
from skyrange.attack.gnss.emitter import Emitter, emitter_at
from skyrange.contracts.params import Number
from skyrange.contracts.plugins.fields import param


class Radiation(OnReceivers):
    """Has a transmitter on GPS L1. A kind calls `radiate` in `prepare`, and sets `shown`."""

    wall_loss_db: Number = param(
        "Loss in dB where a building of the city blocks the line of sight.", default=30.0, ge=0, le=100
    )
    emitter: Emitter
    shown: Mapping[str, Place]
    """Places to mark on a map, by label."""

    def radiate(self, place: Place, power_dbm: float, context: AttackContext) -> None:
        """Set the transmitter. Raises `InputError` for a place inside a building."""
        self.emitter = emitter_at(place, power_dbm, self.wall_loss_db, context)

    def build(self, context: AttackContext) -> Attack:
        """See `AltersSensors`."""
        return Attack(sensor_hooks=super().build(context).sensor_hooks, shown=self.shown)
