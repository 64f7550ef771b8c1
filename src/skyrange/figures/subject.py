"""Subject of a figure: name, fleet, colours and buildings of a run, shared by all its figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from skyrange.figures import svg
from skyrange.figures.palette import ThemeColour, base_colours, shades
from skyrange.metrics.time_series import Record, Vehicle, operators, vehicles


@dataclass(frozen=True, slots=True)
class Subject:
    """A run's name, fleet in the manifest's order, colours by vehicle id, and buildings (see `series.Record.city`)."""

    name: str
    fleet: Sequence[Vehicle]
    colours: Mapping[str, ThemeColour]
    city: Sequence[Mapping[str, Any]]
    _index: Mapping[str, int] = field(default_factory=dict)

    def index(self, vehicle: Vehicle) -> int:
        """The number k of the class `ink-k` of an aircraft's elements."""
        return self._index[vehicle.id]

    def draw_line(
        self,
        vehicle: Vehicle,
        points: NDArray[np.float64],
        opacity: str = "1",
        weight: str = "1.8",
        *,
        close: bool = False,
        dashed: bool = False,
    ) -> list[Element]:
        """A path through (n, 2) pixels in an aircraft's colour, titled with its id; empty without points."""
        if not len(points):
            return []
        attributes = {
            "class": f"line ink-{self.index(vehicle)}",
            "d": svg.path_data(points, close=close),
            "fill": "none",
            "stroke": self.colours[vehicle.id].light,
            "stroke-width": weight,
            "stroke-opacity": opacity,
            "stroke-linejoin": "round",
            "stroke-linecap": "round",
        }
        if dashed:
            attributes["stroke-dasharray"] = "4 5"
        return [svg.element("path", attributes, svg.title(f"{vehicle.id} in the twin" if dashed else vehicle.id))]


def subject_of(record: Record) -> Subject:
    """The subject of a run's figures; every aircraft gets a shade of its operator's colour."""
    fleet = vehicles(record)
    index = {vehicle.id: place for place, vehicle in enumerate(fleet)}
    return Subject(str(record.manifest.get("name") or "this run"), fleet, fleet_colours(record), record.city, index)


def fleet_colours(record: Record) -> dict[str, ThemeColour]:
    """The colours of a run's aircraft by vehicle id: shades of their operators' colours."""
    fleet: dict[str, list[str]] = {}
    for vehicle in vehicles(record):
        fleet.setdefault(vehicle.operator, []).append(vehicle.id)
    colours: dict[str, ThemeColour] = {}
    for operator, colour in base_colours(operators(record)).items():
        operator_vehicles = fleet.get(operator, [])
        colours.update(zip(operator_vehicles, shades(colour, len(operator_vehicles)), strict=True))
    return colours
