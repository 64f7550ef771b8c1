"""Types of parameters with names of MAVLink and ArduPilot: commands, modes, tracks, parameters and sensors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Final

from pydantic import AfterValidator, BeforeValidator, Field

from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.flight_modes import COPTER_MODE_NUMBERS
from skyrange.contracts.params import Enu, Number, items, refuse
from skyrange.core.errors import Problem, nearest

_PREFIX: Final = "MAV_CMD_"
COMMANDS: Final = {entry.name.removeprefix(_PREFIX): number for number, entry in mav.enums["MAV_CMD"].items()}
"""Numbers of the dialect's commands by name."""
_NAME_CHARS: Final = 16
"""Size of param_id in PARAM_SET."""

SENSORS: Final = {
    entry.name.removeprefix("MAV_SYS_STATUS_").removeprefix("SENSOR_"): number
    for number, entry in mav.enums["MAV_SYS_STATUS_SENSOR"].items()
    if not entry.name.endswith("ENUM_END")
}
"""Bits of SYS_STATUS by name, without the prefix MAV_SYS_STATUS_SENSOR_."""


def _known_command(command: str | int) -> str | int:
    if isinstance(command, int):
        if isinstance(command, bool) or not 0 <= command <= 0xFFFF:
            raise refuse(Problem("", repr(command), "the number of a MAV_CMD, 0 to 65535"))
        return command
    name = command.removeprefix(_PREFIX)
    if name not in COMMANDS:
        raise refuse(Problem("", command, "a MAV_CMD such as 'DO_FLIGHTTERMINATION'", nearest(name, COMMANDS)))
    return name


def _known_mode(name: str) -> str:
    if name not in COPTER_MODE_NUMBERS:
        raise refuse(Problem("", name, "a mode of ArduCopter such as 'LOITER'", nearest(name, COPTER_MODE_NUMBERS)))
    return name


def _parameter_names(values: Mapping[str, float]) -> Mapping[str, float]:
    for name in values:
        if not (0 < len(name) <= _NAME_CHARS and name.isascii() and name == name.upper()):
            raise refuse(Problem(name, repr(name), f"a parameter's name: 1 to {_NAME_CHARS} capital ASCII characters"))
    return values


def _known_sensors(names: tuple[str, ...]) -> tuple[str, ...]:
    for place, name in enumerate(names):
        if name not in SENSORS:
            raise refuse(Problem(str(place), name, "a sensor of SYS_STATUS such as 'GPS'", nearest(name, SENSORS)))
    return names


CommandName = Annotated[str | int, AfterValidator(_known_command)]
"""A command of the dialect by its name, without MAV_CMD_, or by its number."""
CopterMode = Annotated[str, AfterValidator(_known_mode)]
"""A mode of ArduCopter by its name."""
Track = Annotated[
    tuple[Enu, ...], BeforeValidator(items, json_schema_input_type=list[list[float]]), Field(min_length=1)
]
"""Places in order, in metres from the origin."""
CommandValues = Annotated[
    tuple[Number, ...], BeforeValidator(items, json_schema_input_type=list[float]), Field(max_length=7)
]
"""Parameters of a command, at most 7."""
ParameterValues = Annotated[dict[str, Number], AfterValidator(_parameter_names)]
"""Values by name of a parameter of the autopilot."""
SensorNames = Annotated[
    tuple[str, ...], BeforeValidator(items, json_schema_input_type=list[str]), AfterValidator(_known_sensors)
]
"""Names of sensors in SYS_STATUS."""


def command_number(command: str | int) -> int:
    """The number of a command of the dialect, by its name or number."""
    return command if isinstance(command, int) else COMMANDS[command]


def copter_mode(name: str) -> int:
    """The number of a mode of ArduCopter."""
    return COPTER_MODE_NUMBERS[name]
