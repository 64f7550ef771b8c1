"""World: the true state of all aircraft in the air and on the ground, advanced by a fixed quantum."""

from __future__ import annotations

from typing import TYPE_CHECKING

from skyrange.world.airframes import AIRFRAMES, Airframe, Rotor
from skyrange.world.bodies import Wind

if TYPE_CHECKING:
    from skyrange.world.bodies import Body
    from skyrange.world.sensing.sensors import SensorSpec
    from skyrange.world.world import World

__all__ = ["AIRFRAMES", "Airframe", "Body", "Rotor", "SensorSpec", "Wind", "World"]


def __getattr__(name: str) -> object:
    """Import the world only on demand: a schema needs the airframes' names, but no compiler."""
    if name == "Body":
        from skyrange.world import bodies

        return bodies.Body
    if name == "World":
        from skyrange.world import world

        return world.World
    if name == "SensorSpec":
        from skyrange.world.sensing import sensors

        return sensors.SensorSpec
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
