"""Run folder: creation, input files, sizes and hashes of its files, and removal if the run cannot start."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path, PurePosixPath
from types import MappingProxyType
from typing import Any, Final

from skyrange.core.errors import InputError
from skyrange.core.files import open_input
from skyrange.record.manifest import MANIFEST
from skyrange.record.spool import SPOOL

PARTS = ".parts"
"""What a run's folder may hold before it is a record: the records of a live run's nodes (`record.live_merge`)."""

PLUGINS = "plugins"
"""The folder, inside a run's folder, of the plugin files that the run was started with."""

GIVEN_FILES = "given"
"""The folder, inside a run's folder, of the files that parameters of plugins name."""

LOSS_TABLE = "radio/losses.parquet"
"""The file, inside a run's folder, of the loss table on which the run was flown."""

_PART = re.compile(r"^[\w(][\w.+ ()-]{0,127}$")
_NOT_PLAIN = re.compile(r"[^\w.+ ()-]")
_KEPT_CHARACTERS = 60
"""Of a name that is copied: at most 240 bytes, which every file system takes."""


def check_folder_name(folder: Path, who: str = "output") -> None:
    """Raise `InputError` if the whole name of a folder is not UTF-8: Arrow neither writes nor reads tables there."""
    try:
        str(folder.absolute()).encode()
    except UnicodeEncodeError:
        named = os.fsencode(folder.absolute()).decode(errors="backslashreplace")
        raise InputError.one(who, "folder", named, "a name in UTF-8", "Rename it, or choose another.") from None


def make_new_folder(folder: Path) -> Path:
    """Create the folder of a comparison and its parents; raises `InputError` if it holds anything."""
    check_folder_name(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        obstacle = next(folder.iterdir(), None)
    except OSError as error:
        raise InputError.one(
            "output", str(folder), error.strerror or str(error), "a folder that can be created"
        ) from None
    if obstacle is not None:
        hint = "Choose another folder, or move that one away."
        raise InputError.one("output", "folder", f"{folder} (holds {obstacle.name})", "a new or empty folder", hint)
    return folder


def make_folder(folder: Path) -> list[Path]:
    """Create the folder, its parents and its spool; returns the folders that did not exist before, innermost first.

    Raises `InputError` if it holds anything but `PARTS`. If several runs claim one folder at once, exactly one
    succeeds, because the spool's folder can be created only once.
    """
    check_folder_name(folder)
    missing = [ancestor for ancestor in (folder, *folder.parents) if not ancestor.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        obstacle = next((path for path in folder.iterdir() if path.name != PARTS), None)
        if obstacle is None:
            (folder / SPOOL).mkdir()
    except FileExistsError as error:
        if not folder.is_dir():
            raise unwritable_error(folder, error) from error
        obstacle = folder / SPOOL
    except OSError as error:
        raise unwritable_error(folder, error) from error
    if obstacle is not None:
        hint = "Choose another folder, or move that one away."
        raise InputError.one("output", "folder", f"{folder} (holds {obstacle.name})", "a new or empty folder", hint)
    return missing


def remove_folder(folder: Path, made: Sequence[Path]) -> None:
    """Remove what `make_folder` created and everything put into `folder` since, except `PARTS`."""
    for path in folder.iterdir() if folder.is_dir() else ():
        if path.name != PARTS:
            shutil.rmtree(path, ignore_errors=True) if path.is_dir() else path.unlink(missing_ok=True)
    for path in made:
        with suppress(OSError):  # somebody else may have put files there
            path.rmdir()


def plain_name(name: str) -> str:
    """A name for a copy of the file `name` that `put_file` takes: letters, digits and `_.+ ()-`, with the same end."""
    return _NOT_PLAIN.sub("_", name).replace("..", "__")[-_KEPT_CHARACTERS:]


def unwritable_error(path: Path, error: OSError) -> InputError:
    """The error for an output that cannot be written, raised before the run starts."""
    reason = error.strerror or str(error)
    return InputError.one("output", str(path), reason, "a writable folder on a disk with free space")


def put_file(folder: Path, name: str, data: bytes) -> None:
    """Write `data` to `name` in `folder`.

    `name` is a relative path of plain names. Raises `InputError` for a path that leaves the folder or that the record
    uses itself, and if writing fails.
    """
    parts = PurePosixPath(name).parts
    if not parts or not all(_PART.fullmatch(part) and ".." not in part for part in parts):
        raise InputError.one("attachment", "name", name, "a relative path of plain names, such as missions/a.plan")
    if parts[0].endswith(".parquet") or parts[0] in (MANIFEST, f"{MANIFEST}.new", "operators", "telemetry"):
        raise InputError.one("attachment", "name", name, "a name that the record does not use itself")
    target = folder.joinpath(*parts)
    try:
        try:
            target.write_bytes(data)
        except FileNotFoundError:
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(data)
    except OSError as error:
        raise unwritable_error(target, error) from error


REPORT: Final = "report.html"
"""The one file of a run's folder that is written again later."""


def describe_files(
    folder: Path, known: Mapping[str, dict[str, Any]] = MappingProxyType({})
) -> dict[str, dict[str, Any]]:
    """The manifest's `files`: size and hash (BLAKE2b, 16 bytes) of every file in a run's folder, but the manifest.

    The entries of `known` files are taken as they are.
    """
    return {name: known.get(name) or describe_file(folder / name, str(folder), name) for name in _names(folder)}


def _names(folder: Path) -> Iterator[str]:
    for name in _list_files(folder):
        if name.partition("/")[0] not in (SPOOL, PARTS) and name not in (MANIFEST, REPORT):
            yield name


def _list_files(folder: Path, start: str = "") -> Iterator[str]:
    """The names of all files below a folder, in order, each beginning with `start`."""
    with os.scandir(folder) as scan:
        entries = sorted(scan, key=lambda entry: entry.name)
    for entry in entries:
        if entry.is_dir(follow_symlinks=False):
            yield from _list_files(folder / entry.name, f"{start}{entry.name}/")
        elif entry.is_file():
            yield f"{start}{entry.name}"


def describe_file(path: Path, who: str, name: str) -> dict[str, Any]:
    """The size and hash of a file; raises `InputError` for `name` of `who` if it cannot be read."""
    with open_input(path, who, name) as file:
        digest = hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=16))
        return {"bytes": file.tell(), "blake2b": digest.hexdigest()}


def describe_bytes(data: bytes) -> dict[str, Any]:
    """The size and hash of a file with this content."""
    return {"bytes": len(data), "blake2b": hashlib.blake2b(data, digest_size=16).hexdigest()}


def check_file(folder: Path, name: str, entry: Any) -> Iterator[str]:
    """What is wrong with a file of the folder, by its entry in the manifest's `files`."""
    path = folder / name
    if not isinstance(entry, dict) or Path(name).is_absolute() or ".." in Path(name).parts:
        yield f"{MANIFEST}: files: {name} — expected the name of a file in the folder, with bytes and blake2b"
    elif not os.path.isfile(path):
        yield f"{name}: missing — expected a file of {entry.get('bytes')} bytes"
    elif (description := describe_file(path, str(folder), name)) != entry:
        what = "bytes" if description["bytes"] != entry.get("bytes") else "blake2b"
        yield f"{name}: {what} {description[what]} — expected {entry.get(what)}"
