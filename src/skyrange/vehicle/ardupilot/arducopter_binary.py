"""ArduCopter binary: found by variable, on PATH or among installed copies, and examined without running it.

ELF check: whether a file is a program for this machine, and what it is otherwise. Only the headers are read (System V
ABI, "ELF Header" and "Program Header"; machine numbers of its registry); nothing is run.
"""

from __future__ import annotations

import hashlib
import os
import platform
import re
import shlex
import shutil
import stat
import struct
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal, NamedTuple

from skyrange.core.errors import ComponentError, InputError
from skyrange.core.files import expand_user

MACHINES: Final = {
    "x86_64": (64, 62), "amd64": (64, 62), "aarch64": (64, 183), "arm64": (64, 183), "armv7l": (32, 40),
    "armv6l": (32, 40), "i686": (32, 3), "i386": (32, 3), "riscv64": (64, 243), "ppc64le": (64, 21), "s390x": (64, 22),
}  # fmt: skip
"""Names that `platform.machine` returns, and the word length and `e_machine` of their programs."""

_OTHER: Final = (
    (b"#!", "a script"),
    (b"\x1f\x8b", "a gzip archive"),
    (b"PK\x03\x04", "a zip archive"),
    (b"\xfd7zXZ\x00", "an xz archive"),
    (b"BZh", "a bzip2 archive"),
    (b"MZ", "a Windows program"),
    (b"\xcf\xfa\xed\xfe", "a macOS program"),
    (b"\xca\xfe\xba\xbe", "a macOS program"),
    (b"<", "an HTML page or XML text"),
    (b"{", "JSON, as an .apj firmware for flight controllers is"),
    (b":", "an Intel HEX firmware for flight controllers"),
)
"""First bytes of files that are mistaken for programs."""


class _Layout(NamedTuple):
    header: struct.Struct
    """What follows `e_ident`, up to `e_shnum`."""

    segment: struct.Struct
    """One program header, up to `p_filesz`."""

    offset: int
    """Index of `p_offset` among the segment's values; `p_filesz` is three further."""


_LAYOUTS: Final = {
    32: _Layout(struct.Struct("HHIIIIIHHHHH"), struct.Struct("IIIII"), 1),
    64: _Layout(struct.Struct("HHIQQQIHHHHH"), struct.Struct("IIQQQQ"), 2),
}
_BYTE_ORDERS: Final = {1: "<", 2: ">"}
_EXECUTABLE, _SHARED_OBJECT, _CORE = 2, 3, 4
_LOADED: Final = 1


def why_not_executable(data: bytes, machine: str) -> str:
    """Why the file `data` is not a program for `machine`, a name of `MACHINES`; "" if it is one.

    For a machine that is not listed, any word length and type is accepted.
    """
    if not data.startswith(b"\x7fELF"):
        return _file_kind(data)
    bits, order = {1: 32, 2: 64}.get(_at(data, 4)), _BYTE_ORDERS.get(_at(data, 5))
    if bits is None or order is None:
        return "an ELF file with a broken header"
    layout = _LAYOUTS[bits]
    header = struct.Struct(order + layout.header.format)
    if len(data) < 16 + header.size:
        return f"an ELF program cut off after {len(data)} bytes"
    kind, number, _, _, segments_at, sections_at, _, _, step, count, section_size, sections = header.unpack_from(
        data, 16
    )
    wanted = MACHINES.get(machine.lower())
    if wanted is not None and (bits, number) != wanted:
        name = next(
            (name for name, machine_id in MACHINES.items() if machine_id == (bits, number)),
            f"ELF machine {number}, {bits} bits",
        )
        return f"a program for another machine ({name})"
    if kind not in (_EXECUTABLE, _SHARED_OBJECT):
        return "a core dump" if kind == _CORE else "an object file, not a program"
    segment = struct.Struct(order + layout.segment.format)
    end = sections_at + section_size * sections
    loaded = 0
    for index in range(count):
        at = segments_at + index * step
        if at + segment.size > len(data):
            return f"an ELF program cut off after {len(data):,} bytes"
        values = segment.unpack_from(data, at)
        loaded += values[0] == _LOADED
        end = max(end, values[layout.offset] + values[layout.offset + 3])
    if end > len(data):
        return f"an ELF program cut off after {len(data):,} of at least {end:,} bytes"
    return "" if loaded else "an ELF file with nothing to run"


def _at(data: bytes, index: int) -> int:
    return data[index] if index < len(data) else -1


def _file_kind(data: bytes) -> str:
    """The kind of a file that is not ELF."""
    start = data[:512].lstrip()
    if not data:
        return "an empty file"
    return next((name for magic, name in _OTHER if start.startswith(magic)), "a file that is not a program")


VARIABLE: Final = "SKYRANGE_ARDUCOPTER"
"""Environment variable that names the binary; it precedes all other places."""

PROGRAM: Final = "arducopter"

MIN_VERSION: Final = (4, 5)
"""Older versions (major, minor) are refused: names of parameters and of command-line options differ."""

SUPPORTED_VERSION: Final = (4, 6)
"""From this version (major, minor) on, flights are expected to work."""

MAX_BYTES: Final = 256 << 20
"""A larger file is not read; ArduPilot's own binaries have 4 to 10 MB, with debug symbols 80 MB."""

ANSWER_S: Final = 10.0
"""Wall time within which a binary must answer `--help`; it takes some 10 ms."""

REQUIRED_OPTIONS: Final = (
    "--model",
    "--home",
    "--defaults",
    "--serial0",
    "--serial1",
    "--sim-port-out",
    "--start-time",
    "--sysid",
)
"""The command-line options that the engine uses; `--help` must list them."""

BATTERY: Final = "battery of the range"
CAPABILITIES: Final = {
    "lockstep": b"no_time_sync\0",
    BATTERY: b"\0rc_12\0",
    "GNSS over MAVLink": b"AP_GPS_MAV",
    "Open Drone ID": b"OpenDroneID",
}
"""Optional capabilities of a build, and the bytes that show them in the file: keys of the JSON backend, names of
classes. Of the battery's own keys, "battery", "voltage" and "current", all are common words; rc_12 is a key of the
same table that came with them (libraries/SITL/SIM_JSON.h, `keytable`)."""

_FIRMWARE: Final = re.compile(
    rb"(ArduCopter|APM:Copter|ArduPlane|APM:Plane|ArduRover|APM:Rover|ArduSub|Blimp|AntennaTracker|AP_Periph)"
    rb" V(\d{1,3}\.\d{1,3}(?:\.\d{1,3})?(?:-?[A-Za-z]{1,8}\d{0,3})?)(?=[\0\s(])"
)
"""The firmware's own name, as each vehicle's version.h spells it ("ArduCopter V4.6.3")."""

_SIMULATION_MARK: Final = b"--speedup"
"""Occurs in the help text of a build for SITL and in no build for a flight controller."""

_SUPPORTED_TEXT: Final = ".".join(map(str, SUPPORTED_VERSION))

Source = Literal["SKYRANGE_ARDUCOPTER", "PATH", "installed"]

_HOW_TO_GET: Final = f"Run `skyrange install ardupilot`, or set {VARIABLE} to an arducopter binary for SITL."


@dataclass(frozen=True, slots=True)
class Binary:
    """An ArduCopter for SITL: `version` as its firmware states it ("4.6.3", "4.7.0-dev"), `sha256` of the file in hex.

    `capabilities` are those of `CAPABILITIES` that were built in.
    """

    path: Path
    sha256: str
    version: str
    source: Source
    capabilities: tuple[str, ...] = ()


_seen: dict[tuple[str, int, int], Binary] = {}
"""Files that were examined and accepted, by path, size and time of change."""


def data_folder() -> Path:
    """The folder of installed copies, each in a folder named after its version."""
    user = os.environ.get("XDG_DATA_HOME") or os.path.expanduser("~/.local/share")
    return Path(user) / "skyrange" / "ardupilot"


def installed() -> list[Path]:
    """Installed copies, the newest version first, by name only."""
    return sorted(data_folder().glob(f"*/{PROGRAM}"), key=lambda path: version_key(path.parent.name), reverse=True)


def find_binary() -> Binary:
    """The `arducopter` to use: from the variable SKYRANGE_ARDUCOPTER, else on PATH, else the newest installed one.

    The first one that exists is used. Raises `InputError` if it is unsuitable, or if there is none.
    """
    named = os.environ.get(VARIABLE)
    if named:
        return examine_binary(expand_user(named), VARIABLE)
    on_path = shutil.which(PROGRAM)
    if on_path is not None:
        return examine_binary(Path(on_path), "PATH")
    for path in installed():
        return examine_binary(path)
    places = f"{VARIABLE} (not set), PATH and {data_folder()}"
    raise InputError.one("ArduPilot", places, "no arducopter", "ArduPilot's ArduCopter for SITL", _HOW_TO_GET)


def examine_binary(path: Path, source: Source = "installed") -> Binary:
    """Examine a file without running it: it must be a complete program for this machine, and a recent enough
    ArduCopter.

    Raises `InputError`, naming the source of the path, with what the file is instead.
    """
    who = {VARIABLE: VARIABLE, "PATH": "arducopter on PATH", "installed": "installed arducopter"}[source]
    path = path.absolute()
    where = str(path)
    try:
        facts = path.stat()
        if stat.S_ISDIR(facts.st_mode):
            hint = "Give the path of the file in that folder."
            raise InputError.one(who, where, "a folder", "the arducopter file itself", hint)
        if not stat.S_ISREG(facts.st_mode):
            raise InputError.one(who, where, "not a regular file", "an arducopter file", _HOW_TO_GET)
        if facts.st_size > MAX_BYTES:
            expected = f"an arducopter, no larger than {MAX_BYTES:,}"
            raise InputError.one(who, where, f"a file of {facts.st_size:,} bytes", expected, _HOW_TO_GET)
        key = (where, facts.st_size, facts.st_mtime_ns)
        if key not in _seen:
            data = path.read_bytes()
            version = _version(data, who, where)
            capabilities = tuple(name for name, mark in CAPABILITIES.items() if mark in data)
            _seen[key] = Binary(path, hashlib.sha256(data).hexdigest(), version, source, capabilities)
    except OSError as error:
        problem = (error.strerror or str(error)).lower()
        raise InputError.one(who, where, problem, "a readable arducopter file", _HOW_TO_GET) from None
    if not os.access(path, os.X_OK):
        hint = f"Make it executable: chmod +x {shlex.quote(where)}"
        raise InputError.one(who, where, "a file that is not executable", "an executable", hint)
    return replace(_seen[key], source=source)


def _version(data: bytes, who: str, where: str) -> str:
    """The version of the ArduCopter in `data`; raises `InputError` if it is not one for this machine."""
    machine = platform.machine()
    expected = f"ArduPilot's ArduCopter for SITL, a Linux program for {machine}"
    wrong = why_not_executable(data, machine)
    if wrong:
        raise InputError.one(who, where, wrong, expected, _HOW_TO_GET)
    vehicles: dict[str, str] = {}
    for match in _FIRMWARE.finditer(data):
        vehicles.setdefault(match[1].decode(), match[2].decode())
    version = vehicles.get("ArduCopter") or vehicles.get("APM:Copter")
    if version is None:
        for name, other in vehicles.items():
            raise InputError.one(who, where, f"{name} {other}", "ArduCopter, the only vehicle flown here", _HOW_TO_GET)
        raise InputError.one(who, where, "a program without ArduPilot's version in it", expected, _HOW_TO_GET)
    if version_key(version)[0][:2] < MIN_VERSION:
        hint = "`skyrange install ardupilot` gets a newer one."
        raise InputError.one(who, where, f"ArduCopter {version}", f"version {_SUPPORTED_TEXT} or newer", hint)
    if _SIMULATION_MARK not in data:
        value = f"ArduCopter {version} for a flight controller"
        raise InputError.one(who, where, value, "a build for SITL", _HOW_TO_GET)
    return version


def version_key(version: str) -> tuple[tuple[int, ...], int, int]:
    """Sort key of a version: numbers, then dev, beta, rc, released, then the number of the beta or rc."""
    match = re.match(r"(\d+(?:\.\d+)*)-?([A-Za-z]*)(\d*)", version)
    if match is None:
        return (), 0, 0
    stages = {"dev": 0, "beta": 1, "rc": 2}
    return tuple(map(int, match[1].split("."))), stages.get(match[2].lower(), 3), int(match[3] or 0)


def check_help(who: str, ended: str, text: str) -> None:
    """Check how `who` answered `--help`: how it ended, and its output. Raises `ComponentError` unless both are as in
    SITL.
    """
    if ended != "exit 0":
        lines = text.strip().splitlines()
        raise ComponentError(who, f"`--help` ended with {ended}" + (f": {lines[-1][:200]}" if lines else ""))
    missing = [option for option in REQUIRED_OPTIONS if option not in text]
    if missing:
        raise ComponentError(who, f"`--help` does not list {', '.join(missing)}", _HOW_TO_GET)
