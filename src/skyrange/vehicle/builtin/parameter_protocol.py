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
from skyrange.core.time import NEVER, NS_PER_MS
from skyrange.vehicle.builtin.fleet import Causes, Fleet, Slowdown, Timer, Vehicle
from skyrange.vehicle.builtin.log_events import BANNER
from skyrange.vehicle.builtin.parameters.renames import canonical_name, from_canonical, to_canonical
from skyrange.vehicle.builtin.parameters.table import (
    INDEX,
    PARAMETERS,
    SETTINGS_NAMES,
    count_listed,
    stored_value,
    value_in_range,
)

_PERIOD_NS: Final = 100 * NS_PER_MS
"""Values of a list are sent every 100 ms while SR0_PARAMS is 0, its default (`set_ap_message_interval`)."""
_VALUE_BYTES: Final = 37
"""Length of a PARAM_VALUE frame: 25 bytes and 12 of MAVLink 2's frame."""
_PORT_BYTES_PER_S: Final = 1_000_000
_PORT_BUFFER_BYTES: Final = 8192
"""The port of ArduPilot's simulation: 10 Mbit/s (libraries/AP_HAL_SITL/UARTDriver.cpp), and room for 8 KiB (measured:
221 values at once). A serial line of 57600 baud without flow control sends four or five values in a period."""
_NO_INDEX = 0xFFFF


def send_banner(fleet: Fleet, vehicle: Vehicle) -> None:
    """Send firmware and frame as texts."""
    for line in BANNER:
        fleet.send_text(vehicle, dialect.MAV_SEVERITY_INFO, line)


def on_request_list(fleet: Fleet, vehicle: Vehicle, message: Any, peer: tuple[int, int], causes: Causes) -> None:
    """PARAM_REQUEST_LIST: send every parameter, from the first again where a list was in progress.

    Streams are slower meanwhile (`get_reschedule_interval_ms`).
    """
    send_banner(fleet, vehicle)
    vehicle.next_param = 0
    vehicle.params_sent_ns = fleet.now
    fleet.slow_streams(vehicle, Slowdown.PARAM_LIST, on=True)
    if fleet.timers[vehicle.row, Timer.PARAM_LIST] == NEVER:
        phase = int(fleet.report_phases_ns[vehicle.row])
        fleet.set_timer(vehicle, Timer.PARAM_LIST, fleet.now + (phase - fleet.now) % _PERIOD_NS)


def on_timer(fleet: Fleet, vehicle: Vehicle) -> None:
    """Send the next values of the list: as many as 30 % of the port carries since the last ones, or since the request.

    At least one is sent, and at most what the port's buffer takes (`queued_param_send`). So a list that is requested
    anew sends more or fewer values, by how long before their time the request came.
    """
    since_ms = (fleet.now - vehicle.params_sent_ns) // NS_PER_MS
    allowed = min(max(_PORT_BYTES_PER_S * since_ms // 3333, _VALUE_BYTES), _PORT_BUFFER_BYTES)
    total = count_listed(fleet.stored_params[vehicle.row])
    last = min(vehicle.next_param + allowed // _VALUE_BYTES, total)
    for index in range(vehicle.next_param, last):
        _send_value(fleet, vehicle, index, index, PARAMETERS[index].name)
    vehicle.next_param = last
    vehicle.params_sent_ns = fleet.now
    if last < total:
        fleet.set_timer(vehicle, Timer.PARAM_LIST, fleet.now + _PERIOD_NS)
    else:
        fleet.slow_streams(vehicle, Slowdown.PARAM_LIST, on=False)


def on_request_read(fleet: Fleet, vehicle: Vehicle, message: Any, peer: tuple[int, int], causes: Causes) -> None:
    """PARAM_REQUEST_READ: send one parameter by index, or by name where the index is -1."""
    index = message.param_index
    if index != -1:
        if 0 <= index < count_listed(fleet.stored_params[vehicle.row]):
            _send_value(fleet, vehicle, index, index, PARAMETERS[index].name)
        return
    name = clean_name(message.param_id)
    known = canonical_name(name)
    if known in INDEX:
        _send_value(fleet, vehicle, INDEX[known], _NO_INDEX, name)


def on_set(fleet: Fleet, vehicle: Vehicle, message: Any, peer: tuple[int, int], causes: Causes) -> None:
    """PARAM_SET: store a finite value of a known parameter and report what is stored."""
    name = clean_name(message.param_id).upper()
    if math.isfinite(message.param_value) and set_parameter(fleet, vehicle, name, message.param_value, causes):
        _send_value(fleet, vehicle, INDEX[canonical_name(name)], _NO_INDEX, name, causes)


def set_parameter(fleet: Fleet, vehicle: Vehicle, name: str, value: float, causes: Causes) -> bool:
    """Store a finite value, without a message; `False` for an unknown name. The unit is that of the name's version."""
    name = name.upper()
    known = canonical_name(name)
    if known not in INDEX:
        return False
    index, row = INDEX[known], vehicle.row
    parameter = PARAMETERS[index]
    stored = stored_value(parameter, to_canonical(name, value))
    fleet.stored_params[row, index] = stored
    vehicle.unsaved_params.pop(index, None)
    if known in SETTINGS_NAMES:
        fleet.settings[known][row] = value_in_range(parameter, stored)
    if vehicle.card.log is not None:
        vehicle.card.log.add(fleet.now, "PARM", index, stored)
    fleet.note("event.parameter", vehicle, {"name": known, "value": stored}, causes)
    return True


def clean_name(raw: object) -> str:
    """Return the name field of a PARAM_* message as text; non-ASCII bytes cannot name a parameter."""
    if isinstance(raw, bytes):
        raw = raw.decode("ascii", "replace")
    return str(raw).split("\0", 1)[0]


def _send_value(fleet: Fleet, vehicle: Vehicle, index: int, told_index: int, name: str, causes: Causes = ()) -> None:
    """Send PARAM_VALUE of the parameter at `index`, under the requested name and in its unit."""
    parameter = PARAMETERS[index]
    value = float(fleet.stored_params[vehicle.row, index])
    kind = parameter.kind
    if name.upper() != parameter.name:
        value = from_canonical(name, value)
        kind = dialect.MAV_PARAM_TYPE_REAL32
    total = count_listed(fleet.stored_params[vehicle.row])
    message = dialect.MAVLink_param_value_message(name.encode(), value, kind, total, told_index)
    fleet.send(vehicle, message, causes)
