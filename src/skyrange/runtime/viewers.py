"""Read-only MAVLink ports on which ground stations watch the aircraft of a run.

A ground station's heartbeat at any port of an ArduPilot resets its lost-link timer, and would hide that its own
station is jammed. So viewers receive what arrives at the proxy from the autopilot, and never reach the autopilot.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import TracebackType
from typing import Final, NamedTuple, Self

from skyrange.contracts.alerts import Alert
from skyrange.contracts.components import World
from skyrange.contracts.frames.blocks import FrameBlock
from skyrange.contracts.frames.frame import Fate, Frame
from skyrange.contracts.mailboxes import Note
from skyrange.contracts.verdicts import Label
from skyrange.core.ids import link_name
from skyrange.core.time import NEVER, Time
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


class Viewers:
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
        if isinstance(first_port, int):
            step = PORT_STEP if first_port else 0
            first_port = [first_port + step * place for place in range(len(vehicles))]
        self._ports = ViewerPorts(first_port, host)
        self._places = {link_name("autopilot", vehicle): place for place, vehicle in enumerate(vehicles)}
        self.addresses = [
            Address(vehicle, host, port) for vehicle, port in zip(vehicles, self._ports.numbers, strict=True)
        ]

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

    def serve(self) -> None:
        """Accept viewers and send them the frames since the last call; never blocks."""
        self._ports.serve()

    def close(self) -> None:
        """Close the ports. A second call does nothing."""
        self._ports.close()

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
