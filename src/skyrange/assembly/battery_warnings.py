"""Warnings of aircraft whose autopilot does not measure the battery that the scenario gives them."""

from __future__ import annotations

from skyrange.core.ids import vehicle_id
from skyrange.scenario.model.fleet import Vehicle
from skyrange.scenario.model.scenario import Scenario
from skyrange.vehicle.contract import AutopilotPlugin

_PARAMETERS = ("BATT_FS_", "BATT_LOW_", "BATT_CRT_", "BATT_ARM_")
"""Beginnings of the parameters of battery failsafes and checks (AP_BattMonitor_Params.cpp)."""


def list_battery_warnings(scenario: Scenario) -> list[str]:
    """One line for each aircraft that sets its charge or battery failsafes, and whose autopilot measures another
    battery: what is without effect, and why.

    Raises `InputError` if that depends on a program that cannot be found.
    """
    lines = []
    reasons: dict[str, str] = {}
    for operator, vehicle in scenario.fleet:
        asked = _asked(vehicle)
        if not asked:
            continue
        kind = vehicle.autopilot
        if kind not in reasons:
            reasons[kind] = AutopilotPlugin.find(kind).other_battery(scenario.autopilots.params_of(kind))
        if reasons[kind]:
            name = vehicle_id(operator.id, vehicle.id)
            unlike = f"the autopilot does not measure the world's battery: {reasons[kind]}"
            lines.append(f"{name}: {', '.join(asked)}, but {unlike}")
    return lines


def _asked(vehicle: Vehicle) -> list[str]:
    """What a vehicle sets of its battery, as it is written in the scenario."""
    charge = [f"charge = {vehicle.charge:g}"] if vehicle.charge < 1.0 else []
    return charge + [f"{name} = {value:g}" for name, value in vehicle.params.items() if name.startswith(_PARAMETERS)]
