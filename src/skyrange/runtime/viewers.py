"""How does a ground station watch a run, and change nothing? What autopilots say, served read-only, port by port.

A ground station's heartbeat at any port of an ArduPilot resets its lost-link timer, and would hide that its own
station is jammed. So viewers are shown what arrives at the proxy from the autopilot, and never reach it.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import TracebackType
from typing import Final, NamedTuple, Self

from skyrange.agent.blocks import FrameBlock
from skyrange.agent.contracts import World
from skyrange.agent.frames import Fate, Frame
from skyrange.agent.messages import Note
from skyrange.agent.monitors import Alert
from skyrange.agent.verdicts import Label
from skyrange.core.ids import link_name
from skyrange.core.time import NEVER, Time
from skyrange.io.viewing import LOOPBACK, Counts, ViewerPorts

FIRST_PORT: Final = 5763
"""Where SITL of ArduPilot has the port for another ground station, and others look for it."""
PORT_STEP: Final = 10
"""Between two aircraft, as between two instances of SITL."""
_FROM_AUTOPILOT: Final = "rev"
"""The link `autopilot` runs from the proxy to the autopilot (`vehicle.onboard.links`)."""


class Address(NamedTuple):
    """Where one aircraft is watched."""

    vehicle: str
    host: str
    port: int


class Viewers:
    """An `agent.contracts.Observer` that shows each aircraft's MAVLink at a TCP port of its own.

    Everything delivered by the link `autopilot` from the autopilot on is shown, bytes as they are, from when a viewer
    connects; nothing is shown again. What a viewer sends is counted and thrown away. A context manager: the ports
    are given back at its end. Call `serve` often, as `study.session.fly` does.
    """

    truth_period_ns: Time = NEVER

    def __init__(self, vehicles: Sequence[str], first_port: int | Sequence[int] = FIRST_PORT) -> None:
        """Listen for each of `vehicles`, ids in the order of their ports: `first_port` and 10 more for every next one.

        0 takes any ports that are free; several are those of each. `InputError` where a port cannot be had.
        """
        if isinstance(first_port, int):
            step = PORT_STEP if first_port else 0
            first_port = [first_port + step * place for place in range(len(vehicles))]
        self._ports = ViewerPorts(first_port)
        self._places = {link_name("autopilot", vehicle): place for place, vehicle in enumerate(vehicles)}
        self.addresses = [
            Address(vehicle, LOOPBACK, port) for vehicle, port in zip(vehicles, self._ports.numbers, strict=True)
        ]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def counts(self) -> Counts:
        """What has happened at the ports so far."""
        return self._ports.counts

    def serve(self) -> None:
        """Let viewers in and send them what was shown since; waits for nobody."""
        self._ports.serve()

    def close(self) -> None:
        """Give the ports back. Again does nothing."""
        self._ports.close()

    def on_frame(self, frame: Frame) -> None:
        """Show it where it came from an autopilot."""
        if frame.fate is Fate.DELIVERED:
            self.show(frame)

    def show(self, frame: Frame) -> None:
        """The same whatever became of it."""
        if frame.direction == _FROM_AUTOPILOT:
            place = self._places.get(frame.link)
            if place is not None and self._ports.watched(place):
                self._ports.show(place, frame.payload)

    def on_block(self, block: FrameBlock) -> None:
        """Show those that came from autopilots."""
        for frame in block.frames():
            self.on_frame(frame)

    def on_note(self, now: Time, source: str, note: Note) -> None:
        """Nothing that MAVLink tells."""

    def on_label(self, label: Label) -> None:
        """Nothing that MAVLink tells."""

    def on_alert(self, now: Time, detector: str, alert: Alert) -> None:
        """Nothing that MAVLink tells."""

    def on_truth(self, now: Time, world: World) -> None:
        """Nothing that MAVLink tells."""
