"""How are parameters asked for and set? PARAM_REQUEST_LIST, …_READ, PARAM_SET, answered with PARAM_VALUE.

https://mavlink.io/en/services/parameter.html as ArduPilot speaks it (libraries/GCS_MAVLink/GCS_Param.cpp).
"""

from __future__ import annotations

import math
from typing import Any

from skyrange.codec.mavlink import dialect
from skyrange.core.time import NS_PER_MS
from skyrange.vehicle.builtin.fleet import Causes, Craft, Fleet, Timer
from skyrange.vehicle.builtin.parameters import INDEX, PARAMETERS, clean_name, held, value_message

_BATCH = 5
_PAUSE_NS = 10 * NS_PER_MS
"""A list goes out five values every 10 ms, not all at once: a serial line's pace."""
_READ_ONLY = "SYSID_THISMAV"
"""Set by the scenario: an aircraft that renamed itself in flight would leave its own network."""


def on_list(fleet: Fleet, craft: Craft, message: Any, partner: tuple[int, int], causes: Causes) -> None:
    """PARAM_REQUEST_LIST: start sending every parameter."""
    fleet.text(craft, dialect.MAV_SEVERITY_INFO, "ArduCopter V4.6.0-dev (skyrange)")
    craft.params_next = 0
    fleet.timer(craft, Timer.PARAMS, fleet.now)


def on_timer(fleet: Fleet, craft: Craft) -> None:
    """Send the next few of the list."""
    last = min(craft.params_next + _BATCH, len(PARAMETERS))
    for index in range(craft.params_next, last):
        fleet.send(craft, value_message(fleet.settings, craft.row, index, index))
    craft.params_next = last
    if last < len(PARAMETERS):
        fleet.timer(craft, Timer.PARAMS, fleet.now + _PAUSE_NS)


def on_read(fleet: Fleet, craft: Craft, message: Any, partner: tuple[int, int], causes: Causes) -> None:
    """PARAM_REQUEST_READ: one parameter by index, or by name where the index is -1; unknown ones get no answer."""
    index = message.param_index
    found = INDEX.get(clean_name(message.param_id)) if index == -1 else index
    if found is not None and 0 <= found < len(PARAMETERS):
        fleet.send(craft, value_message(fleet.settings, craft.row, found, index & 0xFFFF))


def on_set(fleet: Fleet, craft: Craft, message: Any, partner: tuple[int, int], causes: Causes) -> None:
    """PARAM_SET: store a finite value of a known parameter and say what is stored; else no answer."""
    index = INDEX.get(clean_name(message.param_id))
    if index is None or not math.isfinite(message.param_value):
        return
    parameter = PARAMETERS[index]
    if parameter.name == _READ_ONLY:
        fleet.text(craft, dialect.MAV_SEVERITY_WARNING, f"Param write denied ({parameter.name})")
    else:
        fleet.settings[parameter.name][craft.row] = held(parameter, message.param_value)
        stored = float(fleet.settings[parameter.name][craft.row])
        fleet.note("event.parameter", craft, {"name": parameter.name, "value": stored}, causes)
    fleet.send(craft, value_message(fleet.settings, craft.row, index, 0xFFFF), causes)
