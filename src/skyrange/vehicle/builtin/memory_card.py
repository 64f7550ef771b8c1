"""Memory card of an aircraft: directories, files and flight logs, by the rules of the FAT file system.

After libraries/AP_Filesystem/AP_Filesystem_FATFS.cpp and FatFs (http://elm-chan.org/fsw/ff/), whose results become the
numbers of `errno` (`fatfs_to_errno`): names are the same in any case, paths begin at the root with or without a slash,
a directory that is not empty is not removed, and nothing is renamed to a name that is taken. Directories are those of a
flight controller (AP_HAL/board/chibios.h). Assumed: the size of the card, a cluster of 4 KiB for each entry, no ".." in
paths, and that a log may be removed or altered while it is written, which ends it.

Flight logs in ArduPilot's DataFlash format: what one holds, and its bytes. A log is kept as a few values and a list of
events, and becomes bytes when somebody reads it: so an aircraft that nobody asks pays for its arming and its mode
changes alone. It has what AP_Logger writes when a log starts (parameters, mission, origin, home) and on events (EV,
MODE, PARM), in the layouts of libraries/AP_Logger/LogStructure.h; it has no samples of sensors and estimates.
"""

from __future__ import annotations

import errno
import os
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


LOG_DIRECTORY: Final = "APM/LOGS"
"""HAL_BOARD_LOG_DIRECTORY."""
CAPACITY_BYTES: Final = 4 << 20
"""Assumed size of a card. A real one has gigabytes; this one is small so that hostile writes take little memory."""
CLUSTER_BYTES: Final = 4096
_FORBIDDEN: Final = frozenset('"*:<>?|\x7f\\') | {chr(number) for number in range(32)}
"""Characters that FatFs refuses in names (`create_name`)."""
_MAX_NAME: Final = 255
_LAST_LOG: Final = f"{LOG_DIRECTORY}/LASTLOG.TXT"


def fail(number: int) -> OSError:
    """The error of a call that sets `errno`."""
    return OSError(number, os.strerror(number))


@dataclass(slots=True)
class Entry:
    """One name on the card: a file (bytes or a log) or a directory (`None`)."""

    name: str
    content: bytearray | FlightLog | None

    @property
    def is_directory(self) -> bool:
        """Whether it is a directory."""
        return self.content is None

    def read(self) -> bytes:
        """The bytes of a file."""
        return self.content.encode() if isinstance(self.content, FlightLog) else bytes(self.content or b"")


def _empty_card() -> dict[str, Entry]:
    names = ("APM", LOG_DIRECTORY, "APM/scripts")
    return {name.upper(): Entry(name.rpartition("/")[2], None) for name in names}


@dataclass(slots=True)
class FileStore:
    """A card. Paths are text without NUL; calls that fail raise `OSError` with the `errno` of ArduPilot's FAT."""

    entries: dict[str, Entry] = field(default_factory=_empty_card)
    """By path in capital letters, without a slash at the ends, in the order in which they were made."""
    log: FlightLog | None = None
    """The log that is being written."""
    last_log: int = 0
    """Number of the last log."""

    def list_directory(self, path: str) -> list[Entry]:
        """The entries of a directory, in the order in which they were made."""
        key = _key(path)
        if key and (key not in self.entries or not self.entries[key].is_directory):
            raise fail(errno.ENOENT)
        return [entry for name, entry in self.entries.items() if name.rpartition("/")[0] == key]

    def find_file(self, path: str) -> Entry:
        """A file."""
        entry = self.entries.get(_key(path))
        if entry is None or entry.is_directory:
            raise fail(errno.ENOENT)
        return entry

    def open_to_write(self, path: str, *, create: bool) -> bytearray:
        """The content of a file that is to be written: with `create` a new or an emptied one, else one that exists.

        A log that is opened so becomes a file as any other.
        """
        key = self._key_in_directory(path)
        entry = self.entries.get(key)
        if entry is not None and entry.is_directory:
            raise fail(errno.EACCES)
        if entry is None:
            if not create:
                raise fail(errno.ENOENT)
            entry = self._add(key, path, bytearray())
        elif create:
            self._detach(entry)
            entry.content = bytearray()
        elif isinstance(entry.content, FlightLog):
            self._detach(entry)
            entry.content = bytearray(entry.read())
        assert isinstance(entry.content, bytearray)
        return entry.content

    def write(self, content: bytearray, offset: int, data: bytes) -> None:
        """Write to a file that was opened. A gap before `offset` is filled with zeros (on a card: with what was there).

        FatFs clips a place beyond what the card can hold, and a write of nothing is an error of ArduPilot's.
        """
        if not data:
            raise fail(errno.EIO)
        end = offset + len(data)
        # a file that was removed while it is open is not among those on the card, and grows no larger than the card
        if max(end, self._used_bytes() + max(0, end - len(content))) > CAPACITY_BYTES:
            raise fail(errno.EIO)
        if offset > len(content):
            content.extend(bytes(offset - len(content)))
        content[offset:end] = data

    def make_directory(self, path: str) -> None:
        """Make a directory."""
        key = self._key_in_directory(path)
        if key in self.entries:
            raise fail(errno.EEXIST)
        self._add(key, path, None)

    def remove(self, path: str) -> None:
        """Remove a file or an empty directory."""
        key = _key(path)
        entry = self.entries.get(key)
        if entry is None:
            raise fail(errno.ENOENT if key else errno.EINVAL)
        if entry.is_directory and self.list_directory(path):
            raise fail(errno.EACCES)
        self._detach(entry)
        del self.entries[key]

    def rename(self, old: str, new: str) -> None:
        """Rename or move a file, or a directory with what is in it."""
        before, after = _key(old), self._key_in_directory(new)
        if not before or before not in self.entries:
            raise fail(errno.ENOENT if before else errno.EINVAL)
        if after in self.entries and after != before:
            raise fail(errno.EEXIST)
        if after.startswith(f"{before}/"):
            raise fail(errno.EACCES)
        inside = f"{before}/"
        self.entries = {
            after + key[len(before) :] if key == before or key.startswith(inside) else key: entry
            for key, entry in self.entries.items()
        }
        self.entries[after].name = _parts(new)[-1]

    def start_log(self, log: FlightLog) -> None:
        """Begin a log, numbered after the last one (AP_Logger_File.cpp); without a log directory there is none."""
        if not self._has_log_directory():
            return
        self.last_log += 1
        path = f"{LOG_DIRECTORY}/{self.last_log:08d}.BIN"
        self.entries[path.upper()] = Entry(path.rpartition("/")[2], log)
        self.entries[_LAST_LOG] = Entry("LASTLOG.TXT", bytearray(b"%u\r\n" % self.last_log))
        self.log = log

    def logs(self) -> list[Entry]:
        """The logs in the log directory, oldest first."""
        if not self._has_log_directory():
            return []
        logs = [entry for entry in self.list_directory(LOG_DIRECTORY) if _is_log(entry)]
        return sorted(logs, key=lambda entry: entry.name.upper())

    def _has_log_directory(self) -> bool:
        """Whether it is there, and a directory: a client can have removed it, and made a file of that name."""
        entry = self.entries.get(LOG_DIRECTORY.upper())
        return entry is not None and entry.is_directory

    def _add(self, key: str, path: str, content: bytearray | None) -> Entry:
        if self._used_bytes() + CLUSTER_BYTES > CAPACITY_BYTES:
            raise fail(errno.EACCES)
        entry = self.entries[key] = Entry(_parts(path)[-1], content)
        return entry

    def _detach(self, entry: Entry) -> None:
        """End a log whose file is altered or removed."""
        if entry.content is self.log:
            self.log = None

    def _key_in_directory(self, path: str) -> str:
        """The key of a path whose directory exists."""
        key = _key(path)
        if not key:
            raise fail(errno.EINVAL)
        above = key.rpartition("/")[0]
        if above and (above not in self.entries or not self.entries[above].is_directory):
            raise fail(errno.ENOENT)
        return key

    def _used_bytes(self) -> int:
        files = sum(len(entry.content) for entry in self.entries.values() if isinstance(entry.content, bytearray))
        return files + CLUSTER_BYTES * len(self.entries)


def _is_log(entry: Entry) -> bool:
    stem, _, extension = entry.name.upper().rpartition(".")
    return not entry.is_directory and extension == "BIN" and stem.isascii() and stem.isdigit()


def _parts(path: str) -> list[str]:
    return [part for part in path.split("/") if part not in ("", ".")]


def _key(path: str) -> str:
    parts = _parts(path)
    for part in parts:
        if part == "..":
            raise fail(errno.ENOENT)
        if len(part) > _MAX_NAME or not _FORBIDDEN.isdisjoint(part):
            raise fail(errno.EINVAL)
    return "/".join(parts).upper()
