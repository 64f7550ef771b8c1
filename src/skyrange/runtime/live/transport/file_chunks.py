"""Transfer of files between machines of a range: in chunks, each with one control message."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path, PurePosixPath

from skyrange.core.errors import ComponentError
from skyrange.runtime.live.transport.control import CHUNK_BYTES


def split_chunks(data: bytes) -> Iterator[tuple[int, bytes]]:
    """The chunks of a file, each with its offset; an empty file has one chunk."""
    for offset in range(0, max(len(data), 1), CHUNK_BYTES):
        yield offset, data[offset : offset + CHUNK_BYTES]


def list_files(folder: Path) -> list[tuple[str, int]]:
    """All files below `folder`: relative name and size in bytes."""
    found = (path for path in sorted(folder.rglob("*")) if path.is_file() and not path.is_symlink())
    return [(path.relative_to(folder).as_posix(), path.stat().st_size) for path in found]


def read_chunk(folder: Path, name: str, offset: int) -> bytes:
    """A chunk of a file below `folder`, empty beyond its end. `ComponentError` as `path_inside`; `OSError`."""
    with path_inside(folder, name).open("rb") as file:
        file.seek(offset)
        return file.read(CHUNK_BYTES)


def write_chunk(folder: Path, name: str, offset: int, data: bytes) -> None:
    """Write a chunk at its offset. `ComponentError` as `path_inside`; `OSError`."""
    path = path_inside(folder, name)
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("r+b" if offset else "wb") as file:
        file.seek(offset)
        file.write(data)


def path_inside(folder: Path, name: str) -> Path:
    """The path of a name that another machine sent; `ComponentError` where it would lie outside `folder`."""
    parts = PurePosixPath(name).parts
    if not parts or PurePosixPath(name).is_absolute() or ".." in parts or "\0" in name or "\\" in name:
        raise ComponentError("live", f"a file named {name!r} was announced, which would lie outside of {folder}")
    return folder.joinpath(*parts)
