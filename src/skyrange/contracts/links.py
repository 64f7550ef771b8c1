"""Declarations of links, channels, taps, routes and attacks, as a kernel is wired with them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Any, Final, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.components import Agent, BodyHook, SensorHook, Tap, Trigger
from skyrange.contracts.frames import Fate, Frame, Payloads
from skyrange.contracts.scan_light import ScanHook
from skyrange.core.time import NEVER, NS_PER_MS, NS_PER_US, Time

MIN_LATENCY_NS = NS_PER_US
"""Least latency of a channel: nothing arrives at the time at which it was sent."""


@dataclass(frozen=True, slots=True)
class Channel:
    """A fixed channel, the same in both directions and independent of position.

    A `datagram` channel loses, duplicates and reorders; a `reliable` one keeps frames in order, and a loss becomes a
    retransmission delay. Probabilities are per frame, in 0…1.
    """

    mode: Literal["reliable", "datagram"] = "datagram"
    latency_ns: Time = NS_PER_MS
    """Propagation and stack, at least 1 µs."""
    jitter_ns: Time = 0
    """Extra delay, uniform in [0, jitter_ns); frames keep their order unless `reorder` picks one."""
    loss: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    """Probability that a frame is held back by `reorder_ns`, so that later frames overtake it."""
    reorder_ns: Time = 20 * NS_PER_MS
    rate_bps: float = 0.0
    """Serialisation rate in bit/s; 0 is infinite."""
    queue_bytes: int = 65_536
    """Size of the queue before the rate limiter; a frame that does not fit is lost by overflow."""

    @property
    def random(self) -> bool:
        """Whether any of its effects on a frame is random."""
        return bool(self.jitter_ns or self.loss or self.duplicate or self.reorder)

    def describe(self) -> dict[str, Any]:
        """Its fields, as the manifest has them."""
        return {name: getattr(self, name) for name in self.__slots__}


Uniforms = tuple[float, float, float, float]
"""Four uniform random numbers in [0, 1), addressed by link, sender, time and the sender's count at that time."""


class OpenChannel(Protocol):
    """One direction of a channel during a run. Its state is deep-copyable."""

    def carry(self, now: Time, size: int, draws: Uniforms) -> tuple[Fate, Time, Time | None]:
        """Send `size` bytes at `now`: (fate, arrival, arrival of a duplicate or None).

        The fate is DELIVERED, LOST or OVERFLOW; the arrival counts only for the first, and is at least `latency_ns` of
        its channel after `now`. It is called in order of time.
        """
        ...


class VariableChannel(Protocol):
    """A channel whose conditions change during the run, such as a radio link. Frames keep their order on it."""

    @property
    def latency_ns(self) -> Time:
        """Least delay of a frame, at least 1 µs."""
        ...

    def open(self, direction: str) -> OpenChannel:
        """The state of the direction `fwd` or `rev`."""
        ...

    def describe(self) -> Mapping[str, Any]:
        """What the manifest says of it, as JSON data."""
        ...


class OwnRadio(Protocol):
    """A radio near a link over the air that is none of its ends: what it sends on the link, and what it hears of it.

    Its state is deep-copyable, with that of the channel.
    """

    def open(self, direction: str) -> OpenChannel:
        """The way of what it sends in the name of the sender of a direction, to the receiver of that direction."""
        ...

    def hear(self, direction: str, draw: float) -> Time | None:
        """When it has decoded the frame that the sender of a direction sent last; `None` if it has not.

        It is called at once after `OpenChannel.carry` of that frame, with a uniform in [0, 1).
        """
        ...


@dataclass(frozen=True, slots=True)
class RadioSite:
    """A radio of an attacker on the channel of a Wi-Fi link: where it is, and what it has."""

    name: str
    """Endpoint of the radio. Radios of one name and channel are one, which sends one frame at a time."""
    at_enu_m: tuple[float, float, float]
    """East, north and up in metres from the origin."""
    power_dbm: float
    """Equivalent isotropically radiated power."""
    has_key: bool = False
    """Whether it has the keys of the link, so that it can decrypt and encrypt as the link's ends do."""


@dataclass(frozen=True, slots=True)
class LinkEnds:
    """A link by its name and ends alone. `fwd` runs from `a` to `b`."""

    name: str
    a: str
    b: str


@dataclass(frozen=True, slots=True)
class LinkSpec:
    """One link instance. `fwd` runs from `a` to `b`."""

    name: str
    a: str
    b: str
    channel: Channel | VariableChannel = field(default_factory=Channel)

    def __post_init__(self) -> None:
        if self.channel.latency_ns < MIN_LATENCY_NS:
            raise ValueError(
                f"link {self.name}: latency_ns is {self.channel.latency_ns}, at least {MIN_LATENCY_NS} is needed"
            )


@runtime_checkable
class RowFilter(Protocol):
    """A selection of payloads that also decides on many at once."""

    def __call__(self, payload: bytes) -> bool:
        """Whether the payload is selected."""
        ...

    def rows(self, payloads: Payloads) -> NDArray[np.bool_]:
        """(n,) the same for each of n payloads."""
        ...


@dataclass(frozen=True, slots=True)
class Route:
    """Pure forwarding: what arrives at `endpoint` from link `source` leaves on link `target`, unaltered.

    The kernel forwards at the endpoint's next service time (`service_ns`) and may fuse hops; each is still recorded.
    With `select`, a module-level function of the payload or a `RowFilter`, only selected frames are forwarded.
    """

    endpoint: str
    source: str
    target: str
    service_ns: Time = 0
    select: Callable[[bytes], bool] | None = None


@dataclass(frozen=True, slots=True)
class ProcessingLimit:
    """How many frames an endpoint processes in a second, and how many more may wait there.

    It takes the frames of all links that end there, one after another, in the order in which they arrive, and each for
    the same time, beside that of defences there. What finds the queue full is lost by overflow. A frame is delivered,
    and forwarded, when it has been processed. What the endpoint sends is not limited.
    """

    endpoint: str
    frames_per_s: float
    """Over 0 and up to 1e6."""
    queue_frames: int
    """Frames that may wait, at least 1; the one that is being processed is not among them."""


NetworkPlace = Literal["air", "network", "onboard"]
"""Where an attacker is on a control link. `air`: beside it, with a radio of its own; `network`: in the operator's
network, behind the access point or base station; `onboard`: in the aircraft."""
AIR: Final = "air"
"""Side of a tap that is at no end of its link: it has a radio of its own."""


@dataclass(frozen=True, slots=True)
class TapPlacement:
    """Taps on the `side` end (an endpoint's role such as "gcs" or "companion") of every link that matches.

    `match` is a link name or a pattern with `*`; `make` is called with each link's name. Later placements on the same
    side are nearer to the channel. A tap with an `attack` is hostile: its acts are labelled, and have no effect while
    that attack is muted or does not act.

    A tap on the side `AIR`, of one link by its name, is at neither end. It is shown the frames of both directions that
    its radio decodes, and can neither hold nor alter them. What it injects goes over the air to the receiver.
    """

    match: str
    side: str
    make: Callable[[str], Tap]
    attack: str | None = None
    inspects: Callable[[Frame], bool] | None = None
    """Which frames a defence inspects there, a module-level function; `None` for all that pass, in both directions."""
    cost_ns: Time = 0
    """Time that the endpoint's processor needs for such a frame before the tap decides on it, in ns. Of a defence
    alone; skyrange fills it in from the scenario."""
    place: NetworkPlace | None = None
    """Where the attacker is, as the record tells it; `None` where the kind of attack has no choice."""
    site: RadioSite | None = None
    """The radio of a tap on the side `AIR`."""
    radio: OwnRadio | None = None
    """The same as a part of the link's channel; skyrange fills it in."""

    def find_ends(self, spec: LinkSpec) -> list[str]:
        """The ends of a link at which it places a tap: one where it fits, both or none where `side` is wrong; none of a
        link that does not match.
        """
        if not fnmatchcase(spec.name, self.match):
            return []
        return [end for end in (spec.a, spec.b) if end == self.side or end.endswith("." + self.side)]


@dataclass(slots=True)
class Schedule:
    """When an attack acts, as the attack's own agents, taps and sensor faults may read it during the run.

    Only the kernel writes here: `start_ns` is `NEVER` until a trigger has fired. It does not tell whether the attack
    is muted.
    """

    start_ns: Time = NEVER
    stop_ns: Time = NEVER


@dataclass(frozen=True, slots=True)
class ManualAct:
    """A start or a stop of an act by hand. It happens at the first world tick at or after `at_ns`."""

    at_ns: Time
    act: str
    """Id of the attack, fault or defence."""
    action: Literal["start", "stop"]
    by: str
    """Who did it, as the record tells it."""


Role = Literal["attack", "defence", "fault"]
"""What an act is. A fault has no adversary: its labels are marked so, and its events are named `event.fault_start` and
`event.fault_stop`. The acts of a defence are events named `event.defence_act` and no labels; its taps and sensor checks
may raise alerts in its name, and its checks come after the sensor faults of all others."""


@dataclass(frozen=True, slots=True)
class Act:
    """An attack, a defence or a benign fault in a kernel: when it takes effect, and the parts that it owns.

    It acts from `start_ns` until `stop_ns`, and no longer than `lasts_ns`. With a `trigger` it starts at the first
    world tick from `start_ns` on at which the trigger holds, and once only; a `manual` one starts by hand, from
    `start_ns` on and once only. Any may be stopped by hand. Muted, its agents, taps and sensor faults
    all run, but every verdict becomes Pass, everything they send is discarded, and sensor faults alter copies: that is
    the nominal twin.
    """

    id: str
    start_ns: Time = 0
    stop_ns: Time = NEVER
    muted: bool = False
    sham: bool = False
    """Whether its parts are those of its sham: its labels are then marked benign, or as harmless intrusions."""
    agents: Sequence[Agent] = ()
    sensor_hooks: Sequence[SensorHook] = ()
    trigger: Trigger | None = None
    lasts_ns: Time = NEVER
    one_process: bool = False
    """Whether its parts, taps included, share state and must be in one process."""
    schedule: Schedule | None = None
    """Where the kernel tells the attack's own parts when it acts; `None` where none of them reads it."""
    honest: bool = False
    """Whether its parts are those of its honest arm, where real aircraft fly on the tracks that it claims: its labels
    are then marked benign, and its events are named `event.honest_start` and `event.honest_stop`."""
    role: Role = "attack"
    body_hooks: Sequence[BodyHook] = ()
    """What a fault does to bodies; an attack has none."""
    scan_hooks: Sequence[ScanHook] = ()
    """What it does to the light of LiDARs and depth cameras."""
    intrudes: bool = False
    """Whether what its sham sends is of somebody unauthorised: such acts are labelled as harmless intrusions."""
    manual: bool = False
    """Whether it starts by hand (`ManualAct`); it has no trigger then."""
    noted: bool = True
    """Whether the kernel notes when it begins and ends; not where another kernel has the rest of it, and does."""

    @property
    def is_fault(self) -> bool:
        """Whether it is a benign fault."""
        return self.role == "fault"

    @property
    def is_defence(self) -> bool:
        """Whether it is a defence."""
        return self.role == "defence"

    @property
    def benign(self) -> bool:
        """Whether what it does harms nobody: a sham, or real aircraft that say what is true."""
        return self.sham or self.honest

    def is_harmless_intrusion(self, action: str) -> bool:
        """Whether an act of it, such as "inject", is harmless and of somebody unauthorised (`Label`)."""
        return self.sham and self.intrudes and action in ("inject", "send")
