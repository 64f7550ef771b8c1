"""Approval links of the operators of some aircraft, and a tap at the operator's end of each."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from skyrange.attack.contract import AttackContext
from skyrange.attack.on_path import SIDES
from skyrange.attack.victims import check_vehicles
from skyrange.contracts.components import Tap
from skyrange.contracts.links import TapPlacement
from skyrange.core.ids import APPROVAL, link_name, operator_of


def approval_taps(vehicles: Sequence[str], context: AttackContext, make: Callable[[str], Tap]) -> list[TapPlacement]:
    """A tap on the approval link of each operator. Raises `InputError` for aircraft that are not in the scenario."""
    check_vehicles(context, vehicles)
    operators = dict.fromkeys(operator_of(vehicle) for vehicle in vehicles)
    return [TapPlacement(link_name(APPROVAL, operator), SIDES[APPROVAL], make) for operator in operators]
