"""How are parameters asked for and set? PARAM_REQUEST_LIST, …_READ, PARAM_SET, answered with PARAM_VALUE.

https://mavlink.io/en/services/parameter.html as ArduPilot speaks it (libraries/GCS_MAVLink/GCS_Param.cpp): a value
travels as a float whatever its type, and the type that a PARAM_SET names is not read; a whole parameter is cut, not
rounded, and stops at the ends of its type; every other number is stored as it comes, and told so. An unknown name or
index, and a value that is not finite, get no answer. A parameter asked for or set under its name of 4.7 is answered
under that name and in its unit; the list has 4.6's names only.
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
"""What a list begins with, as ArduCopter does (`send_banner`)."""
_BATCH = 5
_PAUSE_NS = 10 * NS_PER_MS
"""A list goes out five values every 10 ms, not all at once: a serial line's pace (`queued_param_send`)."""
_SET_INDEX = 0xFFFF


def send_banner(fleet: Fleet, craft: Craft) -> None:
    """Firmware and frame as texts."""
    for words in BANNER:
        fleet.text(craft, dialect.MAV_SEVERITY_INFO, words)


def on_list(fleet: Fleet, craft: Craft, message: Any, partner: tuple[int, int], causes: Causes) -> None:
    """PARAM_REQUEST_LIST: start sending every parameter, from the first again where a list was under way."""
    send_banner(fleet, craft)
    craft.params_next = 0
    fleet.timer(craft, Timer.PARAMS, fleet.now)


def on_timer(fleet: Fleet, craft: Craft) -> None:
    """Send the next few of the list."""
    last = min(craft.params_next + _BATCH, len(PARAMETERS))
    for index in range(craft.params_next, last):
        _tell(fleet, craft, index, index, PARAMETERS[index].name)
    craft.params_next = last
    if last < len(PARAMETERS):
        fleet.timer(craft, Timer.PARAMS, fleet.now + _PAUSE_NS)


def on_read(fleet: Fleet, craft: Craft, message: Any, partner: tuple[int, int], causes: Causes) -> None:
    """PARAM_REQUEST_READ: one parameter by index, or by name where the index is -1."""
    index = message.param_index
    if index != -1:
        if 0 <= index < len(PARAMETERS):
            _tell(fleet, craft, index, index, PARAMETERS[index].name)
        return
    name = clean_name(message.param_id)
    known = nominal(name)
    if known in INDEX:
        _tell(fleet, craft, INDEX[known], _SET_INDEX, name)


def on_set(fleet: Fleet, craft: Craft, message: Any, partner: tuple[int, int], causes: Causes) -> None:
    """PARAM_SET: store a finite value of a known parameter and say what is stored."""
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
    _tell(fleet, craft, index, _SET_INDEX, name, causes)


def clean_name(raw: object) -> str:
    """A PARAM_* message's name field as text; bytes that are no ASCII cannot name a parameter."""
    if isinstance(raw, bytes):
        raw = raw.decode("ascii", "replace")
    return str(raw).split("\0", 1)[0]


def _tell(fleet: Fleet, craft: Craft, index: int, told_index: int, name: str, causes: Causes = ()) -> None:
    """PARAM_VALUE of the parameter at `index`, under the name and in the unit that it was asked for."""
    parameter = PARAMETERS[index]
    value = float(fleet.stored[craft.row, index])
    kind = parameter.kind
    if name.upper() != parameter.name:
        value = from_nominal(name, value)
        kind = dialect.MAV_PARAM_TYPE_REAL32
    message = dialect.MAVLink_param_value_message(name.encode(), value, kind, len(PARAMETERS), told_index)
    fleet.send(craft, message, causes)
