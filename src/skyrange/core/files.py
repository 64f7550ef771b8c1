"""Files: reading of regular files of bounded size and of JSON of bounded depth, and their atomic replacement.

Everything that skyrange reads on behalf of a user passes `read_input`: a pipe, a device or a file without end cannot
block it or fill the memory.

Readers of a file that is replaced see the old contents or the new, never a part. No link is followed for writing: in a
folder that somebody else made, it could lead to any file of the user.
"""

from __future__ import annotations

import csv
import json
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path
from typing import Any, BinaryIO, Final

from skyrange.core.errors import InputError

MIB: Final = 1 << 20
MAX_TEXT_BYTES: Final = 16 * MIB
"""Largest scenario or Python file: a fleet of 50,000 aircraft written out one by one."""
MAX_RECORD_BYTES: Final = 1024 * MIB
"""Largest JSON file of a record: a manifest, or the buildings."""

_KINDS: Final = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def expand_user(path: Path | str) -> Path:
    """`path` with `~` and `~USER` as the shell expands them: a user that does not exist leaves the name as it is."""
    try:
        return Path(os.path.expanduser(path))
    except ValueError:  # a NUL
        return Path(path)


@contextmanager
def open_input(
    path: Path, who: str, where: str, *, expected: str = "a file", hint: str = ""
) -> Iterator[BufferedReader]:
    """Open a regular file for reading.

    Raises `InputError` in the name of `who` if there is none, if it cannot be read, also in the block, or if it is a
    folder, a pipe, a socket or a device.
    """
    try:
        number = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)  # a pipe without a writer does not block
        mode = os.fstat(number).st_mode
        if not stat.S_ISREG(mode):
            os.close(number)
            kind = next((words for test, words in _KINDS if test(mode)), "no regular file")
            raise InputError.one(who, where, f"{path} is {kind}", expected, hint)
        with os.fdopen(number, "rb") as file:
            yield file
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise InputError.one(who, where, f"{path}: {reason}", f"{expected} that can be read", hint) from None
    except ValueError as error:  # a NUL in the name, or a character that no file's name can have
        raise InputError.one(who, where, ascii(str(path)), f"the name of {expected} ({error})", hint) from None


def read_input(path: Path, who: str, where: str = "file", *, max_bytes: int, expected: str = "a file") -> bytes:
    """Read a whole file; raises `InputError` as `open_input`, and for a file of more than `max_bytes`."""
    with open_input(path, who, where, expected=expected) as file:
        size = os.fstat(file.fileno()).st_size
        # files of the system (/proc) have size 0
        data = file.read(min(max(size, 1 << 16), max_bytes) + 1) if size <= max_bytes else b""
    if max(size, len(data)) > max_bytes:
        value = f"{path} of {max(size, len(data)) / MIB:.1f} MiB"
        raise InputError.one(who, where, value, f"{expected} of at most {_size(max_bytes)}")
    return data


def read_package_text(module: str, name: str) -> str:
    """The text of a file of the package; `module` is the `__file__` of a module in its folder."""
    return Path(module).with_name(name).read_text(encoding="utf-8")


def read_package_table(module: str, name: str) -> list[dict[str, str]]:
    """The rows of a CSV file of the package, by its head; `module` is the `__file__` of a module in its folder."""
    return list(csv.DictReader(read_package_text(module, name).splitlines()))


def parse_json(data: bytes | str, who: str, where: str) -> Any:
    """The value in JSON text.

    Raises `InputError` that names `where` and the line if there is none, or one nested too deep, for a whole number
    beyond 64 bits, and for a text that is not Unicode: half of a surrogate pair.
    """
    try:
        value = json.loads(data, parse_int=_parse_int64)
        if _may_have_surrogates(data):
            json.dumps(value, ensure_ascii=False).encode()
        return value
    except json.JSONDecodeError as error:
        raise InputError.one(who, f"{where}:{error.lineno}", error.msg, "JSON", "The file is damaged.") from None
    except UnicodeDecodeError as error:
        raise InputError.one(who, where, f"byte {error.start}", "JSON in UTF-8", "The file is damaged.") from None
    except UnicodeEncodeError as error:
        value = ascii(error.object[error.start : error.end])[:20]
        raise InputError.one(who, where, value, "text in Unicode", "The file is damaged.") from None
    except RecursionError:
        raise InputError.one(who, where, "nested too deep", "JSON", "The file is damaged.") from None
    except ValueError as error:  # a number of too many digits
        raise InputError.one(who, where, str(error), "JSON", "The file is damaged.") from None


def _may_have_surrogates(data: bytes | str) -> bool:
    return any(mark in data for mark in (b"\\ud", b"\\uD")) if isinstance(data, bytes) else "\\u" in data


def _parse_int64(digits: str) -> int:
    if len(digits) > 20 or not -(2**63) <= (value := int(digits)) < 2**64:
        raise ValueError(f"the whole number {digits[:24]}… of more than 64 bits")
    return value


def _size(size: int) -> str:
    return f"{size / MIB:g} MiB" if size >= MIB else f"{size:,} bytes"


DRAFT: Final = ".part"
"""Suffix of the temporary file beside a file that is being written. A killed process may leave one."""


@contextmanager
def atomic_write(path: Path) -> Iterator[BinaryIO]:
    """Open a temporary file beside `path` for writing; flush it to the disk and rename it to `path` at the block's end.

    If the block raises, also `KeyboardInterrupt`, the temporary file is deleted and `path` stays as it was. Raises
    `OSError` if the file cannot be written. Two processes must not write the same `path` at once. Where `path` or the
    temporary file is a link, the link is replaced, not what it names.
    """
    draft = path.with_name(path.name + DRAFT)
    draft.unlink(missing_ok=True)
    try:
        with draft.open("xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        draft.replace(path)
    except BaseException:
        draft.unlink(missing_ok=True)
        raise


@contextmanager
def lock_file(path: Path, refusal: InputError) -> Iterator[None]:
    """Hold the lock of a file, which is made if there is none; raises `refusal` if another process holds it.

    Forked processes inherit the lock, so that it is held until the last of them has ended. Raises `InputError` if the
    file cannot be opened, and for a link.
    """
    import fcntl

    try:
        number = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)
    except OSError as error:
        value = f"{path}: {(error.strerror or str(error)).lower()}"
        raise InputError.one(refusal.who, "lock", value, "a file that can be written, and no link") from None
    with os.fdopen(number, "rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise refusal from error
        yield


def refuse_links(folder: Path, who: str) -> None:
    """Raise `InputError` if there is a symbolic link in a folder, at any depth; the folder itself may be one."""
    folders = [os.fspath(folder)]
    while folders:
        with os.scandir(folders.pop()) as entries:
            for entry in entries:
                if entry.is_symlink():
                    hint = "Put there what it names, or delete it."
                    expected = "a folder without links, because files in it are written and deleted"
                    raise InputError.one(who, "link", f"{entry.path} to {os.readlink(entry.path)}", expected, hint)
                if entry.is_dir(follow_symlinks=False):
                    folders.append(entry.path)
