"""Checksums of the files of a data set, in the format of `sha256sum`."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from skyrange.core.errors import InputError, Problem
from skyrange.core.files import atomic_write
from skyrange.core.input_files import MAX_RECORD_BYTES, open_input, read_input
from skyrange.study.dataset.progress import BUILDING, require_whole

CHECKSUMS: Final = "SHA256SUMS"


def sha256_of(path: Path) -> str:
    """The SHA-256 of a file in hexadecimal digits."""
    with open_input(path, str(path.parent), path.name) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def dataset_files(folder: Path) -> Iterator[Path]:
    """The files of a data set in order of their names, without the checksums."""
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.name != CHECKSUMS and BUILDING not in path.relative_to(folder).parts:
            yield path


def write_checksums(folder: Path) -> None:
    """Write the checksums of all files; `sha256sum --check SHA256SUMS` compares them."""
    lines = [f"{sha256_of(path)}  {path.relative_to(folder).as_posix()}\n" for path in dataset_files(folder)]
    with atomic_write(folder / CHECKSUMS) as file:
        file.write("".join(lines).encode())


def check_checksums(folder: Path) -> None:
    """Raise `InputError` for each file that is missing, altered, or not listed, or for a build that is not finished."""
    require_whole(folder)
    file = folder / CHECKSUMS
    if not file.is_file():
        raise InputError.one(str(folder), CHECKSUMS, "missing", "the checksums of a data set")
    listed = read_input(file, str(folder), max_bytes=MAX_RECORD_BYTES).decode()
    wanted = {name: digest for digest, name in (line.split("  ", 1) for line in listed.splitlines())}
    found = {path.relative_to(folder).as_posix(): path for path in dataset_files(folder)}
    problems = [Problem(name, "missing", "a file of the data set") for name in sorted(wanted.keys() - found.keys())]
    problems += [Problem(name, "not listed", f"a file in {CHECKSUMS}") for name in sorted(found.keys() - wanted.keys())]
    for name in sorted(wanted.keys() & found.keys()):
        if sha256_of(found[name]) != wanted[name]:
            problems.append(Problem(name, "altered", "the contents at the time of building"))
    if problems:
        raise InputError(str(folder), problems)
