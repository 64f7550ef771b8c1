"""What is one direction of a link made of? Its taps in order, its channel, and where it leads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np

from skyrange.agent.blocks import FrameBlock
from skyrange.agent.contracts import Tap
from skyrange.agent.frames import Fate, Frame
from skyrange.agent.links import LinkSpec, Route
from skyrange.agent.messages import Arrival, Inbox
from skyrange.core.chance import Chance
from skyrange.core.ids import FrameId, Port, hash64
from skyrange.core.time import Time
from skyrange.kernel.channel import NO_CHANCE, ChannelState, Uniforms
from skyrange.kernel.stages import Stage


class TapSlot:
    """A placed tap: the tap, its endpoint name, and the attack that answers for it."""

    __slots__ = ("attack", "due", "lanes", "name", "tap")

    def __init__(self, tap: Tap, name: str, attack: Stage | None) -> None:
        self.tap = tap
        self.name = name
        self.attack = attack
        self.due: Time | None = None
        self.lanes: dict[str, tuple[Lane, int, bool]] = {}
        """Per direction: the lane, the stage *after* this tap, and whether that is on the sending side."""


class FrameMonitor(Protocol):
    """What a link shows frames to at one of its ends."""

    def take_frame(self, at: Time, lane: int, frame: Frame, received: bool) -> None:
        """Keep a frame that is sent from that end at `at`, or arrives there then; `at` may be still to come."""
        ...


class Lane:
    """One direction of one link instance."""

    __slots__ = (
        "_addresses",
        "_chance",
        "_drawn",
        "_serials",
        "arrival_monitors",
        "channel",
        "counters",
        "direction",
        "dst",
        "forwards",
        "fused",
        "in_taps",
        "link",
        "local",
        "name",
        "number",
        "out_taps",
        "port",
        "receiver",
        "send_monitors",
        "src",
        "staged",
    )

    def __init__(self, spec: LinkSpec, direction: str, chance: Chance) -> None:
        self.link = spec.name
        self.direction = direction
        self.name = f"{spec.name}:{direction}"
        self.src, self.dst = (spec.a, spec.b) if direction == "fwd" else (spec.b, spec.a)
        self.port = Port(self.dst, self.link)
        """The receiver's end."""
        self.channel = ChannelState(spec.channel)
        self.out_taps: list[TapSlot] = []
        self.in_taps: list[TapSlot] = []
        self.forwards: list[Forward] = []
        """Where the receiving endpoint's routes lead."""
        self.fused: list[Forward] | None = None
        """The same routes where they may be followed at sending time; `None` where they may not."""
        self.staged: list[Forward] | None = None
        """The same routes where they may be followed when what they forward has arrived; `None` where they may not."""
        self.receiver: Mailbox | None = None
        self.send_monitors: Sequence[FrameMonitor] = ()
        """Monitors that listen at its sending end."""
        self.arrival_monitors: Sequence[FrameMonitor] = ()
        """Monitors that listen at its receiving end."""
        self.local = True
        self.number = 0
        """Its place among the kernel's lanes, in order of their names."""
        self.counters = np.zeros(1, dtype=np.int64)
        """How many frames each lane's own source has sent on it, by number: one array for all lanes of a kernel."""
        self._chance = chance
        self._serials: dict[str, int] = {}
        self._addresses: dict[str, int] = {}
        self._drawn: dict[str, tuple[Time, int]] = {}

    def frame(
        self,
        sender: str,
        now: Time,
        payload: bytes,
        src: str,
        dst: str,
        parent: FrameId | None = None,
        causes: tuple[FrameId, ...] = (),
    ) -> Frame:
        """A new frame of `sender` on this lane, with that sender's next serial."""
        if sender == self.src:
            serial = self.counters.item(self.number)
            self.counters[self.number] = serial + 1
        else:
            serial = self._serials.get(sender, 0)
            self._serials[sender] = serial + 1
        return Frame(self.link, self.direction, sender, serial, src, dst, now, payload, parent, causes)

    def carry(self, sender: str, now: Time, size: int) -> tuple[Fate, Time, Time | None]:
        """Send `size` bytes of `sender` through the channel; as `ChannelState.carry`."""
        channel = self.channel
        if channel.steady:
            return channel.carry(now, size, NO_CHANCE)
        return channel.carry(now, size, self.luck(sender, now))

    def luck(self, sender: str, now: Time) -> Uniforms:
        """The draws of `sender`'s k-th frame on this lane at `now`; k is counted among that sender's only."""
        last, k = self._drawn.get(sender, (None, 0))
        k = k + 1 if last == now else 0
        self._drawn[sender] = (now, k)
        address = self._addresses.get(sender)
        if address is None:
            address = self._addresses[sender] = hash64(f"{self.name}|{sender}")
        return self._chance.uniform4("link", address, now, k)


class Forward(NamedTuple):
    """A route as the kernel follows it."""

    route: Route
    lane: Lane

    @property
    def name(self) -> str:
        """What tells it from all others of a kernel."""
        return f"{self.route.endpoint}|{self.route.source}|{self.route.target}"


@dataclass(slots=True)
class Mailbox:
    """What has arrived for an agent or an engine and waits for its service time."""

    name: str
    service_ns: Time
    polled: bool
    """An engine's mail is collected by its ticks; an agent's mail wakes it."""
    due: Time | None = None
    pending: list[Arrival] = field(default_factory=list)
    blocks: list[FrameBlock] = field(default_factory=list)

    @property
    def full(self) -> bool:
        """Whether anything is in it."""
        return bool(self.pending or self.blocks)

    def collect(self) -> Inbox:
        """Empty the box."""
        mail, self.pending = self.pending, []
        blocks, self.blocks = self.blocks, []
        return Inbox(mail, blocks)


@dataclass(slots=True)
class Forwarder:
    """What waits at an endpoint to be sent on along one of its routes."""

    forward: Forward
    due: Time | None = None
    frames: list[Frame] = field(default_factory=list)


class Transit(NamedTuple):
    """A frame on its way from one kernel to another: it comes out of its channel at `arrival`."""

    arrival: Time
    lane: str
    frame: Frame
