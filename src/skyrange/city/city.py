"""City: buildings, and a spatial index on them for queries about points and paths."""

from __future__ import annotations

import json
from collections.abc import Sequence
from hashlib import sha256
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely

from skyrange.city.buildings import Building
from skyrange.city.reading import Reading

if TYPE_CHECKING:
    from skyrange.city.wall_index import WallIndex

Point3 = tuple[float, float, float]
"""(east_m, north_m, up_m), up above the ground."""


class City:
    """Buildings on flat ground. Immutable: an assignment is an `AttributeError`, and a deep copy is the city itself."""

    __slots__ = ("_heights_m", "_tree", "_walls", "bounds", "buildings", "reading", "source")

    def __init__(self, buildings: Sequence[Building], source: str, reading: Reading | None = None) -> None:
        """`source` names their origin; `reading` says what their reader kept and dropped. Raises `ValueError` without
        buildings.
        """
        if not buildings:
            raise ValueError("a city needs at least one building")
        self.buildings: tuple[Building, ...] = tuple(buildings)
        self.source = source
        self.reading = reading
        self._tree = shapely.STRtree([building.shape for building in self.buildings])
        self._walls: WallIndex | None = None
        self._heights_m = np.array([building.height_m for building in self.buildings])
        self._heights_m.flags.writeable = False
        west, south, east, north = shapely.total_bounds(self._tree.geometries).tolist()
        self.bounds: tuple[float, float, float, float] = (west, south, east, north)
        """West, south, east and north edge in metres."""

    def __setattr__(self, name: str, value: Any) -> None:
        if hasattr(self, name) and name != "_walls":
            raise AttributeError(f"{name} of a city cannot be altered")
        object.__setattr__(self, name, value)

    def __deepcopy__(self, memo: dict[int, Any]) -> City:
        """Itself, because a city never changes."""
        return self

    def walls(self) -> WallIndex:
        """The buildings as arrays for kernels, in the city's order; computed on the first call."""
        if self._walls is None:
            from skyrange.city.wall_index import (
                build_wall_index,  # loads a compiler, which queries about points do not need
            )

            self._walls = build_wall_index(self.buildings)
        return self._walls

    def __len__(self) -> int:
        return len(self.buildings)

    def inside(self, east_m: float, north_m: float, up_m: float = 0.0) -> Building | None:
        """The building that contains a point (walls included), or None; of several the tallest, then the first."""
        containing = [
            self.buildings[i]
            for i in self._at(east_m, north_m)
            if self.buildings[i].base_m <= up_m < self.buildings[i].height_m
        ]
        return max(containing, key=lambda building: building.height_m) if containing else None

    def height_at(self, east_m: float, north_m: float) -> float:
        """Height of the highest roof over a point, 0 if there is none."""
        indices = self._at(east_m, north_m)
        return float(self._heights_m[indices].max()) if len(indices) else 0.0

    def _at(self, east_m: float, north_m: float) -> list[int]:
        """Buildings whose footprint covers a point, in order."""
        return sorted(self._tree.query(shapely.Point(east_m, north_m), predicate="intersects").tolist())

    def obstacles_within(self, east_m: float, north_m: float, radius_m: float) -> list[Building]:
        """Buildings whose footprint comes within `radius_m` of a point, in the city's order."""
        point = shapely.Point(east_m, north_m)
        indices = self._tree.query(point, predicate="dwithin", distance=radius_m).tolist()
        return [self.buildings[i] for i in sorted(indices)]

    def first_obstruction(self, path: Sequence[Point3], margin_m: float = 0.0) -> Building | None:
        """The first building that a path comes too near to, or None.

        A leg is obstructed by a building whose footprint is within `margin_m` of it, unless the leg stays `margin_m`
        above its roof or below its base. The test takes the leg's lowest and highest point, so a climbing leg may be
        reported as obstructed by a building that it would clear. The first building is the one nearest to the start of
        the first obstructed leg. A path of one point is a position.
        """
        legs = list(pairwise(path)) if len(path) > 1 else [(point, point) for point in path]
        for start, end in legs:
            low_m, high_m = min(start[2], end[2]), max(start[2], end[2])
            begin = shapely.Point(start[:2])
            leg = shapely.LineString([start[:2], end[:2]]) if start[:2] != end[:2] else begin
            near: list[Building] = [
                self.buildings[i]
                for i in sorted(self._tree.query(leg, predicate="dwithin", distance=margin_m).tolist())
                if self.buildings[i].height_m > low_m - margin_m and self.buildings[i].base_m < high_m + margin_m
            ]
            if near:
                away = [float(shapely.distance(begin, building.shape)) for building in near]
                return near[away.index(min(away))]
        return None

    def is_clear(self, path: Sequence[Point3], margin_m: float = 0.0) -> bool:
        """Whether no building obstructs a path (see `first_obstruction`)."""
        return self.first_obstruction(path, margin_m) is None

    def to_json_rows(self) -> list[dict[str, Any]]:
        """One row per polygon, as in `city.json` of a run folder: `height_m`, `rings`, and `base_m` if the base is
        raised.

        `rings` is [outer, holes…], each a closed list of [east_m, north_m] rounded to the millimetre.
        """
        rows: list[dict[str, Any]] = []
        for building in self.buildings:
            for rings in building.polygons:
                row: dict[str, Any] = {"height_m": building.height_m, "rings": rings}
                if building.base_m > 0.0:
                    row["base_m"] = building.base_m
                rows.append(row)
        return rows

    def digest(self) -> str:
        """SHA-256 of the buildings' shapes and heights, in hex: equal for cities whose `to_json_rows` are equal."""
        return sha256(json.dumps(self.to_json_rows(), separators=(",", ":")).encode()).hexdigest()
