"""How is a link declared? Its two ends, its channel, the taps on it, and the routes across endpoints."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal

from skyrange.agent.contracts import Agent, SensorFault, Tap, Trigger
from skyrange.core.time import NEVER, NS_PER_MS, NS_PER_US, Time

MIN_LATENCY_NS = NS_PER_US
"""Nothing arrives at the time it was sent (DESIGN: links)."""


@dataclass(frozen=True, slots=True)
class Channel:
    """A fixed channel, the same both ways and independent of position.

    A `datagram` channel loses, duplicates and reorders; a `reliable` one is in order, and a loss
    becomes a retransmission delay. Probabilities are per frame, in 0…1.
    """

    mode: Literal["reliable", "datagram"] = "datagram"
    latency_ns: Time = NS_PER_MS
    """Propagation and stack, at least 1 µs."""
    jitter_ns: Time = 0
    """Extra delay, uniform in [0, jitter_ns); frames keep their order unless `reorder` picks one."""
    loss: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    """Chance that a frame is held back by `reorder_ns` and overtaken."""
    reorder_ns: Time = 20 * NS_PER_MS
    rate_bps: float = 0.0
    """Serialisation rate in bit/s; 0 is infinite."""
    queue_bytes: int = 65_536
    """Bound of the queue before the rate limiter; a frame that does not fit overflows."""

    @property
    def random(self) -> bool:
        """Whether a frame's journey depends on chance at all."""
        return bool(self.jitter_ns or self.loss or self.duplicate or self.reorder)


@dataclass(frozen=True, slots=True)
class LinkSpec:
    """One link instance. `fwd` runs from `a` to `b`."""

    name: str
    a: str
    b: str
    channel: Channel = field(default_factory=Channel)

    def __post_init__(self) -> None:
        if self.channel.latency_ns < MIN_LATENCY_NS:
            raise ValueError(
                f"link {self.name}: latency_ns is {self.channel.latency_ns}, at least {MIN_LATENCY_NS} is needed"
            )


@dataclass(frozen=True, slots=True)
class Route:
    """Pure forwarding: what arrives at `endpoint` from link `source` leaves on link `target`, unaltered.

    The kernel forwards at the endpoint's next service time (`service_ns`) and may fuse hops; each is
    still recorded. `select`, a module-level function of the payload, forwards a part only.
    """

    endpoint: str
    source: str
    target: str
    service_ns: Time = 0
    select: Callable[[bytes], bool] | None = None


@dataclass(frozen=True, slots=True)
class TapPlacement:
    """Taps on the `side` end (an endpoint's role such as "gcs" or "companion") of every link that matches.

    `match` is a link name or a pattern with `*`; `make` is called with each link's name. Later
    placements on the same side stand nearer to the channel. A tap with an `attack` is hostile:
    labelled, and silenced while that attack is muted or stopped.
    """

    match: str
    side: str
    make: Callable[[str], Tap]
    attack: str | None = None


@dataclass(slots=True)
class Schedule:
    """From when until when an attack acts, as the attack's own agents, taps and faults may read it during the run.

    Only the kernel writes here: `start_ns` is `NEVER` until a trigger has fired. Whether the attack is muted it does
    not say.
    """

    start_ns: Time = NEVER
    stop_ns: Time = NEVER


@dataclass(frozen=True, slots=True)
class AttackPlan:
    """When an attack's hostile output counts, and the agents and sensor faults it owns.

    It acts from `start_ns` until `stop_ns`, and no longer than `lasts_ns`. With a `trigger` it starts at the first
    world tick from `start_ns` on at which that holds, and once only. Muted, its agents, taps and faults are all there
    and run, but every verdict becomes Pass, everything they send is discarded, and faults work on copies: that is the
    nominal twin.
    """

    id: str
    start_ns: Time = 0
    stop_ns: Time = NEVER
    muted: bool = False
    agents: Sequence[Agent] = ()
    faults: Sequence[SensorFault] = ()
    trigger: Trigger | None = None
    lasts_ns: Time = NEVER
    schedule: Schedule | None = None
    """Where the kernel tells the attack's own parts when it acts; `None` where none of them asks."""
