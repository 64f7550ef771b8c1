"""Elements of SDFormat, and the names in Gazebo's world by which the plugin finds models, links and collisions."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Final
from xml.etree.ElementTree import Element, SubElement

WORLD: Final = "skyrange"
"""The world."""
BODY: Final = "body"
"""The one link of an aircraft; its collisions are `FRAME` and those of `rotor_name`."""
FRAME: Final = "frame"
"""Collision of an aircraft without its rotors."""
GROUND: Final = "ground"
"""Model of the ground, its link and its collision."""

_NOT_FREE: Final = re.compile(r"[^A-Za-z0-9_/-]")
_RESERVED: Final = re.compile(rf"city_\d+|{GROUND}|world|_.*")
"""Names of other models, and those that SDFormat keeps for itself (`world`, `__model__`)."""
_ESCAPE: Final = "~"


def model_name(vehicle: str) -> str:
    """Name of a vehicle's model: `blue.1` for `blue/1`.

    Different vehicles have different names. Characters that an id has not are escaped, because SDFormat forbids some
    of them (`::`); so is the first letter of a name that another model has. Raises `ValueError` for an empty id.
    """
    if not vehicle:
        raise ValueError("a vehicle needs an id")
    name = _NOT_FREE.sub(_escape, vehicle).replace("/", ".")
    if _RESERVED.fullmatch(name):
        return _escape(name[0]) + name[1:]
    return name


def rotor_name(rotor: int) -> str:
    """Name of the collision and of the visual of a rotor, counted from 0 in ArduCopter's motor order."""
    return f"rotor_{rotor}"


def city_name(tile: int) -> str:
    """Name of the model of the buildings of one tile, counted from 0."""
    return f"city_{tile}"


def building_name(index: int) -> str:
    """Name of the link and of the collision of `city.buildings[index]`, unique in the world whatever its tile."""
    return f"building_{index}"


def _escape(matched: re.Match[str] | str) -> str:
    character = matched if isinstance(matched, str) else matched.group()
    return f"{_ESCAPE}{ord(character):x}{_ESCAPE}"


def visual_name(part: str) -> str:
    """Name of what is drawn of a collision: SDFormat wants the names of siblings to differ."""
    return f"{part}_visual"


VERSION: Final = "1.7"
"""Of SDFormat: what Gazebo 11 reads, and Gazebo Sim converts."""

Colour = tuple[float, float, float]
"""Red, green and blue, 0 to 1."""
Point = tuple[float, float, float]
"""Metres forward, left and up in a model, or east, north and up in the world."""


def format_numbers(*values: float) -> str:
    """Numbers separated by spaces, each the shortest text that reads back as the same number. Raises `ValueError` for
    a number that is not finite.
    """
    numbers = [float(value) + 0.0 for value in values]  # no negative zero
    if not all(math.isfinite(number) for number in numbers):
        raise ValueError(f"SDFormat has no infinite numbers, got {values}")
    return " ".join(map(repr, numbers))


def add(parent: Element, tag: str, *values: float | str | bool, **attributes: str) -> Element:
    """Add a child whose text is a string, a truth value or numbers, and return it."""
    child = SubElement(parent, tag, attributes)
    if values and isinstance(values[0], str):
        child.text = values[0]
    elif values and isinstance(values[0], bool):
        child.text = "true" if values[0] else "false"
    elif values:
        child.text = format_numbers(*(float(value) for value in values))
    return child


def add_pose(parent: Element, place: Point, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> None:
    """Add a pose; angles in radians."""
    add(parent, "pose", *place, roll, pitch, yaw)


def add_box(parent: Element, size: Point) -> None:
    """Add the geometry of a box."""
    add(add(add(parent, "geometry"), "box"), "size", *size)


def add_cylinder(parent: Element, radius_m: float, length_m: float) -> None:
    """Add the geometry of an upright cylinder."""
    cylinder = add(add(parent, "geometry"), "cylinder")
    add(cylinder, "radius", radius_m)
    add(cylinder, "length", length_m)


def add_plane(parent: Element, east_m: float, north_m: float) -> None:
    """Add the geometry of a level plane; its size is that of what is drawn."""
    plane = add(add(parent, "geometry"), "plane")
    add(plane, "normal", 0.0, 0.0, 1.0)
    add(plane, "size", east_m, north_m)


def add_mesh(parent: Element, uri: str) -> None:
    """Add the geometry of a mesh file."""
    add(add(add(parent, "geometry"), "mesh"), "uri", uri)


def add_material(parent: Element, colour: Colour) -> None:
    """Add a dull material of one colour."""
    material = add(parent, "material")
    add(material, "ambient", *colour, 1.0)
    add(material, "diffuse", *colour, 1.0)
    add(material, "specular", 0.1, 0.1, 0.1, 1.0)


def add_friction(parent: Element, mu: float) -> Element:
    """Add a surface with a Coulomb coefficient, and return it. Of two surfaces that touch, the smaller one counts."""
    surface = add(parent, "surface")
    ode = add(add(surface, "friction"), "ode")
    add(ode, "mu", mu)
    add(ode, "mu2", mu)
    return surface


def bar_between(start: Point, end: Point) -> tuple[Point, float, float, float]:
    """Centre, length, pitch and yaw (radians) of an upright cylinder turned so that it joins two points."""
    along: Sequence[float] = [b - a for a, b in zip(start, end, strict=True)]
    length = math.hypot(*along)
    centre = (0.5 * (start[0] + end[0]), 0.5 * (start[1] + end[1]), 0.5 * (start[2] + end[2]))
    return centre, length, math.atan2(math.hypot(along[0], along[1]), along[2]), math.atan2(along[1], along[0])
