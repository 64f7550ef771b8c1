"""State of a channel: whether and when a frame comes out of it.

The order of effects is that of a network interface: bounded queue, serialisation at the rate, then propagation with
jitter. Chance is addressed by the caller. What state there is, the queue and the last arrival, is queueing, which is
modelled interference between frames.
"""

from __future__ import annotations

import math

from skyrange.contracts.frames.frame import Fate
from skyrange.contracts.links import Channel, OpenChannel, Uniforms, VariableChannel
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time

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
        losses = 64 if loss >= 1.0 or uniform <= 0.0 else min(64, int(math.log(uniform) / math.log(loss)))
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
