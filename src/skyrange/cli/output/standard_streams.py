"""Standard streams that survive their reader: output without a reader is discarded, and the command goes on."""

from __future__ import annotations

import errno
import io
import os
import sys
from typing import Any, Final, TextIO

_READER_GONE: Final = (errno.EPIPE, errno.EIO, errno.ENXIO, errno.EBADF)
"""Errors of a pipe whose reader has ended (`| head`), of a terminal that was closed, and of a closed descriptor."""

_INHERITABLE: Final = True


class _LossyFile(io.FileIO):
    """A descriptor that refers to the null device once its reader has gone."""

    def __init__(self, descriptor: int, *, loses_all: bool) -> None:
        super().__init__(descriptor, "w", closefd=False)
        self._loses_all = loses_all

    def write(self, data: Any) -> int:
        """Write, or discard if nobody can read it; a full disk is an error, except for notices."""
        try:
            return super().write(data)
        except OSError as error:
            if error.errno not in _READER_GONE and not self._loses_all:
                raise
        discard_output(self.fileno())
        return memoryview(data).nbytes


def open_standard_streams() -> None:
    """Open the three standard streams where they are closed, and make both outputs survive their readers.

    A closed one is the null device: otherwise the next file that is opened would have its number, and receive what
    libraries print. A character that the encoding lacks is written as "?".
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            opened = os.open(os.devnull, os.O_RDWR)  # the lowest number that is free: this one
            os.set_inheritable(opened, _INHERITABLE)
    sys.stdout = _lossy_stream(sys.stdout, 1)
    sys.stderr = _lossy_stream(sys.stderr, 2)


def discard_output(descriptor: int) -> None:
    """Let `descriptor` refer to the null device."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, descriptor)
    os.close(nowhere)


def _lossy_stream(stream: TextIO | None, descriptor: int) -> TextIO:
    encoding = "utf-8"
    if stream is not None:
        try:
            if stream.fileno() != descriptor:
                return stream
        except OSError:  # it has no descriptor: another program's, which calls `main`
            return stream
        encoding = stream.encoding
    raw = _LossyFile(descriptor, loses_all=descriptor == 2)
    buffer = io.BufferedWriter(raw)
    # line by line, as Python's own standard error
    lines = descriptor == 2 or raw.isatty()
    return io.TextIOWrapper(buffer, encoding=encoding, errors="replace", line_buffering=lines)
