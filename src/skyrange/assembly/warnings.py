"""Warnings of a scenario: settings without effect, scans that take much space, and weather that misleads companions."""

from __future__ import annotations

from skyrange.assembly.aircraft import list_battery_warnings
from skyrange.assembly.optics import describe_scans, list_sensors
from skyrange.contracts.plugins.form import MakeKind
from skyrange.core.ids import vehicle_id
from skyrange.fault.contract import FaultPlugin
from skyrange.fault.weather.passing import PassingWeather
from skyrange.optics.extinction import Weather
from skyrange.scenario.model.scenario import Scenario


def list_warnings(scenario: Scenario) -> list[str]:
    """One line for each thing that a run does otherwise than its author may expect.

    Raises `InputError` if that depends on a program that cannot be found.
    """
    return [
        *list_battery_warnings(scenario),
        *describe_scans(scenario, list_sensors(scenario)),
        *_warn_of_weather(scenario),
    ]


def _warn_of_weather(scenario: Scenario) -> list[str]:
    """A line if there is weather, and aircraft that disbelieve what they do not see in air that they take for clear."""
    sets = [] if scenario.optics is None or scenario.optics.weather == Weather() else ["optics"]
    faults = [fault for fault in scenario.faults if _is_weather(fault.kind)]
    causes = [*sets, *(f"faults.{fault.id}" for fault in faults)]
    names = [
        vehicle_id(operator.id, vehicle.id)
        for operator, vehicle in scenario.fleet
        if vehicle.avoidance is not None
        and vehicle.avoidance.fusion == "confirm"
        and vehicle.avoidance.sight is not None
        and vehicle.avoidance.sight.air == "clear"
    ]
    if not causes or not names:
        return []
    who = f"{', '.join(names)} will disbelieve real aircraft that rain or fog hides"
    return [f"{', '.join(causes)}: with sight.air = 'clear', {who}; use 'estimated'"]


def _is_weather(kind: str) -> bool:
    made = FaultPlugin.find(kind).make
    return isinstance(made, MakeKind) and issubclass(made.kind, PassingWeather)
