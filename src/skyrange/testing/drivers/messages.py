"""Input of a component under check: letters, the arrivals that they become, and a recorder of real ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from skyrange.contracts.alerts import Alert
from skyrange.contracts.components import World
from skyrange.contracts.frames import Fate, Frame, FrameBlock
from skyrange.contracts.links import LinkSpec
from skyrange.contracts.mailboxes import Arrival, Note
from skyrange.contracts.verdicts import Label
from skyrange.core.ids import FrameId, Port
from skyrange.core.time import NEVER, Time

PEER = "peer"
"""Who claims to have sent every letter."""


class InputMessage(NamedTuple):
    """One payload that arrives `at` (ns of simulated time) at a port of the component."""

    at: Time
    port: Port
    payload: bytes


def make_arrivals(messages: Sequence[InputMessage]) -> list[Arrival]:
    """The arrivals, in the order in which a kernel hands them over, each with a reference of its own."""
    ordered = sorted(enumerate(messages), key=lambda pair: (pair[1].at, pair[1].port.link, pair[0]))
    return [
        Arrival(message.port, message.at, message.payload, PEER, FrameId(message.port.link, "fwd", PEER, number))
        for number, message in ordered
    ]


class MessageRecorder:
    """An observer that collects the letters which a component gets in a run.

    Put it among a kernel's observers and give its `messages` to a check: the component is then checked
    in the conversation that it really has. `ports` are the component's, `links` those of the wiring.
    """

    truth_period_ns: Time = NEVER

    def __init__(self, ports: Sequence[Port], links: Sequence[LinkSpec]) -> None:
        ends = {(spec.name, "fwd"): spec.b for spec in links} | {(spec.name, "rev"): spec.a for spec in links}
        self._ports = {flow: Port(end, flow[0]) for flow, end in ends.items() if Port(end, flow[0]) in ports}
        self.messages: list[InputMessage] = []

    def on_frame(self, frame: Frame) -> None:
        """Keep what was delivered to one of the ports."""
        port = self._ports.get((frame.link, frame.direction))
        if port is not None and frame.fate is Fate.DELIVERED:
            self.messages.append(InputMessage(frame.arrived_ns, port, frame.payload))

    def on_block(self, block: FrameBlock) -> None:
        """The same for many."""
        for frame in block.frames():
            self.on_frame(frame)

    def on_note(self, now: Time, source: str, note: Note) -> None:
        """Not mail."""

    def on_label(self, label: Label) -> None:
        """Not mail."""

    def on_alert(self, now: Time, detector: str, alert: Alert) -> None:
        """Not mail."""

    def on_truth(self, now: Time, world: World) -> None:
        """Not mail."""
