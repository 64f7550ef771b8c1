"""The file @PARAM/param.pck: all parameters of an aircraft; who writes it sets parameters.

After libraries/AP_Filesystem/AP_Filesystem_Param.cpp of ArduPilot 4.6. Values that are set so are reported to nobody:
`param_upload_parse` saves with `save_sync(false, false)`, while a PARAM_SET is answered to all with PARAM_VALUE.
"""

from __future__ import annotations

import errno
import math
from typing import Final, NamedTuple

from skyrange.codec.ardupilot_files import parameters as packed
from skyrange.core.errors import DecodeError
from skyrange.vehicle.builtin.fleet import Causes, Fleet, Vehicle
from skyrange.vehicle.builtin.memory_card import fail
from skyrange.vehicle.builtin.parameter_protocol import set_parameter
from skyrange.vehicle.builtin.parameters.table import PARAMETERS, count_listed

NAME = packed.PATH.rpartition("/")[2]
_STATED_BYTES: Final = 12
"""By parameter, in the size that is told when the file is opened: the real one depends on how it is read."""
_LIMIT: Final = 0xFFFF


class ParamQuery(NamedTuple):
    """What is read of the parameters, as the name of the file says: `param.pck?start=3&count=9&withdefaults=1`."""

    start: int = 0
    most: int = 0
    """How many parameters, 0 for all."""
    defaults: int = 0


def parse_query(name: str) -> ParamQuery:
    """What a name behind @PARAM/ asks for. Raises `OSError` for another file and for a number that is too large."""
    file, _, question = name.partition("?")
    if file != NAME:
        raise fail(errno.ENOENT)
    numbers = {key: _leading_number(text) for key, _, text in (part.partition("=") for part in question.split("&"))}
    query = ParamQuery(numbers.get("start", 0), numbers.get("count", 0), numbers.get("withdefaults", 0))
    if query.start >= _LIMIT or query.most >= _LIMIT or query.defaults > 1:
        raise fail(errno.EINVAL)
    return query


def stated_size(fleet: Fleet, vehicle: Vehicle) -> int:
    """The size that is told before the file is packed."""
    return count_listed(fleet.stored_params[vehicle.row]) * _STATED_BYTES


def pack(fleet: Fleet, vehicle: Vehicle, query: ParamQuery, read_bytes: int) -> bytes:
    """The file as it is read in pieces of `read_bytes`. Raises `OSError` if it began behind the last parameter."""
    total = count_listed(fleet.stored_params[vehicle.row])
    if query.start >= total:
        raise fail(errno.EINVAL)
    last = min(query.start + (query.most or total), total)
    values = fleet.stored_params[vehicle.row].tolist()
    chosen = [
        packed.PackedParameter(parameter.name, values[index], parameter.kind, parameter.default)
        for index, parameter in enumerate(PARAMETERS[query.start : last], query.start)
    ]
    return packed.pack_download(chosen, total, read_bytes, defaults=bool(query.defaults))


def apply(fleet: Fleet, vehicle: Vehicle, data: bytes, causes: Causes) -> None:
    """Set the parameters of an upload, up to what is malformed; names that the autopilot does not have are skipped.

    Raises `OSError` for what is malformed; what precedes it stays set.
    """
    try:
        for name, value in packed.read_upload(data):
            if math.isfinite(value):
                set_parameter(fleet, vehicle, name, value, causes)
    except DecodeError as error:
        raise fail(errno.EINVAL) from error


def _leading_number(text: str) -> int:
    """As `strtoul`: the digits at the beginning, 0 for none."""
    digits = text[: len(text) - len(text.lstrip("0123456789"))]
    return int(digits[:9] or "0")
