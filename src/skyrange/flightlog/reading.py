"""Reading of a log whose format its first bytes tell, whatever the file is called."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final

from skyrange.codec.mavlink.telemetry_log import is_time
from skyrange.core.errors import InputError
from skyrange.core.files import expand_user, open_input
from skyrange.flightlog.model import FlightLog, Remark

_ULOG: Final = b"ULog\x01\x12\x35"
_DATAFLASH: Final = b"\xa3\x95"
_MAVLINK: Final = (0xFE, 0xFD)
_SUFFIXES: Final = {"tlog": (".tlog", ".rlog"), "dataflash": (".bin", ".log"), "ulog": (".ulg", ".ulog")}
_EXPECTED: Final = "a log of MAVLink frames with times (.tlog), of ArduPilot (.BIN) or of PX4 (.ulg)"
_SEARCHED: Final = 4096
"""Bytes at the beginning of a telemetry log in which a frame has to begin."""


def find_format(data: bytes) -> str | None:
    """The format of a log that begins with `data`: tlog, dataflash or ulog."""
    if data.startswith(_ULOG):
        return "ulog"
    if data.startswith(_DATAFLASH):
        return "dataflash"
    for at in range(min(len(data) - 8, _SEARCHED)):
        if data[at + 8] in _MAVLINK and is_time(data[at : at + 8]):
            return "tlog"
    return None


def read_log(file: Path | str, system: int | None = None, vehicle: str | None = None) -> FlightLog:
    """The log of one vehicle.

    A telemetry log may have several: it is that with the MAVLink system id `system`. Of a run's folder it is `vehicle`.

    Raises `InputError` for a file that is missing, is no log, or has nothing that can be read.
    """
    path = expand_user(file)
    who = str(path)
    if path.is_dir():
        from skyrange.flightlog.run_folder import read_run

        return read_run(path, vehicle)
    if vehicle is not None:
        raise InputError.one(who, "--vehicle", vehicle, "the folder of a run", "Vehicles of a .tlog have a --system.")
    with open_input(path, who, "file", expected=_EXPECTED) as opened:
        data = opened.read(_SEARCHED + 9)
    found = find_format(data)
    if found is None:
        raise InputError.one(who, "file", repr(data[:8]), _EXPECTED, "Text logs (.log) have to be converted first.")
    if found == "ulog":
        from skyrange.flightlog.ulog import read_ulog

        log = read_ulog(path)
    elif found == "dataflash":
        from skyrange.flightlog.dataflash import read_dataflash

        log = read_dataflash(path)
    else:
        from skyrange.flightlog.tlog import read_tlog

        log = read_tlog(path, system)
    if path.suffix.lower() in _SUFFIXES[found]:
        return log
    text = f"the file is called {path.suffix or 'without a suffix'}, and is read as what it is, a {found}"
    return replace(log, remarks=(Remark("file", text), *log.remarks))
