"""Placement of a scenario's detectors: the monitor of each and the link ends at which it listens."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fnmatch import fnmatchcase
from functools import partial

from skyrange.agent.detectors import DetectorContext
from skyrange.agent.links import LinkSpec
from skyrange.agent.monitors import MonitorPlacement, is_side
from skyrange.core.chance import Chance
from skyrange.core.errors import Fault, InputError, nearest
from skyrange.core.ids import vehicle_id
from skyrange.scenario.detectors import DetectorTable
from skyrange.scenario.schema import Scenario


def build_detectors(scenario: Scenario, links: Sequence[LinkSpec]) -> list[MonitorPlacement]:
    """Place the scenario's detectors, in order. Raises `InputError` for links, ends and parameters that do not fit."""
    vehicles = [vehicle_id(operator.id, vehicle.id) for operator, vehicle in scenario.fleet]
    faults: list[Fault] = []
    built = []
    for table in scenario.detectors:
        where = f"detectors.{table.id}"
        chosen = [spec for spec in links if any(fnmatchcase(spec.name, pattern) for pattern in table.links)]
        faults += _link_faults(table, where, links, chosen)
        names = [spec.name for spec in chosen]
        context = DetectorContext(
            table.id, names, vehicles, scenario.origin.datum, scenario.epoch, Chance(scenario.seed)
        )
        make = partial(table.plugin, table.settings, context)
        try:
            make()  # what does not fit is said before anything starts
        except InputError as error:
            faults += [Fault(f"{where}.params.{f.where}", f.value, f.expected, f.hint) for f in error.faults]
            continue
        built.append(MonitorPlacement(table.id, make, names, table.side))
    if faults:
        raise InputError(f"scenario {scenario.name}", faults)
    return built


def _link_faults(
    table: DetectorTable, where: str, links: Sequence[LinkSpec], chosen: Sequence[LinkSpec]
) -> Iterator[Fault]:
    """Patterns that match no link, and links that have no such end."""
    names = [spec.name for spec in links]
    for pattern in table.links:
        if not any(fnmatchcase(name, pattern) for name in names):
            yield Fault(f"{where}.links", pattern, "a link of the scenario", nearest(pattern, names))
    for spec in chosen:
        if not any(is_side(end, table.side) for end in (spec.a, spec.b)):
            yield Fault(f"{where}.side", table.side, f"an end of {spec.name}: {spec.a} or {spec.b}")
            return
