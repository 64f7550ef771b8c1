"""Installation of ArduPilot's official SITL binary in the user's data folder, from its server or from a file."""

from __future__ import annotations

import os
import platform
import re
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import IO, Final, NamedTuple
from urllib.parse import urlsplit

from skyrange.core.errors import ComponentError, InputError
from skyrange.core.files import read_input
from skyrange.install.download import NotThereError, OnProgress, download
from skyrange.io.processes.program import run_once
from skyrange.vehicle.ardupilot.arducopter_binary import (
    ANSWER_S,
    MAX_BYTES,
    MIN_VERSION,
    PROGRAM,
    SUPPORTED_VERSION,
    Binary,
    check_help,
    data_folder,
    examine_binary,
    version_key,
)

DEFAULT_VERSION: Final = "4.7.0"
"""The version that is downloaded by default. It is a fixed release, so that two machines get the same one."""

SERVER: Final = "https://firmware.ardupilot.org/Copter"
"""ArduPilot's server: folders `stable-VERSION`, each with one folder per board."""

VARIABLE: Final = "SKYRANGE_ARDUPILOT_URL"
"""Environment variable with the address of a mirror of `SERVER` that has the same folders."""

BOARD: Final = "SITL_x86_64_linux_gnu"

_NO_NETWORK_HINT: Final = f"Without a network, use --from FILE. To use a mirror, set {VARIABLE}."

_OTHER_CONTENT_HINT: Final = (
    "A proxy or a log-in page may have answered. To install a file from elsewhere, use --from FILE."
)


class Installed(NamedTuple):
    """An installed binary, and the address or file from which it was installed."""

    binary: Binary
    origin: str


def install(version: str | None = None, source: Path | None = None, on_progress: OnProgress | None = None) -> Installed:
    """Install ArduCopter for SITL in the data folder: the release `version`, or the file `source`.

    The binary is examined, must be of `version` if one is given, and must answer when it is run. It then replaces an
    installed binary of the same version in one step. Raises `InputError` or `ComponentError`; nothing is left behind
    then.
    """
    wanted = None if version is None else _parse_release(version)
    if source is None:
        wanted = wanted or DEFAULT_VERSION
        url = _address_of(wanted)
        with _temporary_file() as (file, path):
            try:
                download(url, file, on_progress, _NO_NETWORK_HINT)
            except NotThereError as error:
                expected = f"a version that the server has ({error})"
                raise InputError.one("skyrange install ardupilot", "--version", wanted, expected) from None
            return Installed(_store_download(file, path, wanted, url), url)
    with _temporary_file() as (file, path):
        _copy_file(source, file, on_progress)
        return Installed(_store_file(file, path, wanted, source), str(source.absolute()))


def _parse_release(version: str) -> str:
    """The requested version in the form "4.6.3"."""
    plain = version.strip().lower().removeprefix("stable-").removeprefix("v")
    who, least = "skyrange install ardupilot", ".".join(map(str, SUPPORTED_VERSION))
    if re.fullmatch(r"\d{1,3}\.\d{1,3}\.\d{1,3}", plain) is None:
        hint = f"{SERVER} lists releases as stable-…"
        raise InputError.one(who, "--version", version, f"a release, such as {DEFAULT_VERSION}", hint)
    if version_key(plain)[0][:2] < MIN_VERSION:
        raise InputError.one(who, "--version", version, f"version {least} or newer")
    return plain


def _address_of(version: str) -> str:
    """The address of that version for this machine."""
    machine = platform.machine()
    if sys.platform != "linux" or machine.lower() not in ("x86_64", "amd64"):
        raise InputError.one(
            "skyrange install ardupilot", "this machine", f"{sys.platform} on {machine}",
            "Linux on x86_64, for which ArduPilot publishes its SITL",
            "Build arducopter for SITL from ArduPilot's sources, and install it with --from FILE.",
        )  # fmt: skip
    server = os.environ.get(VARIABLE) or SERVER
    try:
        parts = urlsplit(server)
        usable = parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
        usable = usable and not re.search(r"[\s\x00-\x1f]", server) and server.isascii()
    except ValueError:
        usable = False
    if not usable:
        raise InputError.one(VARIABLE, "address", server, f"an http or https address, such as {SERVER}")
    return f"{server.rstrip('/')}/stable-{version}/{BOARD}/{PROGRAM}"


@contextmanager
def _temporary_file() -> Iterator[tuple[IO[bytes], Path]]:
    """Create a temporary file in the data folder; yields it and its path, and deletes it unless it was moved.

    Folders that were made for it and stay empty are removed.
    """
    folder = data_folder()
    made = [ancestor for ancestor in (folder, *folder.parents) if not ancestor.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        number, name = tempfile.mkstemp(prefix=f".{PROGRAM}-", dir=folder)
    except OSError as error:
        _remove_empty(made)
        raise _not_writable(folder, error) from None
    path = Path(name)
    try:
        with os.fdopen(number, "wb") as file:
            yield file, path
    except OSError as error:
        raise _not_writable(folder, error) from None
    finally:
        path.unlink(missing_ok=True)
        _remove_empty(made)


def _remove_empty(folders: Sequence[Path]) -> None:
    for folder in folders:
        with suppress(OSError):  # not empty, or not there
            folder.rmdir()


def _not_writable(folder: Path, error: OSError) -> InputError:
    problem = (error.strerror or str(error)).lower()
    expected = "a writable folder with 10 MB of free space"
    return InputError.one("data folder", str(folder), problem, expected, "Set XDG_DATA_HOME to use another folder.")


def _copy_file(source: Path, into: IO[bytes], on_progress: OnProgress | None) -> None:
    """Copy the given file, which need not be executable."""
    data = read_input(source, "--from", max_bytes=MAX_BYTES, expected="an arducopter binary")
    into.write(data)
    if on_progress is not None:
        on_progress(len(data), len(data))


def _store_download(file: IO[bytes], path: Path, wanted: str, url: str) -> Binary:
    """Verify and store a downloaded file; raises `ComponentError`, which blames the server, if it is wrong."""
    try:
        return _store(file, path, wanted, url)
    except InputError as error:
        fault = error.problems[0]
        problem = f"sent {fault.value}; expected {fault.expected}"
        raise ComponentError(urlsplit(url).netloc, problem, _OTHER_CONTENT_HINT) from None


def _store_file(file: IO[bytes], path: Path, wanted: str | None, source: Path) -> Binary:
    """Verify and store the given file; raises `InputError` if it is wrong."""
    try:
        return _store(file, path, wanted, str(source))
    except InputError as error:
        raise InputError("--from", [replace(fault, where=str(source)) for fault in error.problems]) from None


def _store(file: IO[bytes], path: Path, wanted: str | None, origin: str) -> Binary:
    """Make the file at `path` executable, examine it, run it, and move it to the folder of its version."""
    file.flush()
    os.fsync(file.fileno())
    file.close()  # a file open for writing is not run
    path.chmod(0o755)
    binary = examine_binary(path)
    if wanted is not None and binary.version != wanted:
        raise InputError.one("arducopter", str(path), f"ArduCopter {binary.version}", f"version {wanted}")
    answer = run_once(path, "--help", deadline_s=ANSWER_S, who=origin)
    check_help(origin, answer.ended, answer.text)
    target = data_folder() / binary.version / PROGRAM
    new = not target.parent.exists()
    try:
        target.parent.mkdir(exist_ok=True)
        path.replace(target)
    except OSError:
        _remove_empty([target.parent] if new else [])
        raise
    return replace(binary, path=target)
