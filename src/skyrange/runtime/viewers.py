"""Read-only MAVLink ports on which ground stations watch the aircraft of a run, and their relay to another network.

A ground station's heartbeat at any port of an ArduPilot resets its lost-link timer, and would hide that its own
station is jammed. So viewers receive what arrives at the proxy from the autopilot, and never reach the autopilot.

MAVLink passes the relay to viewers, and nothing passes back. A range whose network nobody else reaches is so watched
from outside: the relay is a viewer of each aircraft, and has ports of its own like those of the run, at which the same
rules hold.
"""

from __future__ import annotations

import errno
import os
import socket
import time
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Final, NamedTuple, Self

from skyrange.codec.mavlink.deframer import Deframer
from skyrange.contracts.alerts import Alert
from skyrange.contracts.components import World
from skyrange.contracts.frames import Fate, Frame, FrameBlock
from skyrange.contracts.mailboxes import Note
from skyrange.contracts.verdicts import Label
from skyrange.core.errors import ComponentError
from skyrange.core.ids import link_name
from skyrange.core.time import NEVER, Time
from skyrange.io.addresses import format_address
from skyrange.io.mavlink.transports import Address as SocketAddress
from skyrange.io.mavlink.viewer_ports import LOOPBACK, ViewerCounts, ViewerPorts

FIRST_PORT: Final = 5763
"""The port of ArduPilot's SITL for another ground station, which others try by default."""
PORT_STEP: Final = 10
"""Difference between the ports of two aircraft, as of two instances of SITL."""
_FROM_AUTOPILOT: Final = "rev"
"""The link `autopilot` runs from the proxy to the autopilot (`vehicle.onboard_network.onboard_links`)."""


class Address(NamedTuple):
    """The port on which one aircraft is watched."""

    vehicle: str
    host: str
    port: int


def _port_numbers(first: int, count: int) -> list[int]:
    """The ports of `count` aircraft: each next one is 10 higher; 0 for each, any free one, if `first` is 0."""
    step = PORT_STEP if first else 0
    return [first + step * place for place in range(count)]


class _OpenPorts:
    """Open viewers' ports: their counts, and a context manager whose end closes them."""

    def __init__(self, numbers: Sequence[int], host: str) -> None:
        self._ports = ViewerPorts(numbers, host)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def counts(self) -> ViewerCounts:
        """Events at the ports so far."""
        return self._ports.counts

    def close(self) -> None:
        """Close the ports. A second call does nothing."""
        self._ports.close()


class Viewers(_OpenPorts):
    """An `contracts.components.Observer` that serves each aircraft's MAVLink on a TCP port of its own.

    A viewer receives every frame that the link `autopilot` delivers from the autopilot, byte for byte, from the time at
    which it connects; nothing is repeated. What a viewer sends is counted and discarded. Use it as a context manager:
    the ports are closed at its end. Call `serve` often, as `study.session.fly` does.
    """

    truth_period_ns: Time = NEVER

    def __init__(
        self, vehicles: Sequence[str], first_port: int | Sequence[int] = FIRST_PORT, host: str = LOOPBACK
    ) -> None:
        """Listen for each of `vehicles`: the first at `first_port`, each next one at a port 10 higher.

        With `first_port` 0 any free ports are taken; a sequence has a port for each. `host` is the IP address to listen
        at; whoever reaches it can watch. Raises `InputError` if a port cannot be had.
        """
        super().__init__(_port_numbers(first_port, len(vehicles)) if isinstance(first_port, int) else first_port, host)
        self._places = {link_name("autopilot", vehicle): place for place, vehicle in enumerate(vehicles)}
        self.addresses = [
            Address(vehicle, host, port) for vehicle, port in zip(vehicles, self._ports.numbers, strict=True)
        ]

    def serve(self) -> None:
        """Accept viewers and send them the frames since the last call; never blocks."""
        self._ports.serve()

    def on_frame(self, frame: Frame) -> None:
        """Show a delivered frame if an autopilot sent it."""
        if frame.fate is Fate.DELIVERED:
            self.show(frame)

    def show(self, frame: Frame) -> None:
        """Show a frame if an autopilot sent it, whatever its fate."""
        if frame.direction == _FROM_AUTOPILOT:
            place = self._places.get(frame.link)
            if place is not None and self._ports.watched(place):
                self._ports.show(place, frame.payload)

    def on_block(self, block: FrameBlock) -> None:
        """Show the delivered frames that autopilots sent."""
        for frame in block.frames():
            self.on_frame(frame)

    def on_note(self, now: Time, source: str, note: Note) -> None:
        """Not shown: it is not MAVLink."""

    def on_label(self, label: Label) -> None:
        """Not shown: it is not MAVLink."""

    def on_alert(self, now: Time, detector: str, alert: Alert) -> None:
        """Nothing that MAVLink tells."""

    def on_truth(self, now: Time, world: World) -> None:
        """Not shown: it is not MAVLink."""


POLL_S: Final = 0.02
"""Interval at which all sockets are served."""
RETRY_S: Final = 0.2
"""Interval at which a run that does not listen yet is called again."""
_CHUNK: Final = 1 << 16


class _Source:
    """A viewer's connection to the port of one aircraft; it is made anew until the aircraft has said something."""

    def __init__(self, address: SocketAddress) -> None:
        self.address = address
        self.shown = False
        """Whether the aircraft has said something."""
        self.ended = False
        """Whether it had, and its port was closed."""
        self._socket: socket.socket | None = None
        self._retry_s = 0.0
        self._deframer = Deframer()

    def read(self) -> list[bytes]:
        """What has arrived, cut into whole frames; never blocks."""
        if self._socket is None:
            self._connect()
        if self._socket is None or self.ended:
            return []
        try:
            data = self._socket.recv(_CHUNK)
        except BlockingIOError:
            return []
        except OSError:  # not connected, or no longer
            data = b""
        if data:
            self.shown = True
            return [piece.data for piece in self._deframer.feed(data)]
        self.close()
        # a range tries its ports before it starts: a connection that ends in silence is no run that ended
        self.ended = self.shown
        return []

    def close(self) -> None:
        """Close the connection, if there is one."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _connect(self) -> None:
        now_s = time.monotonic()
        if self.ended or now_s < self._retry_s:
            return
        self._retry_s = now_s + RETRY_S
        made = socket.socket(socket.AF_INET6 if ":" in self.address[0] else socket.AF_INET, socket.SOCK_STREAM)
        made.settimeout(0.0)
        result = made.connect_ex(self.address)
        if result in (0, errno.EINPROGRESS):
            self._socket = made
            return
        made.close()
        if result in (errno.ENETUNREACH, errno.EADDRNOTAVAIL, errno.EINVAL):
            raise ComponentError("relay", f"no way to {format_address(self.address)}: {os.strerror(result).lower()}")


class ViewerRelay(_OpenPorts):
    """Viewers' ports that show what the viewers' ports of a run show. A context manager: its end closes all."""

    def __init__(self, source: SocketAddress, listen: SocketAddress, vehicles: int) -> None:
        """`source` and `listen` are the addresses of the first aircraft; each next one has a port 10 higher.

        With port 0 in `listen` any free ports are taken. Raises `InputError` if a port cannot be had.
        """
        super().__init__(_port_numbers(listen[1], vehicles), listen[0])
        self._sources = [_Source((source[0], source[1] + PORT_STEP * place)) for place in range(vehicles)]
        self.addresses = [(listen[0], port) for port in self._ports.numbers]
        """Where viewers connect, by aircraft."""

    @property
    def ended(self) -> bool:
        """Whether every aircraft that has said something has closed its port, and one has."""
        heard = [source for source in self._sources if source.shown]
        return bool(heard) and all(source.ended for source in heard)

    @property
    def shown(self) -> bool:
        """Whether an aircraft has said something."""
        return any(source.shown for source in self._sources)

    def poll(self) -> None:
        """Pass on what has arrived; never blocks."""
        for place, source in enumerate(self._sources):
            for frame in source.read():
                self._ports.show(place, frame)
        self._ports.serve()

    def serve(self, wait_s: float, on_word: Callable[[str], None]) -> None:
        """Relay until the run ends. Raises `ComponentError` if it has not begun within `wait_s` seconds."""
        where = format_address(self._sources[0].address)
        on_word(f"waiting for a run with viewers' ports at {where}; viewers: {format_address(self.addresses[0])}")
        until_s, warned = time.monotonic() + wait_s, False
        while not self.ended:
            self.poll()
            if self.shown and not warned:
                warned = True
                on_word(f"relaying {len(self._sources)} aircraft of {where}")
            if not warned and time.monotonic() > until_s:
                hint = "Start it there with --viewer-host, and see that no firewall is between."
                raise ComponentError("relay", f"no run shows its aircraft at {where} within {wait_s:g} s", hint)
            time.sleep(POLL_S)

    def close(self) -> None:
        """Close all ports and connections. A second call does nothing."""
        for source in self._sources:
            source.close()
        super().close()
