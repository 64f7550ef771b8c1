"""Checks of starts and flight plans in their surroundings: buildings, other aircraft, the ground."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from skyrange.city.city import City
from skyrange.codec.mavlink import dialect as mav
from skyrange.core import elementary_python
from skyrange.core.errors import InputError, Problem
from skyrange.core.ids import vehicle_id
from skyrange.gcs.plan.checks import check as check_plan
from skyrange.gcs.plan.plans import FlightPlan
from skyrange.gcs.protocols.commands import enum_name
from skyrange.gcs.protocols.mission_transfer import encode_mission
from skyrange.scenario.model.fleet import Vehicle
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.validation.error_messages import spell_path
from skyrange.vehicle.contract import AutopilotPlugin

APART_M = 0.5
"""Starts nearer than this are one place: an Iris is 0.5 m across."""


def check_starts(scenario: Scenario, city: City | None, plans: Mapping[str, FlightPlan | InputError]) -> list[Problem]:
    """All problems in how the vehicles of `plans` start, in a scenario that is placed, and in what they are to fly; an
    empty list means that they can start. `plans` are those of `make_flight_plans`.

    Found: starts inside buildings or on top of each other, mission files that cannot be read, and what
    `gcs.checks` finds in a plan (points below the ground, NaN, no take-off…), items that the autopilot will reject.
    """
    problems: list[Problem] = []
    for o, operator in enumerate(scenario.operators):
        for v, vehicle in enumerate(operator.vehicles):
            plan = plans.get(vehicle_id(operator.id, vehicle.id))
            if plan is None:
                continue
            where = spell_path(("operators", o, "vehicles", v), scenario)
            if city is not None:
                problems += _walls(vehicle, city, where)
            if isinstance(plan, InputError):
                problems += [
                    Problem(f"{where}.plan.file: {f.where}", f.value, f.expected, f.hint) for f in plan.problems
                ]
                continue
            plan_problems = check_plan(plan, f"{where}.plan")
            problems += plan_problems
            if not plan_problems and not vehicle.plan.rejection_expected:
                problems += _rejected_items(vehicle.autopilot, plan, f"{where}.plan")
    return [*problems, *_crowded(scenario)]


def _rejected_items(autopilot: str, plan: FlightPlan, where: str) -> Iterator[Problem]:
    """The items of a mission that a kind of autopilot will reject, as far as it is known beforehand."""
    if plan.kind == "guided":
        return
    answer = AutopilotPlugin.find(autopilot).mission_result
    for seq, item in enumerate(encode_mission(plan)):
        result = answer(item.message(seq, 1, mav.MAV_COMP_ID_AUTOPILOT1)) if seq else mav.MAV_MISSION_ACCEPTED
        if result != mav.MAV_MISSION_ACCEPTED:
            yield Problem(
                f"{where}: item {seq} (command {item.command})",
                f"{enum_name('MAV_CMD', 'MAV_CMD_', item.command)} ({', '.join(f'{value:g}' for value in item[2:6])})",
                f"an item that the autopilot {autopilot} flies; it answers "
                f"{enum_name('MAV_MISSION_RESULT', 'MAV_MISSION_', result)}",
                "With plan.rejection_expected the scenario is flown nevertheless.",
            )


def _walls(vehicle: Vehicle, city: City, where: str) -> Iterator[Problem]:
    start = vehicle.start
    building = city.inside(start.east_m, start.north_m)
    if building is not None:
        yield Problem(
            f"{where}.start",
            f"({start.east_m:g}, {start.north_m:g}) m",
            f"a place outside buildings; this is inside {building.name or building.id}, {building.height_m:g} m high",
            'Move it, or set placing = "clear".',
        )


def _crowded(scenario: Scenario) -> Iterator[Problem]:
    """Pairs of starts at one place, found by cells of that size so that a thousand aircraft take no million looks."""
    cells: dict[tuple[int, int], list[tuple[str, float, float]]] = {}
    for o, operator in enumerate(scenario.operators):
        for v, vehicle in enumerate(operator.vehicles):
            east_m, north_m = vehicle.start.east_m, vehicle.start.north_m
            column, row = math.floor(east_m / APART_M), math.floor(north_m / APART_M)
            around = [(column + i, row + j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
            for name, other_east_m, other_north_m in (start for cell in around for start in cells.get(cell, ())):
                if elementary_python.hypot(east_m - other_east_m, north_m - other_north_m) < APART_M:
                    yield Problem(
                        f"{spell_path(('operators', o, 'vehicles', v), scenario)}.start",
                        f"({east_m:g}, {north_m:g}) m",
                        f"at least {APART_M:g} m from every other start; {name} stands there",
                    )
                    break
            cells.setdefault((column, row), []).append((vehicle_id(operator.id, vehicle.id), east_m, north_m))
