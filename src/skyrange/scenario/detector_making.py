"""Detectors of a scenario made: the monitor of each, and the links that it listens to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any

from skyrange.agent.detectors import DetectorContext
from skyrange.agent.links import LinkSpec
from skyrange.core.chance import Chance
from skyrange.core.errors import Fault, InputError, nearest
from skyrange.core.ids import vehicle_id
from skyrange.scenario.schema import Scenario


@dataclass(frozen=True, slots=True)
class BuiltDetector:
    """A detector that is ready to listen."""

    id: str
    kind: str
    links: Sequence[str]
    """The names of the links that it listens to."""
    monitor: Any
    """What the kind's `make` returned."""


def build_detectors(scenario: Scenario, links: Sequence[LinkSpec]) -> list[BuiltDetector]:
    """The scenario's detectors, in order. Raises `InputError` for patterns and parameters that do not fit it."""
    names = [spec.name for spec in links]
    vehicles = [vehicle_id(operator.id, vehicle.id) for operator, vehicle in scenario.fleet]
    faults: list[Fault] = []
    built = []
    for table in scenario.detectors:
        where = f"detectors.{table.id}"
        faults += [
            Fault(f"{where}.links", pattern, "a link of the scenario", nearest(pattern, names))
            for pattern in table.links
            if not any(fnmatchcase(name, pattern) for name in names)
        ]
        chosen = [name for name in names if any(fnmatchcase(name, pattern) for pattern in table.links)]
        context = DetectorContext(
            table.id, chosen, vehicles, scenario.origin.datum, scenario.epoch, Chance(scenario.seed)
        )
        try:
            built.append(BuiltDetector(table.id, table.kind, chosen, table.plugin(table.settings, context)))
        except InputError as error:
            faults += [Fault(f"{where}.params.{f.where}", f.value, f.expected, f.hint) for f in error.faults]
    if faults:
        raise InputError(f"scenario {scenario.name}", faults)
    return built
