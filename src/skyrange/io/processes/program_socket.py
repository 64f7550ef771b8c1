"""Connections to child processes over a stream socket, which the process inherits as its standard input.

So a server of inetd gets its connection; the program's output and errors go to a file. When this process ends, the
socket closes, and the program ends when it reads the end of file.

Over one to a radio engine go requests and answers, each with a deadline.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import socket
import tempfile
import time
import weakref
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from skyrange.codec.medium_protocol import (
    HEADER,
    MessageType,
    decode_failed,
    decode_forked,
    pack,
    unpack_header,
)
from skyrange.core.errors import ComponentError, DecodeError
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
        sock.settimeout(0.0)
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
    *,
    is_wrapper: bool = False,
) -> tuple[socket.socket, Program]:
    """Start `command` in `folder`; returns our end of the socket, and the program (arguments as its).

    Raises `ComponentError` in the name of `name` if it cannot be started.
    """
    own_end, program_end = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        program = Program(name, command, folder, stdin=program_end.fileno(), is_wrapper=is_wrapper)
    except BaseException:
        own_end.close()
        raise
    finally:
        program_end.close()
    return own_end, program


CLOSE_S: Final = 2.0
"""How long an engine may take to end by itself before it is killed, in seconds of wall time."""


class EngineSocket(ProgramSocket):
    """One engine: the process that was started, or a copy that forked from it."""

    slow_hint = "Give it more time with `params = { deadline_s = … }`, if it was busy"

    def __init__(self, name: str, command: Sequence[str], deadline_s: float) -> None:
        """Start `command`; an answer must come within `deadline_s` of wall time.

        Raises `ComponentError` in the name of `name` if it cannot be started.
        """
        self.name = name
        self.deadline_s = deadline_s
        folder = tempfile.TemporaryDirectory(prefix="skyrange-engine-")
        try:
            own_end, program = start_with_socket(name, command, Path(folder.name))
        except BaseException:
            folder.cleanup()
            raise
        self._take(own_end, program, program.pid, folder)

    def _take(
        self, sock: socket.socket, program: Program, pid: int, folder: tempfile.TemporaryDirectory[str] | None
    ) -> None:
        """`program` is the one that was started; with a `folder` this is its own connection, else that of a copy."""
        self.use(sock, program)
        self.pid = pid
        """Process id of the engine."""
        self._number = 0
        handle = _open_process(pid) if folder is None else -1
        self.close = weakref.finalize(self, _end, sock, program, handle, folder)

    def request(self, kind: MessageType, body: bytes = b"", descriptor: int | None = None) -> tuple[MessageType, bytes]:
        """Send a request, and return the type and body of its answer.

        Raises `ComponentError` if the engine has ended, says that it failed, answers something else than this request,
        or does not answer in time.
        """
        self._number += 1
        until = time.monotonic() + self.deadline_s
        self.send(pack(kind, self._number, body), until, descriptor)
        return self._receive(self._number, until)

    def fork(self) -> EngineSocket:
        """Let the engine fork, and return the connection to its copy."""
        own_end, engine_end = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            kind, body = self.request(MessageType.FORK, descriptor=engine_end.fileno())
            pid = self._pid(kind, body)
            twin = object.__new__(EngineSocket)
            twin.name, twin.deadline_s = self.name, self.deadline_s
            twin._take(own_end, self._program, pid, None)
        except BaseException:
            own_end.close()
            raise
        finally:
            engine_end.close()
        kind, body = twin._receive(self._number, time.monotonic() + self.deadline_s)
        if twin._pid(kind, body) != pid:
            raise ComponentError(self.name, "forked, but the copy names another process id")
        return twin

    def _pid(self, kind: MessageType, body: bytes) -> int:
        if kind != MessageType.FORKED:
            raise ComponentError(self.name, f"answered {kind.name} to FORK")
        try:
            return decode_forked(body)
        except DecodeError as error:
            raise self.misspoke(error) from None

    def misspoke(self, error: DecodeError) -> ComponentError:
        """The failure of an engine that sent something that is not in the protocol."""
        return ComponentError(self.name, f"sent {error}", "See the reference page of the medium protocol")

    def _receive(self, number: int, until: float) -> tuple[MessageType, bytes]:
        try:
            length, kind, answered = unpack_header(self.read(HEADER.size, until))
            body = self.read(length, until)
            if kind == MessageType.FAILED:
                raise ComponentError(self.name, f"failed: {decode_failed(body)}")
        except DecodeError as error:
            raise self.misspoke(error) from None
        if answered != number:
            raise ComponentError(self.name, f"answered request {answered}; request {number} is open")
        return kind, body


def _open_process(pid: int) -> int:
    """A handle of a process, which stays valid when its number is used again; -1 where the system has none."""
    try:
        return os.pidfd_open(pid)
    except (OSError, AttributeError):
        return -1


def _end(sock: socket.socket, program: Program, handle: int, folder: tempfile.TemporaryDirectory[str] | None) -> None:
    """End an engine: ask it, wait a little, and kill it if it stays."""
    with contextlib.suppress(OSError):
        sock.send(pack(MessageType.CLOSE, 0))
    sock.close()
    if folder is not None:
        until = time.monotonic() + CLOSE_S
        while program.running and time.monotonic() < until:
            time.sleep(0.002)
        program.kill()
        folder.cleanup()
    elif handle >= 0:
        exit_poll = select.poll()
        exit_poll.register(handle, select.POLLIN)
        if not exit_poll.poll(CLOSE_S * 1000.0):
            with contextlib.suppress(OSError):
                signal.pidfd_send_signal(handle, signal.SIGKILL)
        os.close(handle)
