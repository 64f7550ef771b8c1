"""Vehicles that do not fly by the range's sensors, and what is wrong with attacks, faults and checks of theirs."""

from __future__ import annotations

from collections.abc import Sequence

from skyrange.contracts.components import SensorHook
from skyrange.core.errors import Problem
from skyrange.core.ids import vehicle_id
from skyrange.scenario.model.scenario import Scenario
from skyrange.vehicle.contract import AutopilotPlugin


def list_own_sensors(scenario: Scenario) -> list[str]:
    """The vehicles that fly by sensors of their own: those with physics of their own, or outside the range."""
    kinds = {vehicle.autopilot for _, vehicle in scenario.fleet}
    own = {kind for kind in kinds if not AutopilotPlugin.find(kind).reads_sensors(scenario.autopilots.params_of(kind))}
    return [vehicle_id(operator.id, vehicle.id) for operator, vehicle in scenario.fleet if vehicle.autopilot in own]


def find_unread(faults: Sequence[SensorHook], own_sensors: Sequence[str], where: str) -> list[Problem]:
    """What is wrong with parts that act on sensors which the range does not have."""
    unread = sorted({one for fault in faults for one in fault.vehicles if one in own_sensors})
    if not unread:
        return []
    hint = "Name other aircraft: these have physics and sensors of their own."
    return [Problem(where, ", ".join(unread), "an aircraft that flies by the range's sensors", hint)]
