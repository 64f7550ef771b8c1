"""Opening of a log by its content, whatever it is called."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from skyrange.codec.capture_reading import is_capture
from skyrange.core.errors import InputError
from skyrange.core.files import expand_user, open_input
from skyrange.flightlog.reading import find_format
from skyrange.log_detection.capture_log import CaptureLog
from skyrange.log_detection.frame_log import FrameLog
from skyrange.log_detection.observed_log import ObservedLog, Remark
from skyrange.log_detection.telemetry_log import EXPECTED, Side, TelemetryLog, Window

_SEARCHED: Final = 4096 + 9
_SUFFIXES: Final = {"tlog": (".tlog", ".rlog"), "capture": (".pcapng", ".pcap", ".cap", ".ntar")}


@dataclass(frozen=True, slots=True)
class LogOptions:
    """How a file is read; the folder of a run takes none of it."""

    systems: Sequence[int] = ()
    """MAVLink system ids of the vehicles to judge; default: all."""
    side: Side = "gcs"
    """The end of its links at which it was made."""
    from_s: float = 0.0
    to_s: float | None = None
    """The part that is read, in seconds from the first frame on."""


def open_log(file: Path | str, options: LogOptions | None = None) -> ObservedLog:
    """The log in a file or a run's folder.

    Raises `InputError` for what is missing, is no log, or has nothing that can be read.
    """
    options = LogOptions() if options is None else options
    path = expand_user(file)
    if path.is_dir():
        from skyrange.log_detection.run_folder import RunLog

        if options != LogOptions():
            raise InputError.one(str(path), "options", "of files", "none of --system, --end, --from and --to for a run")
        return RunLog(path)
    with open_input(path, str(path), "file", expected=EXPECTED) as opened:
        data = opened.read(_SEARCHED)
    window = Window(options.from_s, options.to_s)
    found = "capture" if is_capture(data) else find_format(data)
    log: FrameLog
    if found == "capture":
        log = CaptureLog(path, options.systems, options.side, window)
    elif found == "tlog":
        log = TelemetryLog(path, options.systems, options.side, window)
    else:
        hint = "" if found is None else f"It is a {found}, which the autopilot writes on board; it has no frames."
        raise InputError.one(str(path), "file", repr(data[:8]) if data else "empty", EXPECTED, hint)
    _remark_name(log, found)
    return log


def _remark_name(log: FrameLog, found: str) -> None:
    """Say that a file is called otherwise than what it is."""
    if log.path.suffix.lower() not in _SUFFIXES[found]:
        text = f"it is called {log.path.suffix or 'without a suffix'}, and is read as what it is, a {found}"
        log.add_remark(Remark("file", text))
