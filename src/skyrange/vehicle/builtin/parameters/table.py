"""Parameter table: ArduCopter's names, units, ranges and defaults, and the values that an aircraft holds.

`parameters.csv` has the table. Only parameters with an effect are listed. Names and units are those of ArduCopter 4.6
(centimetres where it has centimetres); defaults are from its sources: libraries/AC_AttitudeControl (AC_PosControl.cpp,
AC_AttitudeControl_Multi.h), libraries/AC_WPNav/AC_WPNav.cpp, libraries/AP_Motors, ArduCopter/config.h. The names of
other versions are in `parameters.renames`.

An aircraft's parameters are kept twice. `Fleet.stored_params` has the values as written, as ArduCopter's storage does:
any number of the type. In effect is that number limited to its range, so that no value can make the arithmetic fail: in
the record `SETTINGS` for compiled functions, through `Fleet.param` for the rest.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import dialect
from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.files import read_package_table
from skyrange.vehicle.builtin.layout import Records
from skyrange.vehicle.builtin.parameters.renames import canonical_name, from_canonical, to_canonical
from skyrange.world.airframes import Airframe

_REAL32 = dialect.MAV_PARAM_TYPE_REAL32
_INT8 = dialect.MAV_PARAM_TYPE_INT8
_INT16 = dialect.MAV_PARAM_TYPE_INT16
_INT32 = dialect.MAV_PARAM_TYPE_INT32
_KINDS: Final = {"REAL32": _REAL32, "INT8": _INT8, "INT16": _INT16, "INT32": _INT32}


class Parameter(NamedTuple):
    """One parameter: default and range in ArduCopter's unit, which `meaning` names; `kind` is a MAV_PARAM_TYPE.

    `reboot` means that a new value takes effect at the next boot, as in ArduCopter's metadata (@RebootRequired).
    """

    name: str
    default: float
    low: float
    high: float
    meaning: str
    kind: int = _REAL32
    reboot: bool = False


def _read_parameters(table: str) -> Iterator[Parameter]:
    for row in read_package_table(__file__, table):
        default, low, high = (_number(row[name]) for name in ("default", "low", "high"))
        yield Parameter(row["name"], default, low, high, row["meaning"], _KINDS[row["type"]], row["reboot"] == "yes")


def _number(text: str) -> float:
    """A number as it is written: whole ones are shown without a point."""
    return int(text) if text.lstrip("-").isdigit() else float(text)


ALWAYS_LISTED: Final = tuple(sorted(_read_parameters("parameters.csv")))
"""Those of every aircraft, by name."""
PARAMETERS: Final = (*ALWAYS_LISTED, *sorted(_read_parameters("sensor_parameters.csv")))
"""Every parameter, by name, those of rangefinder, proximity sensor and avoidance last. The position in this table is
the index of the protocol."""

INDEX: Final = {parameter.name: index for index, parameter in enumerate(PARAMETERS)}
MIN_VALUES: Final = np.array([parameter.low for parameter in PARAMETERS], dtype=np.float64)
MAX_VALUES: Final = np.array([parameter.high for parameter in PARAMETERS], dtype=np.float64)

_LOOP_PREFIXES = ("ANGLE_MAX", "ATC_", "LAND_", "LOIT_", "MOT_", "PILOT_", "PSC_", "TKOFF_", "WP")
"""Parameters read in every step come first in the record and side by side, so that the rest costs no cache lines."""
_MESSAGE_PREFIXES = ("SR0_", "SYSID_", "AVOID_", "PRX", "RNGFND")
"""Parameters that compiled functions do not read are not in the record."""


def _settings_names() -> tuple[str, ...]:
    names = [parameter.name for parameter in PARAMETERS if not parameter.name.startswith(_MESSAGE_PREFIXES)]
    return tuple(sorted(names, key=lambda name: (not name.startswith(_LOOP_PREFIXES), name)))


SETTINGS_NAMES: Final = _settings_names()
SETTINGS: Final = np.dtype([(name, "f8") for name in SETTINGS_NAMES])
"""The parameters of one aircraft as a record, limited to their ranges."""

AIRFRAME_TUNING: Final[Mapping[str, Mapping[str, float]]] = {
    # The Iris has a quarter of the yaw authority that ArduCopter's defaults are meant for (4 rad/s² at full
    # yaw): the rate loop has higher gains and lower targets, as in a tuned aircraft's parameter file.
    "iris": {"ATC_RAT_YAW_P": 1.5, "ATC_RAT_YAW_I": 0.15, "ATC_RAT_YAW_FLTE": 20, "ATC_ACCEL_Y_MAX": 6000},
    # Full yaw gives these two 16 and 6.8 rad/s²: the rate loop has a bandwidth of about 6 rad/s, like the Iris's.
    "hummingbird": {"ATC_RAT_YAW_P": 0.4, "ATC_RAT_YAW_I": 0.04, "ATC_RAT_YAW_FLTE": 20},
    "x500": {"ATC_RAT_YAW_P": 0.9, "ATC_RAT_YAW_I": 0.09, "ATC_RAT_YAW_FLTE": 20, "ATC_ACCEL_Y_MAX": 10000},
}
"""Values that differ from the defaults, by airframe."""


_SHOWS_SENSORS: Final = tuple(INDEX[name] for name in ("PRX1_TYPE", "RNGFND1_TYPE"))


def count_listed(stored: NDArray[np.float64]) -> int:
    """How many of `PARAMETERS` an aircraft with these values lists and reads by index.

    Those of sensors and avoidance are last, and listed where a sensor is set. ArduPilot hides most of them until then
    too (AP_PARAM_FLAG_ENABLE), but not the two types and AVOID_ENABLE, which are read and set by name here.
    """
    return len(PARAMETERS) if any(stored[index] for index in _SHOWS_SENSORS) else len(ALWAYS_LISTED)


_LIMITS: Final = {_INT8: (-128.0, 127.0), _INT16: (-32768.0, 32767.0), _INT32: (-2147483648.0, 2147483647.0)}


def stored_value(parameter: Parameter, value: float) -> float:
    """Return a finite value as ArduPilot stores it (AP_Param::set_float): single precision, or a truncated integer."""
    limits = _LIMITS.get(parameter.kind)
    if limits is None:
        return float(np.float32(min(max(value, -_MAX_FLOAT32), _MAX_FLOAT32)))
    nudged = value + (0.01 if value >= 0.0 else -0.01)
    return float(math.trunc(min(max(nudged, limits[0]), limits[1])))


_MAX_FLOAT32 = float(np.finfo(np.float32).max)


def hover_throttle(airframe: Airframe) -> float:
    """Return MOT_THST_HOVER: the thrust whose command carries the weight, at the battery's rated voltage.

    It is less than the share of full thrust, because zero thrust is MOT_SPIN_MIN and full thrust MOT_SPIN_MAX
    (`Thrust_Linearization::actuator_to_thrust`, with the defaults).
    """
    low, high = (PARAMETERS[INDEX[name]].default for name in ("MOT_SPIN_MIN", "MOT_SPIN_MAX"))
    part = (airframe.hover_command - low) / (high - low)
    return (1.0 - airframe.thrust_expo) * part + airframe.thrust_expo * part * part


def value_in_range(parameter: Parameter, value: float) -> float:
    """Return the value that takes effect: `value` limited to the range."""
    return min(max(value, parameter.low), parameter.high)


def initial_values(who: str, airframe: Airframe, system_id: int, given: Mapping[str, float]) -> NDArray[np.float64]:
    """Return (parameters,) initial values: defaults, the airframe's tuning, then `given`, with names of any version.

    Raises `InputError` with every unknown name and every value that is not finite or out of range.
    """
    values: dict[str, float] = {"SYSID_THISMAV": system_id}
    problems = []
    names_by_parameter: dict[str, str] = {}
    for name, value in given.items():
        known = canonical_name(name)
        parameter = PARAMETERS[INDEX[known]] if known in INDEX else None
        shown = f"{name} ({known})" if known != name else name
        if parameter is None:
            problems.append(Problem(name, str(value), "a parameter of the builtin autopilot", nearest(name, INDEX)))
        elif known in names_by_parameter:
            problems.append(
                Problem(shown, str(value), f"given once; {names_by_parameter[known]} is the same parameter")
            )
        elif not (math.isfinite(value) and parameter.low <= to_canonical(name, value) <= parameter.high):
            low, high = from_canonical(name, parameter.low), from_canonical(name, parameter.high)
            problems.append(Problem(shown, str(value), f"{low:g} to {high:g} ({parameter.meaning})"))
        elif known == "SYSID_THISMAV":
            problems.append(Problem(shown, str(value), "the vehicle's system_id, which sets it"))
        else:
            values[known] = to_canonical(name, value)
        names_by_parameter.setdefault(known, name)
    if problems:
        raise InputError(f"params of {who}", problems)
    stored = np.array(_stored_defaults(airframe))
    for name, value in values.items():
        stored[INDEX[name]] = stored_value(PARAMETERS[INDEX[name]], value)
    return stored


@cache
def _stored_defaults(airframe: Airframe) -> tuple[float, ...]:
    """The values of an airframe that is given none, in the order of `PARAMETERS`."""
    values = {parameter.name: parameter.default for parameter in PARAMETERS}
    values.update(AIRFRAME_TUNING.get(airframe.name, {}))
    values["MOT_THST_HOVER"] = hover_throttle(airframe)
    values["MOT_THST_EXPO"] = airframe.thrust_expo
    return tuple(stored_value(parameter, values[parameter.name]) for parameter in PARAMETERS)


def fill_settings(
    settings: Records, row: int, who: str, airframe: Airframe, system_id: int, given: Mapping[str, float]
) -> NDArray[np.float64]:
    """Write the result of `initial_values` to a settings record and return it; raises as that does."""
    values = initial_values(who, airframe, system_id, given)
    apply_stored(settings, row, values)
    return values


def apply_stored(settings: Records, row: int, values: NDArray[np.float64]) -> None:
    """Write stored values to a settings record."""
    acting = np.clip(values, MIN_VALUES, MAX_VALUES)
    for name in SETTINGS_NAMES:
        settings[name][row] = acting[INDEX[name]]
