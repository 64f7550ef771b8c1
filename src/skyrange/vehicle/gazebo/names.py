"""Names in Gazebo's world: models, links and collisions, by which the plugin in Gazebo finds them."""

from __future__ import annotations

import re
from typing import Final

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


def _escape(found: re.Match[str] | str) -> str:
    character = found if isinstance(found, str) else found.group()
    return f"{_ESCAPE}{ord(character):x}{_ESCAPE}"


def visual_name(part: str) -> str:
    """Name of what is drawn of a collision: SDFormat wants the names of siblings to differ."""
    return f"{part}_visual"
