"""One direction of a link: its taps in order, its channel, and what is at its receiving end.

The order of effects in a channel is that of a network interface: bounded queue, serialisation at the rate, then
propagation with jitter. Chance is addressed by the caller. What state there is, the queue and the last arrival, is
queueing, which is modelled interference between frames.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from skyrange.contracts.components import Tap
from skyrange.contracts.frames import Fate, Frame, FrameBlock
from skyrange.contracts.links import Channel, LinkSpec, OpenChannel, OwnRadio, Route, Uniforms, VariableChannel
from skyrange.contracts.mailboxes import Arrival, Inbox
from skyrange.core import elementary
from skyrange.core.chance import Chance
from skyrange.core.ids import FrameId, Port, hash64
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.kernel.acts.act_states import ActState, takes_effect
from skyrange.kernel.processing_queue import ProcessingQueue

if TYPE_CHECKING:
    from skyrange.kernel.observers import ObserverList

RETRANSMIT_MIN_NS = 200 * NS_PER_MS
"""Least retransmission time-out of a reliable link: Linux's TCP_RTO_MIN (RFC 6298 §2.4 would have 1 s)."""
RETRANSMIT_MAX_NS = 60 * NS_PER_S
"""Bound of the doubling (RFC 6298 §2.5 asks for at least 60 s)."""

NOT_RANDOM: Uniforms = (1.0, 0.0, 1.0, 1.0)
"""Uniforms where a channel is not random: never lost, no jitter, never duplicated, never reordered."""


class ChannelState:
    """One direction of one link's fixed channel, with its queue."""

    __slots__ = ("_busy_until", "_last_arrival", "_latency_ns", "spec", "steady")

    predictable = True
    """Whether what it will do with a frame at a later time is known already."""

    def __init__(self, spec: Channel) -> None:
        self.spec = spec
        self.steady = not spec.random and spec.rate_bps <= 0.0
        """Whether a frame's delay depends on neither chance nor its size, as on most links."""
        self._latency_ns = spec.latency_ns
        self._busy_until: Time = -(2**62)
        self._last_arrival: Time = -(2**62)

    @property
    def in_order(self) -> bool:
        """Whether no frame is duplicated or overtakes another one."""
        return self.spec.mode == "reliable" or not (self.spec.reorder or self.spec.duplicate)

    @property
    def latency_ns(self) -> Time:
        """Least delay of a frame."""
        return self._latency_ns

    def carry(self, now: Time, size: int, draws: Uniforms) -> tuple[Fate, Time, Time | None]:
        """Send `size` bytes at `now`: (fate, arrival, arrival of a duplicate or None).

        `draws` has the uniforms in [0, 1) for loss, jitter, duplication and reordering. The arrival is meaningful only
        when the fate is DELIVERED.
        """
        if self.steady:
            return Fate.DELIVERED, now + self._latency_ns, None
        spec = self.spec
        ready = now
        if spec.rate_bps > 0.0:
            waiting_ns = max(0, self._busy_until - now)
            if waiting_ns * spec.rate_bps / (8 * NS_PER_S) + size > spec.queue_bytes:
                return Fate.OVERFLOW, now, None
            ready = now + waiting_ns + math.ceil(size * 8 * NS_PER_S / spec.rate_bps)
            self._busy_until = ready
        arrival = ready + spec.latency_ns
        if not spec.random:
            arrival = max(arrival, self._last_arrival)
            self._last_arrival = arrival
            return Fate.DELIVERED, arrival, None
        arrival += int(draws[1] * spec.jitter_ns)
        if spec.mode == "reliable":
            arrival = max(arrival + self._retransmission_ns(draws[0]), self._last_arrival)
            self._last_arrival = arrival
            return Fate.DELIVERED, arrival, None
        if draws[0] < spec.loss:
            return Fate.LOST, now, None
        if draws[3] < spec.reorder:
            arrival = max(arrival, self._last_arrival) + spec.reorder_ns
        else:
            arrival = max(arrival, self._last_arrival)
            self._last_arrival = arrival
        # the copy takes its own path and comes a propagation delay later, as a late link-layer repeat does
        twin = arrival + spec.latency_ns if draws[2] < spec.duplicate else None
        return Fate.DELIVERED, arrival, twin

    def _retransmission_ns(self, uniform: float) -> Time:
        """Delay by repeated losses: the time-out doubles at each (RFC 6298 §5.5); no fast retransmit is modelled."""
        loss = self.spec.loss
        if uniform >= loss:
            return 0
        # `uniform` < loss**n exactly when n attempts in a row were lost: one draw serves all of them
        losses = 64 if loss >= 1.0 or uniform <= 0.0 else min(64, int(elementary.log(uniform) / elementary.log(loss)))
        timeout = max(RETRANSMIT_MIN_NS, 2 * self.spec.latency_ns)
        total = 0
        for _ in range(losses):
            total += timeout
            timeout = min(2 * timeout, RETRANSMIT_MAX_NS)
        return total


class VariableChannelState:
    """One direction of one link's variable channel."""

    __slots__ = ("_open", "latency_ns")

    steady = False
    in_order = True
    predictable = False

    def __init__(self, spec: VariableChannel, direction: str) -> None:
        self._open: OpenChannel = spec.open(direction)
        self.latency_ns = spec.latency_ns

    def carry(self, now: Time, size: int, draws: Uniforms) -> tuple[Fate, Time, Time | None]:
        """As `ChannelState.carry`."""
        return self._open.carry(now, size, draws)


def open_channel(spec: Channel | VariableChannel, direction: str) -> ChannelState | VariableChannelState:
    """The state of one direction of a channel."""
    return ChannelState(spec) if isinstance(spec, Channel) else VariableChannelState(spec, direction)


class TapSlot:
    """A placed tap: the tap, its endpoint name, the attack that it belongs to, and the time that it takes."""

    __slots__ = ("attack", "cost_ns", "due", "inspects", "links", "name", "observers", "order", "radio", "tap", "ways")

    def __init__(
        self,
        tap: Tap,
        name: str,
        attack: ActState | None,
        cost_ns: Time = 0,
        inspects: Callable[[Frame], bool] | None = None,
        radio: OwnRadio | None = None,
    ) -> None:
        self.tap = tap
        self.cost_ns = cost_ns
        """Processor time that it takes for a frame that it inspects."""
        self.inspects = inspects
        """Which frames it inspects; `None` for all."""
        self.name = name
        self.order = name
        """Its place among events of one time: its name, behind the number of its run in a batch."""
        self.observers: ObserverList
        """The `ObserverList` of its run."""
        self.attack = attack
        self.due: Time | None = None
        self.links: dict[str, tuple[DirectedLink, int, bool]] = {}
        """By direction: the directed link, the position *after* this tap, and whether that is on the sending side."""
        self.radio = radio
        """That of a tap at no end of its link."""
        self.ways: dict[str, OpenChannel] = {}
        """By direction: how what such a tap injects goes to the receiver."""

    def find_cost_ns(self, now: Time, frame: Frame) -> Time:
        """Processor time that it takes for a frame now; 0 while it has no effect."""
        if not self.cost_ns or not takes_effect(self.attack, now):
            return 0
        return self.cost_ns if self.inspects is None or self.inspects(frame) else 0


class FrameMonitor(Protocol):
    """A subscriber that a directed link shows its frames to at one of its ends."""

    def take_frame(self, at: Time, link: DirectedLink, frame: Frame, *, received: bool) -> None:
        """Keep a frame that is sent from that end at `at`, or arrives there then; `at` may be in the future."""
        ...


class DirectedLink:
    """One direction of one link instance."""

    __slots__ = (
        "_addresses",
        "_chance",
        "_drawn",
        "_serials",
        "arrival_monitors",
        "channel",
        "defended_from",
        "defended_to",
        "direction",
        "dst",
        "fused",
        "link_name",
        "listeners",
        "local",
        "mailbox",
        "name",
        "number",
        "observers",
        "order",
        "own_number",
        "place",
        "port",
        "prefix",
        "processing",
        "receiver_taps",
        "routes",
        "run",
        "send_monitors",
        "sender_taps",
        "sending",
        "sent_counts",
        "src",
        "staged",
    )

    def __init__(self, spec: LinkSpec, direction: str, chance: Chance) -> None:
        self.link_name = spec.name
        self.direction = direction
        self.name = f"{spec.name}:{direction}"
        self.prefix = ""
        """What stands before its name in `order`: the number of its run in a batch."""
        self.order = self.name
        """Its place among events of one time."""
        self.observers: ObserverList
        """The `ObserverList` of its run."""
        self.src, self.dst = (spec.a, spec.b) if direction == "fwd" else (spec.b, spec.a)
        self.port = Port(self.dst, self.link_name)
        """The receiving end."""
        self.channel = open_channel(spec.channel, direction)
        self.sender_taps: list[TapSlot] = []
        self.receiver_taps: list[TapSlot] = []
        self.listeners: list[TapSlot] = []
        """Taps with a radio that may hear its frames."""
        self.routes: list[RouteHop] = []
        """Where the receiving endpoint's routes lead."""
        self.fused: list[RouteHop] | None = None
        """The same routes where they may be followed at sending time; `None` where they may not."""
        self.staged: list[RouteHop] | None = None
        """The same routes where they may be followed once the frames have arrived; `None` where they may not."""
        self.processing: ProcessingQueue | None = None
        """The queue of its destination, which all links to it share; `None` where frames are processed at once."""
        self.sending: ProcessingQueue | None = None
        """The queue of its source, where defences there take time for frames that leave."""
        self.defended_from = 0
        """Position of the first receiver-side tap that belongs to a defence: they follow all others."""
        self.defended_to = 0
        """Position after the last sender-side tap that belongs to a defence: they precede all others."""
        self.mailbox: Mailbox | None = None
        """Of the agent or engine that owns the receiving end, if there is one."""
        self.send_monitors: Sequence[FrameMonitor] = ()
        """Monitors that listen at its sending end."""
        self.arrival_monitors: Sequence[FrameMonitor] = ()
        """Monitors that listen at its receiving end."""
        self.local = True
        """Whether the receiving end lives in this kernel."""
        self.number = 0
        """Its place among the kernel's directed links, in order of run and name."""
        self.own_number = 0
        """Its place among those of its run."""
        self.run = 0
        """The number of its run in a batch."""
        self.place = -1
        """The place of its receiving port among the owner's, -1 without an owner."""
        self.sent_counts = np.zeros(1, dtype=np.int64)
        """How many frames each directed link's own source has sent, by number: one array for all links of a kernel."""
        self._chance = chance
        self._serials: dict[str, int] = {}
        self._addresses: dict[str, int] = {}
        self._drawn: dict[str, tuple[Time, int]] = {}

    def make_frame(
        self,
        sender: str,
        now: Time,
        payload: bytes,
        src: str,
        dst: str,
        *,
        parent: FrameId | None = None,
        causes: tuple[FrameId, ...] = (),
    ) -> Frame:
        """A new frame of `sender` on this link, with that sender's next serial."""
        if sender == self.src:
            serial = self.sent_counts.item(self.number)
            self.sent_counts[self.number] = serial + 1
        else:
            serial = self._serials.get(sender, 0)
            self._serials[sender] = serial + 1
        return Frame(
            self.link_name,
            self.direction,
            sender,
            serial,
            src,
            dst,
            sent_ns=now,
            payload=payload,
            parent=parent,
            causes=causes,
        )

    def carry(self, sender: str, now: Time, size: int) -> tuple[Fate, Time, Time | None]:
        """Send `size` bytes of `sender` through the channel; as `ChannelState.carry`."""
        channel = self.channel
        if channel.steady:
            return channel.carry(now, size, NOT_RANDOM)
        return channel.carry(now, size, self.draws(sender, now))

    def draws(self, sender: str, now: Time) -> Uniforms:
        """The uniforms of `sender`'s k-th frame on this link at `now`; k counts that sender's frames only."""
        last, k = self._drawn.get(sender, (None, 0))
        k = k + 1 if last == now else 0
        self._drawn[sender] = (now, k)
        address = self._addresses.get(sender)
        if address is None:
            address = self._addresses[sender] = hash64(f"{self.name}|{sender}")
        return self._chance.uniform4("link", address, now, k)


class RouteHop(NamedTuple):
    """A route, and the directed link on which it sends."""

    route: Route
    link: DirectedLink

    @property
    def order(self) -> str:
        """Its place among events of one time, unique in a kernel."""
        return f"{self.link.prefix}{self.route.endpoint}|{self.route.source}|{self.route.target}"

    def forward(self, at: Time, frame: Frame) -> Frame:
        """The frame that its endpoint sends at `at` to forward another."""
        endpoint, link = self.route.endpoint, self.link
        return link.make_frame(endpoint, at, frame.payload, endpoint, link.dst, parent=frame.id)


@dataclass(slots=True)
class Mailbox:
    """Frames that have arrived for an agent or an engine and wait for its service time."""

    name: str
    order: str
    """Its place among events of one time: its name, behind the number of its run in a batch."""
    service_ns: Time
    polled: bool
    """Whether it belongs to an engine, whose ticks collect the mail; an agent's mail wakes the agent."""
    run: int | None = None
    """The run in a batch whose agent it belongs to; `None` for an engine, or in a run alone."""
    due: Time | None = None
    singles: list[Arrival] = field(default_factory=list)
    blocks: list[FrameBlock] = field(default_factory=list)

    @property
    def full(self) -> bool:
        """Whether anything is in it."""
        return bool(self.singles or self.blocks)

    def collect(self) -> Inbox:
        """Empty the mailbox."""
        singles, self.singles = self.singles, []
        blocks, self.blocks = self.blocks, []
        return Inbox(singles, blocks)


@dataclass(slots=True)
class RouteQueue:
    """Frames that wait at an endpoint to be sent on along one of its routes."""

    hop: RouteHop
    due: Time | None = None
    frames: list[Frame] = field(default_factory=list)


class Transit(NamedTuple):
    """A frame on its way from one kernel to another: it comes out of its channel at `arrival`."""

    arrival: Time
    directed_link: str
    """The directed link, `link:direction`."""
    frame: Frame
