"""Flight logs in ArduPilot's DataFlash format: what one holds, and its bytes.

A log is kept as a few values and a list of events, and becomes bytes when somebody reads it: so an aircraft that nobody
asks pays for its arming and its mode changes alone. It has what AP_Logger writes when a log starts (parameters,
mission, origin, home) and on events (EV, MODE, PARM), in the layouts of libraries/AP_Logger/LogStructure.h; it has no
samples of sensors and estimates.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.core.time import NS_PER_US, Time
from skyrange.vehicle.builtin.parameters.table import PARAMETERS

MAX_EVENTS: Final = 5_000
"""Events that one log keeps, so that commands without end take no memory without end. A card has room for more."""
EV_ARMED, EV_DISARMED = 10, 11
"""LogEvent::ARMED and DISARMED (AP_Logger.h)."""
REASONS: Final = {
    name: number
    for number, name in enumerate((
        "unknown", "rc_command", "gcs_command", "radio_failsafe", "battery_failsafe", "gcs_failsafe", "ekf_failsafe",
        "gps_glitch", "mission_end", "throttle_land_escape", "fence_breached", "terrain_failsafe", "brake_timeout",
        "flip_complete", "avoidance", "avoidance_recovery", "throw_complete", "terminate", "toy_mode", "crash_failsafe",
    ))
}  # fmt: skip
"""Numbers of the first reasons of a mode change (AP_Vehicle/ModeReason.h); any other is logged as unknown."""
_HEAD: Final = b"\xa3\x95"
"""HEAD_BYTE1 and HEAD_BYTE2 before each message."""
_FMT_ID: Final = 128
"""LOG_FORMAT_MSG."""
_FMT: Final = struct.Struct("<2sBBB4s16s64s")


class _Kind(NamedTuple):
    """A message of a log; its number is told by its FMT, and is an assumed one here."""

    number: int
    name: str
    format: str
    columns: str
    layout: struct.Struct


_PARM: Final = _Kind(64, "PARM", "QNff", "TimeUS,Name,Value,Default", struct.Struct("<2sBQ16sff"))
_MSG: Final = _Kind(65, "MSG", "QZ", "TimeUS,Message", struct.Struct("<2sBQ64s"))
_CMD: Final = _Kind(
    66, "CMD", "QHHHffffLLfB", "TimeUS,CTot,CNum,CId,Prm1,Prm2,Prm3,Prm4,Lat,Lng,Alt,Frame",
    struct.Struct("<2sBQHHHffffiifB"),
)  # fmt: skip
_ORGN: Final = _Kind(67, "ORGN", "QBLLe", "TimeUS,Type,Lat,Lng,Alt", struct.Struct("<2sBQBiii"))
_MODE: Final = _Kind(68, "MODE", "QMBB", "TimeUS,Mode,ModeNum,Rsn", struct.Struct("<2sBQBBB"))
_EV: Final = _Kind(69, "EV", "QB", "TimeUS,Id", struct.Struct("<2sBQB"))
_KINDS: Final = (_PARM, _MSG, _CMD, _ORGN, _MODE, _EV)

LoggedItem = tuple[int, float, float, float, float, int, int, float, int]
"""Command, its four parameters, x, y, z and frame of a mission item."""
LogEvent = tuple[Time, str, float, float]
"""When, the name of the message (EV, MODE or PARM), and two numbers: EV id, 0; MODE mode, reason; PARM index, value."""


@dataclass(slots=True)
class FlightLog:
    """What one log holds."""

    boot_ns: Time
    start_ns: Time
    utc_s: int
    """UTC when it began, by the clock of the aircraft, in seconds since 1970; 0 if that is not known."""
    banner: tuple[str, ...]
    params: NDArray[np.float64]
    """(parameters,) values when it began."""
    mission: tuple[LoggedItem, ...]
    places: tuple[tuple[int, int, float], ...]
    """Origin of the estimator and home: latitude and longitude in 1e-7 degrees, metres above mean sea level."""
    events: list[LogEvent] = field(default_factory=list)

    def add(self, now: Time, name: str, first: float, second: float = 0.0) -> None:
        """Add an event, unless it is full."""
        if len(self.events) < MAX_EVENTS:
            self.events.append((now, name, first, second))

    def encode(self) -> bytes:
        """Its bytes."""
        out = [_format(_FMT_ID, _FMT.size, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")]
        out += [_format(kind.number, kind.layout.size, kind.name, kind.format, kind.columns) for kind in _KINDS]
        begin = self._us(self.start_ns)
        out += [_pack(_MSG, begin, text.encode()) for text in self.banner]
        out += [_parameter(begin, index, value) for index, value in enumerate(self.params.tolist())]
        for number, (command, a, b, c, d, x, y, z, frame) in enumerate(self.mission):
            out.append(_pack(_CMD, begin, len(self.mission), number, command, a, b, c, d, x, y, z, frame))
        for kind, (lat, lon, alt_m) in enumerate(self.places):
            out.append(_pack(_ORGN, begin, kind, lat, lon, round(alt_m * 100.0)))
        for at, name, first, second in self.events:
            if name == "EV":
                out.append(_pack(_EV, self._us(at), int(first)))
            elif name == "MODE":
                out.append(_pack(_MODE, self._us(at), int(first), int(first), int(second)))
            else:
                out.append(_parameter(self._us(at), int(first), second))
        return b"".join(out)

    def _us(self, at: Time) -> int:
        return (at - self.boot_ns) // NS_PER_US


def _pack(kind: _Kind, *values: float | bytes) -> bytes:
    return kind.layout.pack(_HEAD, kind.number, *values)


def _parameter(us: int, index: int, value: float) -> bytes:
    parameter = PARAMETERS[index]
    return _pack(_PARM, us, parameter.name.encode(), value, parameter.default)


def _format(number: int, size: int, name: str, layout: str, columns: str) -> bytes:
    return _FMT.pack(_HEAD, _FMT_ID, number, size, name.encode(), layout.encode(), columns.encode())
