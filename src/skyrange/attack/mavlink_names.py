"""Names from MAVLink and ArduPilot as parameters: modes of ArduCopter, and sensors of SYS_STATUS."""

from __future__ import annotations

from typing import Annotated, Final

from pydantic import AfterValidator, BeforeValidator

from skyrange.codec.mavlink import dialect
from skyrange.codec.mavlink.flight_modes import COPTER_MODE_NUMBERS
from skyrange.contracts.params import items, refuse
from skyrange.core.errors import Problem, nearest

SENSORS: Final = {
    entry.name.removeprefix("MAV_SYS_STATUS_").removeprefix("SENSOR_"): number
    for number, entry in dialect.enums["MAV_SYS_STATUS_SENSOR"].items()
    if not entry.name.endswith("ENUM_END")
}
"""Bits of SYS_STATUS by name, without the prefix MAV_SYS_STATUS_SENSOR_."""


def _known_mode(name: str) -> str:
    if name not in COPTER_MODE_NUMBERS:
        raise refuse(Problem("", name, "a mode of ArduCopter such as 'AUTO'", nearest(name, COPTER_MODE_NUMBERS)))
    return name


def _known_sensors(names: tuple[str, ...]) -> tuple[str, ...]:
    for place, name in enumerate(names):
        if name not in SENSORS:
            raise refuse(Problem(str(place), name, "a sensor of SYS_STATUS such as 'GPS'", nearest(name, SENSORS)))
    return names


ModeName = Annotated[str, AfterValidator(_known_mode)]
"""Name of a mode of ArduCopter."""
SensorNames = Annotated[
    tuple[str, ...], BeforeValidator(items, json_schema_input_type=list[str]), AfterValidator(_known_sensors)
]
"""Names of sensors in SYS_STATUS."""
