"""A building: its footprint and height, on flat ground."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely

Ring = list[list[float]]
"""Vertices [east_m, north_m]; the last one equals the first."""


@dataclass(frozen=True, slots=True)
class Building:
    """A vertical prism. Frozen, geometry included: shapely's shapes cannot be altered."""

    id: str
    """Unique in its city: the feature's own id if it has one."""
    height_m: float
    """Top above the ground."""
    shape: Any
    """shapely Polygon or MultiPolygon in ENU metres, valid, holes are courtyards."""
    name: str = ""
    base_m: float = 0.0
    """Bottom above the ground: above zero for an overhang or a bridge between towers."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.base_m < self.height_m:
            raise ValueError(f"building {self.id}: needs 0 <= base_m < height_m, got {self.base_m} and {self.height_m}")

    @property
    def polygons(self) -> list[list[Ring]]:
        """Its parts, each as [outer ring, holes…], in the shape's order."""
        parts = self.shape.geoms if self.shape.geom_type == "MultiPolygon" else [self.shape]
        return [[_ring(part.exterior), *(_ring(hole) for hole in part.interiors)] for part in parts]


def _ring(line: Any) -> Ring:
    """A ring's vertices rounded to the millimetre, which is finer than any footprint's accuracy and
    keeps files small.
    """
    vertices: Ring = np.round(shapely.get_coordinates(line), 3).tolist()
    return vertices
