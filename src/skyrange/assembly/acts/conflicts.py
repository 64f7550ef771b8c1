"""Conflicts of attacks, faults and defences: with each other while they overlap, and with what a vehicle flies by."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

from skyrange.assembly.optics import group_sensors
from skyrange.attack.exclusive import Exclusive, common
from skyrange.contracts.components import SensorHook
from skyrange.contracts.scan_light import SCANNER_KINDS, ScanHook
from skyrange.core.errors import Problem, nearest
from skyrange.core.ids import vehicle_id
from skyrange.core.time import NEVER, Time, from_seconds, to_seconds
from skyrange.scenario.model.attacks import ActTable
from skyrange.scenario.model.defences import DefenceTable
from skyrange.scenario.model.manual_acts import ManualActTable
from skyrange.scenario.model.scenario import Scenario
from skyrange.vehicle.contract import AutopilotPlugin

Window = tuple[Time, Time]
"""Start and end in nanoseconds; the end does not belong to it."""
Acting = tuple[str, Window, Sequence[Exclusive]]
"""Where an attack or a defence is declared, when it may act, and what it alters or decides as the only one."""


def find_exclusions(acting: Sequence[Acting], who: str = "an attack", verb: str = "alter") -> Iterator[Problem]:
    """A problem for each two that `verb` the same at the same time; `acting` are those that are not muted."""
    for (first, first_window, first_exclusives), (second, second_window, second_exclusives) in combinations(acting, 2):
        if max(first_window[0], second_window[0]) >= min(first_window[1], second_window[1]):
            continue
        what = common(first_exclusives, second_exclusives)
        if what:
            yield Problem(
                second,
                f"{verb}s {what} {_words(second_window)}",
                f"{who} that does not {verb} what {first} {verb}s {_words(first_window)}",
                "Choose times that do not overlap, or other aircraft or links.",
            )


def window_of(table: ActTable | DefenceTable, duration_ns: Time, manual_acts: Sequence[ManualActTable] = ()) -> Window:
    """The time in which an attack may act; one with a condition may start at any time until it stops, one that starts
    by hand does not act but for what `manual_acts` have of it.
    """
    starts, stops = (
        [act.manual_act.at_ns for act in manual_acts if act.act == table.id and act.action == action]
        for action in ("start", "stop")
    )
    if table.manual and not starts:
        return 0, 0
    start = starts[0] if table.manual else from_seconds(table.start_s)
    stop = min(duration_ns, NEVER if table.stop_s is None else from_seconds(table.stop_s), *stops)
    if isinstance(table, ActTable) and table.for_s is not None and table.when is None:
        stop = min(stop, start + from_seconds(table.for_s))
    return start, stop


def _words(window: Window) -> str:
    return f"from {to_seconds(window[0]):g} s to {to_seconds(window[1]):g} s"


def list_own_sensors(scenario: Scenario) -> list[str]:
    """The vehicles that fly by sensors of their own: those with physics of their own, or outside the range."""
    kinds = {vehicle.autopilot for _, vehicle in scenario.fleet}
    own_sensor_kinds = {
        kind for kind in kinds if not AutopilotPlugin.find(kind).reads_sensors(scenario.autopilots.params_of(kind))
    }
    return [
        vehicle_id(operator.id, vehicle.id)
        for operator, vehicle in scenario.fleet
        if vehicle.autopilot in own_sensor_kinds
    ]


def find_unread(faults: Sequence[SensorHook], own_sensors: Sequence[str], where: str) -> list[Problem]:
    """What is wrong with parts that act on sensors which the range does not have."""
    unread = sorted({vehicle for fault in faults for vehicle in fault.vehicles if vehicle in own_sensors})
    if not unread:
        return []
    hint = "Name other aircraft: these have physics and sensors of their own."
    return [Problem(where, ", ".join(unread), "an aircraft that flies by the range's sensors", hint)]


def find_sensorless(hooks: Sequence[ScanHook], scenario: Scenario, where: str) -> Iterator[Problem]:
    """What is wrong with parts that act on LiDARs or depth cameras which none of their aircraft has."""
    sensors = group_sensors(scenario)
    for hook in hooks:
        fitting = {
            sensor.id
            for vehicle in hook.vehicles
            for sensor in sensors.get(vehicle, ())
            if SCANNER_KINDS[sensor.kind] in hook.kinds
        }
        what = " or ".join("LiDAR" if kind == "lidar" else "depth camera" for kind in hook.kinds)
        if not fitting:
            yield Problem(f"{where}.vehicles", ", ".join(hook.vehicles), f"an aircraft with a {what}", "Add `sensors`.")
        elif hook.sensor is not None and hook.sensor not in fitting:
            hint = nearest(hook.sensor, fitting)
            yield Problem(f"{where}.sensor", hook.sensor, f"the id of a {what} of these aircraft", hint)
