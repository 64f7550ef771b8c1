"""Parameter protocol: PARAM_REQUEST_LIST, PARAM_REQUEST_READ and PARAM_SET, answered with PARAM_VALUE.

https://mavlink.io/en/services/parameter.html as ArduPilot implements it (libraries/GCS_MAVLink/GCS_Param.cpp): a value
is sent as a float whatever its type, and the type in a PARAM_SET is not read; an integer parameter is truncated, not
rounded, and limited to the range of its type; every other number is stored and reported as received. An unknown name or
index, and a value that is not finite, get no answer. A parameter read or set under its 4.7 name is answered under that
name and in its unit; the list has the 4.6 names only.
"""

from __future__ import annotations

import math
from typing import Any, Final

from skyrange.codec.mavlink import dialect
from skyrange.core.time import NS_PER_MS
from skyrange.vehicle.builtin.fleet import Causes, Craft, Fleet, Timer
from skyrange.vehicle.builtin.parameter_names import from_nominal, nominal, to_nominal
from skyrange.vehicle.builtin.parameters import IN_KERNELS, INDEX, PARAMETERS, held, stored

BANNER: Final = ("ArduCopter V4.6.0-dev (skyrange)", "Frame: QUAD/X")
"""The texts that precede a list, as in ArduCopter (`send_banner`)."""
_VALUES_PER_BATCH = 5
_PAUSE_NS = 10 * NS_PER_MS
"""A list is sent at five values every 10 ms, the pace of a serial line (`queued_param_send`)."""
_NO_INDEX = 0xFFFF


def send_banner(fleet: Fleet, craft: Craft) -> None:
    """Send firmware and frame as texts."""
    for words in BANNER:
        fleet.text(craft, dialect.MAV_SEVERITY_INFO, words)


def on_list(fleet: Fleet, craft: Craft, message: Any, partner: tuple[int, int], causes: Causes) -> None:
    """PARAM_REQUEST_LIST: send every parameter, from the first again where a list was in progress."""
    send_banner(fleet, craft)
    craft.params_next = 0
    fleet.timer(craft, Timer.PARAMS, fleet.now)


def on_timer(fleet: Fleet, craft: Craft) -> None:
    """Send the next values of the list."""
    last = min(craft.params_next + _VALUES_PER_BATCH, len(PARAMETERS))
    for index in range(craft.params_next, last):
        _send_value(fleet, craft, index, index, PARAMETERS[index].name)
    craft.params_next = last
    if last < len(PARAMETERS):
        fleet.timer(craft, Timer.PARAMS, fleet.now + _PAUSE_NS)


def on_read(fleet: Fleet, craft: Craft, message: Any, partner: tuple[int, int], causes: Causes) -> None:
    """PARAM_REQUEST_READ: send one parameter by index, or by name where the index is -1."""
    index = message.param_index
    if index != -1:
        if 0 <= index < len(PARAMETERS):
            _send_value(fleet, craft, index, index, PARAMETERS[index].name)
        return
    name = clean_name(message.param_id)
    known = nominal(name)
    if known in INDEX:
        _send_value(fleet, craft, INDEX[known], _NO_INDEX, name)


def on_set(fleet: Fleet, craft: Craft, message: Any, partner: tuple[int, int], causes: Causes) -> None:
    """PARAM_SET: store a finite value of a known parameter and report what is stored."""
    name = clean_name(message.param_id).upper()
    known = nominal(name)
    if known not in INDEX or not math.isfinite(message.param_value):
        return
    index = INDEX[known]
    parameter = PARAMETERS[index]
    value = stored(parameter, to_nominal(name, message.param_value))
    row = craft.row
    fleet.stored[row, index] = value
    craft.unsaved.pop(index, None)
    if known in IN_KERNELS:
        fleet.settings[known][row] = held(parameter, value)
    fleet.note("event.parameter", craft, {"name": known, "value": value}, causes)
    _send_value(fleet, craft, index, _NO_INDEX, name, causes)


def clean_name(raw: object) -> str:
    """Return the name field of a PARAM_* message as text; non-ASCII bytes cannot name a parameter."""
    if isinstance(raw, bytes):
        raw = raw.decode("ascii", "replace")
    return str(raw).split("\0", 1)[0]


def _send_value(fleet: Fleet, craft: Craft, index: int, told_index: int, name: str, causes: Causes = ()) -> None:
    """Send PARAM_VALUE of the parameter at `index`, under the requested name and in its unit."""
    parameter = PARAMETERS[index]
    value = float(fleet.stored[craft.row, index])
    kind = parameter.kind
    if name.upper() != parameter.name:
        value = from_nominal(name, value)
        kind = dialect.MAV_PARAM_TYPE_REAL32
    message = dialect.MAVLink_param_value_message(name.encode(), value, kind, len(PARAMETERS), told_index)
    fleet.send(craft, message, causes)
