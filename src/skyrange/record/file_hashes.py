"""Sizes and hashes of the files in a run's folder: the manifest's `files`, and their comparison with what is there."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from skyrange.core.input_files import open_input
from skyrange.record.folder import PARTS
from skyrange.record.manifest import MANIFEST
from skyrange.record.spool import SPOOL

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
    with os.scandir(folder) as found:
        entries = sorted(found, key=lambda entry: entry.name)
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
    elif not path.is_file():
        yield f"{name}: missing — expected a file of {entry.get('bytes')} bytes"
    elif (found := describe_file(path, str(folder), name)) != entry:
        what = "bytes" if found["bytes"] != entry.get("bytes") else "blake2b"
        yield f"{name}: {what} {found[what]} — expected {entry.get(what)}"
