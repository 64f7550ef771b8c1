"""Memory card of an aircraft: directories, files and flight logs, by the rules of the FAT file system.

After libraries/AP_Filesystem/AP_Filesystem_FATFS.cpp and FatFs (http://elm-chan.org/fsw/ff/), whose results become the
numbers of `errno` (`fatfs_to_errno`): names are the same in any case, paths begin at the root with or without a slash,
a directory that is not empty is not removed, and nothing is renamed to a name that is taken. Directories are those of a
flight controller (AP_HAL/board/chibios.h). Assumed: the size of the card, a cluster of 4 KiB for each entry, no ".." in
paths, and that a log may be removed or altered while it is written, which ends it.
"""

from __future__ import annotations

import errno
import os
from dataclasses import dataclass, field
from typing import Final

from skyrange.vehicle.builtin.files.flight_log import FlightLog

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

    def open_to_write(self, path: str, create: bool) -> bytearray:
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
        found = [entry for entry in self.list_directory(LOG_DIRECTORY) if _is_log(entry)]
        return sorted(found, key=lambda entry: entry.name.upper())

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
        files = sum(len(one.content) for one in self.entries.values() if isinstance(one.content, bytearray))
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
