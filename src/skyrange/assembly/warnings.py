"""Warnings of a scenario: settings without effect, much data, and sight that misleads or is of no use."""

from __future__ import annotations

from skyrange.assembly.aircraft import list_battery_warnings
from skyrange.assembly.optics import describe_scans, list_sensors, make_sight
from skyrange.contracts.plugins.form import MakeKind
from skyrange.core.ids import vehicle_id
from skyrange.fault.contract import FaultPlugin
from skyrange.fault.weather.passing import PassingWeather
from skyrange.optics.extinction import Weather
from skyrange.scenario.model.scenario import Scenario
from skyrange.vehicle.sight.evidence import can_reject
from skyrange.vehicle.sight.fusion import Fusion


def list_warnings(scenario: Scenario) -> list[str]:
    """One line for each thing that a run does otherwise than its author may expect.

    Raises `InputError` if that depends on a program that cannot be found.
    """
    return [
        *list_battery_warnings(scenario),
        *describe_scans(scenario, list_sensors(scenario)),
        *_warn_of_weather(scenario),
        *_warn_of_narrow_fields(scenario),
    ]


def _warn_of_weather(scenario: Scenario) -> list[str]:
    """A line if there is weather, and aircraft that disbelieve what they do not see in air that they take for clear."""
    sets = [] if scenario.optics is None or scenario.optics.weather == Weather() else ["optics"]
    faults = [fault for fault in scenario.faults if _is_weather(fault.kind)]
    causes = [*sets, *(f"faults.{fault.id}" for fault in faults)]
    names = []
    for operator, vehicle in scenario.fleet:
        key = vehicle_id(operator.id, vehicle.id)
        sight, fusion = make_sight(key, vehicle)
        if sight is not None and fusion is Fusion.CONFIRM and len(sight.extinctions) == 1:
            names.append(key)
    if not causes or not names:
        return []
    who = f"{', '.join(names)} will disbelieve real aircraft that rain or fog hides"
    return [f"{', '.join(causes)}: with sight.air = 'clear', {who}; use 'estimated'"]


def _warn_of_narrow_fields(scenario: Scenario) -> list[str]:
    """A line for each aircraft that shall disbelieve what it does not see, and can never look well enough."""
    lines = []
    for operator, vehicle in scenario.fleet:
        key = vehicle_id(operator.id, vehicle.id)
        sight, fusion = make_sight(key, vehicle)
        if sight is None or fusion is not Fusion.CONFIRM:
            continue
        if not any(can_reject(sensor, sight.rates, sight.sigma_m) for sensor in sight.sensors):
            why = f"no sensor sees all of where an aircraft with sight.sigma_m = {sight.sigma_m:g} may be"
            lines.append(f"{key}: fusion = 'confirm' believes every track, as 'radio' does, because {why}")
    return lines


def _is_weather(kind: str) -> bool:
    made = FaultPlugin.find(kind).make
    return isinstance(made, MakeKind) and issubclass(made.kind, PassingWeather)
