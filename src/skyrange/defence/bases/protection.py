"""Base of defences that protect aircraft, all of them or those that are named."""

from __future__ import annotations

from skyrange.attack.declaration import Acting
from skyrange.attack.victims import Vehicles, check_vehicles
from skyrange.contracts.plugins.form import param
from skyrange.defence.contract import DefenceContext


class Protection(Acting):
    """Protects aircraft of the scenario."""

    vehicles: Vehicles = param("Aircraft that it protects, such as ['blue/b1']; default: all.", default=())

    def find_protected(self, context: DefenceContext) -> list[str]:
        """The aircraft that it protects. Raises `InputError` for those that are not in the scenario."""
        check_vehicles(context, self.vehicles)
        return list(self.vehicles or context.vehicles)
