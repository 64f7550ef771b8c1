"""Triangles of a city: walls, roofs and raised floors of its buildings, for ray tracers and viewers."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray

from skyrange.city.city import City

Mesh = tuple[NDArray[np.float32], NDArray[np.uint32]]
"""(v, 3) vertices in metres, and (f, 3) indices of the corners of triangles."""
Corner = tuple[float, float, float]
"""East, north and up, in metres."""


def city_mesh(city: City) -> Mesh:
    """All buildings as one mesh. Triangles that meet share their vertices: ray tracers find the edges that diffract by
    them.
    """
    corners: list[Corner] = []
    for building in city.buildings:
        shape = building.shape
        for part in shape.geoms if shape.geom_type == "MultiPolygon" else [shape]:
            corners += prism_triangles(part, building.base_m, building.height_m)
    vertices, index = np.unique(np.array(corners, dtype=np.float32), axis=0, return_inverse=True)
    return vertices, index.reshape(-1, 3).astype(np.uint32)


def prism_triangles(footprint: shapely.Polygon, low_m: float, high_m: float) -> list[Corner]:
    """Walls, roof, and the floor if it is raised, of a building: three corners for each triangle, in metres."""
    corners: list[Corner] = []
    for ring in (footprint.exterior, *footprint.interiors):
        for (ax, ay), (bx, by) in pairwise(shapely.get_coordinates(ring).tolist()):
            corners += [(ax, ay, low_m), (bx, by, low_m), (bx, by, high_m)]
            corners += [(ax, ay, low_m), (bx, by, high_m), (ax, ay, high_m)]
    for triangle in shapely.constrained_delaunay_triangles(footprint).geoms:
        flat = shapely.get_coordinates(shapely.orient_polygons(triangle)).tolist()[:3]
        corners += [(x, y, high_m) for x, y in flat]
        if low_m > 0.0:
            corners += [(x, y, low_m) for x, y in reversed(flat)]
    return corners


def ground_mesh(west: float, south: float, east: float, north: float) -> Mesh:
    """A rectangle at height 0."""
    corners = [(west, south, 0.0), (east, south, 0.0), (east, north, 0.0), (west, north, 0.0)]
    return np.array(corners, dtype=np.float32), np.array([(0, 1, 2), (0, 2, 3)], dtype=np.uint32)
