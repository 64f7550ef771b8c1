"""How does a file go to another machine of the range, or come from it? In pieces, each with one message."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path, PurePosixPath

from skyrange.core.errors import ComponentError
from skyrange.runtime.live.control import CHUNK_BYTES


def chunks(data: bytes) -> Iterator[tuple[int, bytes]]:
    """The pieces of a file, each with its place; an empty one has one piece."""
    for offset in range(0, max(len(data), 1), CHUNK_BYTES):
        yield offset, data[offset : offset + CHUNK_BYTES]


def listed(folder: Path) -> list[tuple[str, int]]:
    """All files below `folder`: relative name and size."""
    found = (path for path in sorted(folder.rglob("*")) if path.is_file() and not path.is_symlink())
    return [(path.relative_to(folder).as_posix(), path.stat().st_size) for path in found]


def read_chunk(folder: Path, name: str, offset: int) -> bytes:
    """A piece of a file below `folder`; none beyond its end. `ComponentError` as `inside`; `OSError`."""
    with inside(folder, name).open("rb") as file:
        file.seek(offset)
        return file.read(CHUNK_BYTES)


def write_chunk(folder: Path, name: str, offset: int, data: bytes) -> None:
    """Put a piece where it belongs. `ComponentError` as `inside`; `OSError`."""
    path = inside(folder, name)
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("r+b" if offset else "wb") as file:
        file.seek(offset)
        file.write(data)


def inside(folder: Path, name: str) -> Path:
    """The path of a name that another machine said; `ComponentError` where it would lie outside of `folder`."""
    parts = PurePosixPath(name).parts
    if not parts or PurePosixPath(name).is_absolute() or ".." in parts or "\0" in name or "\\" in name:
        raise ComponentError("live", f"a file named {name!r} was announced, which would lie outside of {folder}")
    return folder.joinpath(*parts)
