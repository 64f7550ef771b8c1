"""TCP ports for viewers: ground stations that receive frames, and whose own bytes are discarded.

Nothing here blocks: sockets are served when `serve` is called. A viewer that does not read fast enough loses complete
frames, so its stream remains one of frames, and the data that waits for it is bounded.
"""

from __future__ import annotations

import contextlib
import errno
import selectors
import socket
from collections.abc import Sequence
from dataclasses import dataclass, field

from skyrange.core.errors import InputError, Problem
from skyrange.io.limited_listener import find_idlest
from skyrange.io.processes.program import raise_file_limit

LOOPBACK = "127.0.0.1"
MAX_VIEWERS = 8
"""At one port at a time; for a further one, the one that has been idle the longest gives way."""
MAX_MORE_VIEWERS = 64
"""At all ports together, beside one for each."""
WAITING_BYTES = 1 << 16
"""Bytes that may wait for one viewer beside the system's own buffer, which is set to the same size."""
_CHUNK = 1 << 16
HIGHEST_PORT = 65_535


@dataclass(slots=True)
class ViewerCounts:
    """Events at all ports so far."""

    viewers: int = 0
    """Viewers that have connected."""
    displaced: int = 0
    """Viewers that gave way to others, because as many were there as there may be."""
    frames_lost: int = 0
    """Frames not sent to a viewer because it read too slowly, or because a run of garbage was too long."""
    bytes_ignored: int = 0
    """Bytes that viewers have sent."""


@dataclass(slots=True)
class _Viewer:
    place: int
    connection: socket.socket
    peer: str
    waiting: bytearray = field(default_factory=bytearray)


class ViewerPorts:
    """One listening port per place 0, 1, 2 …, at one address of this machine."""

    def __init__(self, ports: Sequence[int], host: str = LOOPBACK) -> None:
        """Listen at `ports` of the IP address `host`, 0 for any that is free.

        Raises `InputError` if one cannot be had; then none is held.
        """
        self._most = len(ports) + MAX_MORE_VIEWERS
        raise_file_limit(len(ports) + self._most, "viewers")  # the listeners, and a viewer for each beside those
        self.counts = ViewerCounts()
        self._selector = selectors.DefaultSelector()
        self._listeners: list[socket.socket] = []
        self._viewers: list[list[_Viewer]] = [[] for _ in ports]
        for place, port in enumerate(ports):
            try:
                listener = _listening(host, port)
            except (OSError, OverflowError) as error:
                self.close()
                raise InputError("viewers", [_why(host, port, error)]) from error
            self._listeners.append(listener)
            self._selector.register(listener, selectors.EVENT_READ, place)
        self.numbers = [int(listener.getsockname()[1]) for listener in self._listeners]
        """The port of each place."""

    def watched(self, place: int) -> bool:
        """Whether a viewer is connected at `place`."""
        return bool(self._viewers[place])

    def show(self, place: int, frame: bytes) -> None:
        """Queue a frame for all viewers of a place, to be sent at the next `serve`."""
        for viewer in self._viewers[place]:
            if len(viewer.waiting) + len(frame) > WAITING_BYTES:
                self.counts.frames_lost += 1
            else:
                viewer.waiting += frame

    def serve(self) -> None:
        """Accept viewers, discard what they have sent, send what waits for them; returns at once."""
        for key, _ in self._selector.select(0):
            if isinstance(key.data, _Viewer):
                self._discard(key.data)
            else:
                self._accept(key.data)
        for viewers in self._viewers:
            for viewer in [candidate for candidate in viewers if candidate.waiting]:
                self._send(viewer)

    def close(self) -> None:
        """Send what can be sent, and give the ports back. A second call does nothing."""
        if self._listeners:
            self.serve()
        for listener in self._listeners:
            listener.close()
        self._listeners = []
        for viewers in self._viewers:
            for viewer in viewers:
                viewer.connection.close()
            viewers.clear()
        self._selector.close()

    def _accept(self, place: int) -> None:
        with contextlib.suppress(OSError):  # it has gone again, or no more files can be opened
            connection, peer = self._listeners[place].accept()
            if len(self._viewers[place]) >= MAX_VIEWERS:
                self._displace(self._viewers[place])
            elif sum(map(len, self._viewers)) >= self._most:
                self._displace([viewer for viewers in self._viewers for viewer in viewers])
            connection.settimeout(0.0)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            viewer = _Viewer(place, connection, str(peer[0]))
            self._viewers[place].append(viewer)
            self._selector.register(connection, selectors.EVENT_READ, viewer)
            self.counts.viewers += 1

    def _displace(self, viewers: Sequence[_Viewer]) -> None:
        """Disconnect the one of `viewers` that has been idle the longest."""
        by_connection = {viewer.connection: viewer for viewer in viewers}
        idlest = find_idlest({connection: viewer.peer for connection, viewer in by_connection.items()})
        if idlest is not None:
            self.counts.displaced += 1
            self._disconnect(by_connection[idlest])

    def _discard(self, viewer: _Viewer) -> None:
        """Discard at most one chunk at a time, so that a viewer that sends without end blocks no other."""
        try:
            data = viewer.connection.recv(_CHUNK)
        except BlockingIOError:
            return
        except OSError:
            self._disconnect(viewer)
            return
        self.counts.bytes_ignored += len(data)
        if not data:  # it sends no more, and may still read: sending shows it
            self._selector.unregister(viewer.connection)

    def _send(self, viewer: _Viewer) -> None:
        try:
            sent = viewer.connection.send(viewer.waiting)
        except BlockingIOError:
            return
        except OSError:
            self._disconnect(viewer)
            return
        del viewer.waiting[:sent]

    def _disconnect(self, viewer: _Viewer) -> None:
        self._viewers[viewer.place].remove(viewer)
        with contextlib.suppress(KeyError):
            self._selector.unregister(viewer.connection)
        viewer.connection.close()


def _listening(host: str, port: int) -> socket.socket:
    listener = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_STREAM)
    try:
        # without it a port is unavailable for a minute after viewers used it; it does not allow two listeners
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, WAITING_BYTES)  # those that are accepted inherit it
        listener.bind((host, port))
        listener.listen(MAX_VIEWERS)
        listener.settimeout(0.0)
    except BaseException:
        listener.close()
        raise
    return listener


def _why(host: str, port: int, error: Exception) -> Problem:
    hint = "--viewer-port moves all of them"
    if isinstance(error, OverflowError):
        return Problem("port", str(port), f"at most {HIGHEST_PORT}, for the last aircraft too", hint)
    assert isinstance(error, OSError)
    if error.errno == errno.EADDRINUSE:
        return Problem("port", f"{port} is taken", "one that is free", hint)
    if error.errno == errno.EADDRNOTAVAIL:
        return Problem("address", host, "an address of this machine", "--viewer-host selects it")
    return Problem("port", f"{port}: {error.strerror or error}", "one that can be listened at", hint)
