"""Detectors of a scenario made: monitors, the link ends at which they listen, and their rows in the manifest."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

from skyrange.contracts.links import LinkSpec
from skyrange.contracts.monitors import DetectorContext, MonitorPlacement, find_ends
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError, Problem
from skyrange.core.ids import vehicle_id
from skyrange.scenario.model.scenario import Scenario


def build_detectors(
    scenario: Scenario, links: Sequence[LinkSpec]
) -> tuple[list[MonitorPlacement], list[dict[str, Any]]]:
    """The scenario's detectors in order, and the manifest's rows of them.

    Raises `InputError` for links, ends and parameters that do not fit the scenario.
    """
    vehicles = [vehicle_id(operator.id, vehicle.id) for operator, vehicle in scenario.fleet]
    ends = [(spec.name, spec.a, spec.b) for spec in links]
    origin, chance = scenario.origin.datum, Chance(scenario.seed)
    placements, rows = [], []
    problems: list[Problem] = []
    for table in scenario.detectors:
        context = DetectorContext(table.id, vehicles, origin, scenario.epoch, chance)
        placement = MonitorPlacement(table.id, partial(table.plugin, table.settings, context), table.links, table.side)
        try:
            find_ends(placement, ends)
        except InputError as error:
            where = [fault.where.replace("monitors.", "detectors.", 1) for fault in error.problems]
            problems += [Problem(w, f.value, f.expected, f.hint) for w, f in zip(where, error.problems, strict=True)]
        try:
            placement.make()  # what does not fit is said before anything starts
        except InputError as error:
            where = [f"detectors.{table.id}.params.{fault.where}" for fault in error.problems]
            problems += [Problem(w, f.value, f.expected, f.hint) for w, f in zip(where, error.problems, strict=True)]
        placements.append(placement)
        rows.append(table.model_dump(mode="json", exclude_none=True))
    if problems:
        raise InputError(f"scenario {scenario.name}", problems)
    return placements, rows


def describe_monitor(placement: MonitorPlacement) -> dict[str, Any]:
    """What the manifest says of a detector that no scenario declares."""
    return {"id": placement.id, "links": list(placement.links), "side": placement.side}
