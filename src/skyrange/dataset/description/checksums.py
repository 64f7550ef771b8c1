"""Checksums of the files of a data set, in the format of `sha256sum`."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from skyrange.core.files import atomic_write, open_input
from skyrange.dataset.progress import BUILDING

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
