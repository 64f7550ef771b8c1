"""Connection to a child process over a stream socket, which the process inherits as its standard input.

So a server of inetd gets its connection; the program's output and errors go to a file. When this process ends, the
socket closes, and the program ends when it reads the end of file.
"""

from __future__ import annotations

import select
import socket
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from skyrange.core.errors import ComponentError
from skyrange.io.processes.program import Program

PIECE_BYTES: Final = 1 << 20


class ProgramSocket:
    """Bytes to and from one program, each transfer with a deadline on the clock of `time.monotonic`."""

    name: str
    """In whose name errors are raised."""
    deadline_s: float
    """Of wall time, for an answer."""
    slow_hint: str = ""
    """What to do if the program is too slow."""

    def use(self, sock: socket.socket, program: Program) -> None:
        """Use a connected socket of `program`."""
        self._socket = sock
        self._program = program
        sock.setblocking(False)
        self._ready = select.poll()
        self._ready.register(sock, select.POLLIN)

    def send(self, data: bytes, until: float, descriptor: int | None = None) -> None:
        """Send all of `data`, with a file descriptor if one is given. Raises `ComponentError` after `until`, or if the
        program has ended.
        """
        view = memoryview(data)
        while view:
            try:
                if descriptor is not None:
                    sent = socket.send_fds(self._socket, [view], [descriptor])
                    descriptor = None
                else:
                    sent = self._socket.send(view)
            except BlockingIOError:
                self._wait(until, select.POLLOUT)
                continue
            except OSError:
                raise self.lost() from None
            view = view[sent:]

    def read(self, count: int, until: float) -> bytes:
        """Read `count` bytes. Raises `ComponentError` after `until`, or if the program has ended."""
        pieces = []
        while count:
            try:
                piece = self._socket.recv(min(count, PIECE_BYTES))
            except BlockingIOError:
                self._wait(until, select.POLLIN)
                continue
            except OSError:
                raise self.lost() from None
            if not piece:
                raise self.lost()
            pieces.append(piece)
            count -= len(piece)
        return pieces[0] if len(pieces) == 1 else b"".join(pieces)

    def _wait(self, until: float, event: int) -> None:
        left = until - time.monotonic()
        self._ready.modify(self._socket, event)
        if left <= 0 or not self._ready.poll(left * 1000.0):
            raise ComponentError(self.name, f"did not answer for {self.deadline_s:g} s of wall time", self.slow_hint)

    def lost(self) -> ComponentError:
        """What is known of a program that closed its socket."""
        until = time.monotonic() + 0.5
        while self._program.running and time.monotonic() < until:
            time.sleep(0.01)
        ended = self._program.ended
        words = self._program.last_words()
        return ComponentError(
            self.name,
            f"ended ({ended})" if ended else "closed its socket",
            f"Its last output was: {words}" if words else "It printed nothing",
        )


def start_with_socket(
    name: str,
    command: Sequence[str],
    folder: Path,
    is_wrapper: bool = False,
) -> tuple[socket.socket, Program]:
    """Start `command` in `folder`; returns our end of the socket, and the program (arguments as its).

    Raises `ComponentError` in the name of `name` if it cannot be started.
    """
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        program = Program(name, command, folder, stdin=theirs.fileno(), is_wrapper=is_wrapper)
    except BaseException:
        ours.close()
        raise
    finally:
        theirs.close()
    return ours, program
