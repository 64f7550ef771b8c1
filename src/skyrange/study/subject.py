"""Subject of a drawing: name, fleet, colours and city of one run, which all its figures share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from skyrange.study import svg
from skyrange.study.palette import Ink, base_colours, shades
from skyrange.study.series import Record, Vehicle, operators, vehicles


@dataclass(frozen=True, slots=True)
class Subject:
    """A run's name, fleet (in the manifest's order), inks by vehicle id, and buildings (see `series.Record.city`)."""

    name: str
    fleet: Sequence[Vehicle]
    inks: Mapping[str, Ink]
    city: Sequence[Mapping[str, Any]]
    _index: Mapping[str, int] = field(default_factory=dict)

    def index(self, vehicle: Vehicle) -> int:
        """The number k that an aircraft's elements carry in their class `ink-k`."""
        return self._index[vehicle.id]

    def draw_line(
        self,
        vehicle: Vehicle,
        points: NDArray[np.float64],
        opacity: str = "1",
        weight: str = "1.8",
        close: bool = False,
        dashed: bool = False,
    ) -> list[Element]:
        """A path through (n, 2) pixels in an aircraft's colour, named by its id; nothing without points."""
        if not len(points):
            return []
        attributes = {
            "class": f"line ink-{self.index(vehicle)}",
            "d": svg.path_data(points, close),
            "fill": "none",
            "stroke": self.inks[vehicle.id].light,
            "stroke-width": weight,
            "stroke-opacity": opacity,
            "stroke-linejoin": "round",
            "stroke-linecap": "round",
        }
        if dashed:
            attributes["stroke-dasharray"] = "4 5"
        return [svg.element("path", attributes, svg.title(f"{vehicle.id} in the twin" if dashed else vehicle.id))]


def subject_of(record: Record) -> Subject:
    """The subject of a run; every aircraft gets a shade of its operator's colour."""
    fleet = vehicles(record)
    inks: dict[str, Ink] = {}
    for operator, colour in base_colours(operators(record)).items():
        own = [vehicle.id for vehicle in fleet if vehicle.operator == operator]
        inks.update(zip(own, shades(colour, len(own)), strict=True))
    index = {vehicle.id: place for place, vehicle in enumerate(fleet)}
    return Subject(str(record.manifest.get("name") or "this run"), fleet, inks, record.city, index)
