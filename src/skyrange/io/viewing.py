"""How do ground stations watch without being heard? TCP ports that send frames out and throw away what comes in.

Nothing here waits: sockets are served when `serve` is called. A viewer that does not read fast enough loses whole
frames, so its stream stays one of frames, and what waits for it stays bounded.
"""

from __future__ import annotations

import contextlib
import errno
import selectors
import socket
from collections.abc import Sequence
from dataclasses import dataclass, field

from skyrange.core.errors import Fault, InputError
from skyrange.io.programs import make_room

LOOPBACK = "127.0.0.1"
MOST_VIEWERS = 8
"""At one port at a time; who comes then is turned away."""
WAITING_BYTES = 1 << 16
"""What may wait for one viewer beside the system's own buffer, which is set to as much."""
_CHUNK = 1 << 16
HIGHEST_PORT = 65_535


@dataclass(slots=True)
class Counts:
    """What has happened at all ports so far."""

    viewers: int = 0
    """Who have come."""
    turned_away: int = 0
    """Who came where `MOST_VIEWERS` were."""
    frames_lost: int = 0
    """What was not sent to a viewer because it read too slowly, or took too large a run of garbage."""
    bytes_ignored: int = 0
    """What viewers have sent."""


@dataclass(slots=True)
class _Viewer:
    place: int
    line: socket.socket
    waiting: bytearray = field(default_factory=bytearray)


class ViewerPorts:
    """One listening port per place 0, 1, 2 …, on the loopback alone."""

    def __init__(self, ports: Sequence[int]) -> None:
        """Listen at `ports`, 0 standing for any that is free. `InputError` where one cannot be had; then none is."""
        make_room(2 * len(ports), "viewers")  # each listens, and one comes
        self.counts = Counts()
        self._selector = selectors.DefaultSelector()
        self._listeners: list[socket.socket] = []
        self._viewers: list[list[_Viewer]] = [[] for _ in ports]
        for place, port in enumerate(ports):
            try:
                listener = _listening(port)
            except (OSError, OverflowError) as error:
                self.close()
                raise InputError("viewers", [_why(port, error)]) from error
            self._listeners.append(listener)
            self._selector.register(listener, selectors.EVENT_READ, place)
        self.numbers = [int(listener.getsockname()[1]) for listener in self._listeners]
        """The ports, place by place."""

    def watched(self, place: int) -> bool:
        """Whether anybody is there to see."""
        return bool(self._viewers[place])

    def show(self, place: int, frame: bytes) -> None:
        """Put a frame where all viewers of a place get it at the next `serve`."""
        for viewer in self._viewers[place]:
            if len(viewer.waiting) + len(frame) > WAITING_BYTES:
                self.counts.frames_lost += 1
            else:
                viewer.waiting += frame

    def serve(self) -> None:
        """Let viewers in, throw away what they have sent, send what waits for them; returns at once."""
        for key, _ in self._selector.select(0):
            if isinstance(key.data, _Viewer):
                self._ignore(key.data)
            else:
                self._let_in(key.data)
        for viewers in self._viewers:
            for viewer in [one for one in viewers if one.waiting]:
                self._send(viewer)

    def close(self) -> None:
        """Send what can be sent, and give the ports back. Again does nothing."""
        if self._listeners:
            self.serve()
        for listener in self._listeners:
            listener.close()
        self._listeners = []
        for viewers in self._viewers:
            for viewer in viewers:
                viewer.line.close()
            viewers.clear()
        self._selector.close()

    def _let_in(self, place: int) -> None:
        with contextlib.suppress(OSError):  # it has gone again, or there is no room for one more open file
            line, _ = self._listeners[place].accept()
            if len(self._viewers[place]) >= MOST_VIEWERS:
                self.counts.turned_away += 1
                line.close()
                return
            line.setblocking(False)
            line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            viewer = _Viewer(place, line)
            self._viewers[place].append(viewer)
            self._selector.register(line, selectors.EVENT_READ, viewer)
            self.counts.viewers += 1

    def _ignore(self, viewer: _Viewer) -> None:
        """At most one chunk at a time, so that who sends without end stops nobody."""
        try:
            heard = viewer.line.recv(_CHUNK)
        except BlockingIOError:
            return
        except OSError:
            self._see_off(viewer)
            return
        self.counts.bytes_ignored += len(heard)
        if not heard:  # it says no more, and may listen still: sending tells
            self._selector.unregister(viewer.line)

    def _send(self, viewer: _Viewer) -> None:
        try:
            sent = viewer.line.send(viewer.waiting)
        except BlockingIOError:
            return
        except OSError:
            self._see_off(viewer)
            return
        del viewer.waiting[:sent]

    def _see_off(self, viewer: _Viewer) -> None:
        self._viewers[viewer.place].remove(viewer)
        with contextlib.suppress(KeyError):
            self._selector.unregister(viewer.line)
        viewer.line.close()


def _listening(port: int) -> socket.socket:
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        # without it a port cannot be had for a minute after viewers were at it; two listeners it does not allow
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, WAITING_BYTES)  # those that are accepted inherit it
        listener.bind((LOOPBACK, port))
        listener.listen(MOST_VIEWERS)
        listener.setblocking(False)
    except BaseException:
        listener.close()
        raise
    return listener


def _why(port: int, error: Exception) -> Fault:
    hint = "--viewer-port moves all of them"
    if isinstance(error, OverflowError):
        return Fault("port", str(port), f"at most {HIGHEST_PORT}, for the last aircraft too", hint)
    assert isinstance(error, OSError)
    if error.errno == errno.EADDRINUSE:
        return Fault("port", f"{port} is taken", "one that is free", hint)
    return Fault("port", f"{port}: {error.strerror or error}", "one that can be listened at", hint)
