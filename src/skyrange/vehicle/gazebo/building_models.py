"""Models of a city for Gazebo: one link per building, a box or a mesh, and the files of the meshes.

Gazebo 11 looks for contacts model by model, so the buildings of each tile are a model of their own: an aircraft is only
compared with the buildings of its tile.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
import shapely
from numpy.typing import NDArray

from skyrange.city.buildings import Building
from skyrange.city.city import City
from skyrange.core.errors import InputError
from skyrange.vehicle.gazebo.sdf_elements import (
    Colour,
    Point,
    add,
    add_box,
    add_friction,
    add_material,
    add_mesh,
    add_pose,
    building_name,
    city_name,
    visual_name,
)

HARD_MU: Final = 100.0
"""Friction of ground and walls: more than that of any aircraft, whose own therefore counts."""
_RECTANGLE_M: Final = 0.03
"""How far the walls of a building may be within its enclosing rectangle for it to be a box."""
_SHADES: Final[tuple[Colour, ...]] = ((0.72, 0.68, 0.62), (0.65, 0.63, 0.62), (0.76, 0.73, 0.70), (0.60, 0.58, 0.55))
_TILE_M: Final = 100.0
"""Side of a tile."""
_STL_HEADER: Final = b"skyrange building, metres".ljust(80, b" ")
_FACET: Final = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])

Triangles = NDArray[np.float64]
"""(n, 3, 3): corners of n triangles, counter-clockwise seen from outside, in metres."""


class Box(NamedTuple):
    """A rectangular footprint: its centre, the length of its sides, and the direction of the first one."""

    east_m: float
    north_m: float
    length_m: float
    width_m: float
    yaw: float
    """Radians counter-clockwise from east."""


def make_city_models(city: City, folder: Path) -> list[Element]:
    """The static `<model>` of each tile of a city, with the buildings whose middle lies in it.

    Meshes of buildings that are not boxes are written into `folder`.

    Raises `InputError` for such a building if the installed shapely cannot triangulate, and `OSError`.
    """
    models: dict[tuple[int, int], Element] = {}
    for index, building in enumerate(city.buildings):
        box = box_of(building.shape)
        mesh = None if box is not None else folder.resolve() / f"{building_name(index)}.stl"
        if box is not None:
            place = (box.east_m, box.north_m, 0.5 * (building.base_m + building.height_m))
        else:
            assert mesh is not None
            place = _anchor(building)
            mesh.write_bytes(stl_bytes(prism_of(building) - place))
        tile = (math.floor(place[0] / _TILE_M), math.floor(place[1] / _TILE_M))
        if tile not in models:
            models[tile] = Element("model", name=city_name(len(models)))
            add(models[tile], "static", "true")
        link = add(models[tile], "link", name=building_name(index))
        add_pose(link, place, yaw=0.0 if box is None else box.yaw)
        for tag in ("collision", "visual"):
            name = building_name(index)
            part = add(link, tag, name=name if tag == "collision" else visual_name(name))
            if box is not None:
                add_box(part, (box.length_m, box.width_m, building.height_m - building.base_m))
            else:
                add_mesh(part, f"file://{mesh}")  # neither Gazebo decodes percent signs in it
            if tag == "collision":
                add_friction(part, HARD_MU)
            else:
                add_material(part, _SHADES[index % len(_SHADES)])
    return list(models.values())


def box_of(shape: Any) -> Box | None:
    """The rectangle that a footprint is to 3 cm, None if it is no rectangle."""
    if shape.geom_type != "Polygon" or shape.interiors:
        return None
    rectangle = shapely.oriented_envelope(shape)
    if rectangle.geom_type != "Polygon":
        return None
    core = rectangle.buffer(-_RECTANGLE_M, join_style="mitre")
    if core.is_empty or not shape.covers(core):
        return None
    first, second, third = shapely.get_coordinates(rectangle)[:3]
    along, across = second - first, third - second
    east_m, north_m = (0.5 * (first + third)).tolist()
    yaw = math.remainder(math.atan2(along[1], along[0]), math.pi)
    return Box(east_m, north_m, math.hypot(*along), math.hypot(*across), yaw)


def prism_of(building: Building) -> Triangles:
    """The closed surface of a building: roof, floor and walls of its parts.

    Walls stand on the edges of the roof's triangles that have no neighbour, so every edge of the surface has one.
    Raises `InputError` for a shapely older than 2.1.
    """
    if not hasattr(shapely, "constrained_delaunay_triangles"):
        hint = "Install it with: pip install 'shapely>=2.1'"
        raise InputError.one("gazebo", "shapely", shapely.__version__, "version 2.1, which triangulates roofs", hint)
    pieces = shapely.constrained_delaunay_triangles(building.shape)
    flat = shapely.get_coordinates(shapely.orient_polygons(shapely.get_parts(pieces))).reshape(-1, 4, 2)[:, :3]
    starts, ends = flat.reshape(-1, 2), np.roll(flat, -1, axis=1).reshape(-1, 2)
    edges = list(zip(map(tuple, starts.tolist()), map(tuple, ends.tolist()), strict=True))
    inner = set(edges)
    outer = [(start, end) for start, end in edges if (end, start) not in inner]
    low_m, high_m = building.base_m, building.height_m
    walls = [
        corners
        for (ax, ay), (bx, by) in outer
        for corners in (
            ((ax, ay, low_m), (bx, by, low_m), (bx, by, high_m)),
            ((ax, ay, low_m), (bx, by, high_m), (ax, ay, high_m)),
        )
    ]
    roof = np.dstack((flat, np.full(flat.shape[:2], high_m)))
    floor = np.dstack((flat, np.full(flat.shape[:2], low_m)))[:, ::-1]
    return np.concatenate((roof, floor, np.array(walls, dtype=np.float64)))


def stl_bytes(triangles: Triangles) -> bytes:
    """A binary STL file."""
    facets = np.zeros(len(triangles), dtype=_FACET)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    facets["normal"] = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0.0)
    facets["corners"] = triangles
    return _STL_HEADER + len(facets).to_bytes(4, "little") + facets.tobytes()


def _anchor(building: Building) -> Point:
    """A place in the middle of a building's bottom: from there its corners are exact to micrometres as STL's numbers of
    32 bits.
    """
    west, south, east, north = building.shape.bounds
    return round(0.5 * (west + east), 3), round(0.5 * (south + north), 3), building.base_m
