"""Flight approvals as plugins: what one is told when it is made, what it then owns, and constraints that it keeps.

Words are those of ASTM F3548-21: an *operational intent* claims 4-D volumes; an accepted one gets an
*OVN* (opaque version number), which names the version that was accepted.

An approval treats a constraint, an area that a constraint manager closes to flight, as an activated intent of the
highest priority: nothing is accepted into it, intents that have not been activated are taken back, and those in flight
are told.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from typing import TYPE_CHECKING, Any, ClassVar, Final, Protocol

from skyrange.contracts.plugins.registry import APPROVALS, Plugin
from skyrange.core.ids import APPROVAL, Port, endpoint, link_name
from skyrange.core.time import Time
from skyrange.core.volumes import Volume4D
from skyrange.utm.intent_states import IntentState

if TYPE_CHECKING:
    from skyrange.city.city import City
    from skyrange.contracts.components import Agent
    from skyrange.contracts.links import LinkSpec
    from skyrange.core.chance import Chance
    from skyrange.core.geodesy import Origin
    from skyrange.core.time import Epoch

DSS: Final = "dss"
"""The discovery and synchronization service."""
AIRSPACE: Final = "airspace"
"""The constraint manager."""


CONSTRAINT_PRIORITY: Final = 1_001
"""That of a constraint, above every priority that an operator may ask for."""


@dataclass(frozen=True, slots=True)
class OperationalIntent:
    """One operational intent: `operator` asks to fly `vehicle` through `volumes`, in the order flown.

    `id` is a UUID (see `intent_id`); `vehicle` a vehicle id (`blue/b1`); `priority` follows F3548
    (0 is routine, higher outranks). `state` is the one that the intent is to have.
    """

    id: str
    operator: str
    vehicle: str
    volumes: tuple[Volume4D, ...]
    priority: int = 0
    state: IntentState = IntentState.ACCEPTED


@dataclass(frozen=True, slots=True)
class Constraint:
    """An area that is closed to flight for a while."""

    name: str
    volume: Volume4D
    published_ns: Time
    """When approvals are told."""

    @property
    def id(self) -> str:
        """Its id, a UUID."""
        return make_uuid(f"constraint {self.name}")


@dataclass(frozen=True, slots=True)
class Alternative:
    """What would be accepted instead of an intent: the flight delayed, raised or shifted, and about what it claims."""

    volumes: tuple[Volume4D, ...]
    delay_ns: Time = 0
    """How much later the flight departs."""
    climb_m: float = 0.0
    """How much higher it flies."""
    east_m: float = 0.0
    north_m: float = 0.0
    """How far aside it flies, but for take-off and landing."""


@dataclass(frozen=True, slots=True)
class Overruled:
    """An accepted intent that another one of higher priority overlaps: its operator is told."""

    id: str
    operator: str
    vehicle: str
    reason: str
    in_flight: bool = False
    """Whether it is activated. It keeps its claim then, because its aircraft is there; otherwise it is rejected."""
    closed: tuple[Volume4D, ...] = ()
    """What the higher one claims."""


@dataclass(frozen=True, slots=True)
class ApprovalDecision:
    """What the approval says: accepted with an `ovn`, or rejected with a `reason` and perhaps `alternatives`."""

    accepted: bool
    reason: str = ""
    alternatives: tuple[Alternative, ...] = ()
    ovn: str = ""
    tracked: bool = False
    """Whether the approval wants to be told when an accepted intent is activated, when the aircraft leaves its volumes,
    and when it has ended."""
    overruled: tuple[Overruled, ...] = ()
    """Intents that this one outranks: their operators are told."""
    conflicts: int = 0
    """How many intents of lower priority it overlaps, known to the approval, of which the operator has to hear
    (F3548-21, SCD0090)."""


class ApprovalPolicy(Protocol):
    """Decides on intents: all that an approval needs that is one service for all its operators (`policy_plugin`).

    Same calls in the same order, same answers: no clock, no socket. Its state is deep-copyable data.
    """

    def decide(self, now: Time, request: OperationalIntent) -> ApprovalDecision:
        """Accept or reject `request` at `now`; called once per distinct request, in order of arrival."""
        ...

    def end(self, now: Time, intent: str) -> None:
        """The operator has withdrawn the intent with this id, or flown it; one that is not known changes nothing."""
        ...


@dataclass(frozen=True, slots=True)
class ApprovalContext:
    """What the scenario tells an approval that it makes: one serves all operators of its kind."""

    name: str
    """What its agent is called: `approval.<kind>`; of several agents each name begins so, and goes on after a dot."""
    operators: Sequence[str]
    """Those that it serves, in order."""
    origin: Origin
    epoch: Epoch
    chance: Chance
    city: City | None = None
    """The buildings, if there are any."""
    constraints: Sequence[Constraint] = ()
    """Areas that are closed to flight."""

    def port(self, operator: str) -> Port:
        """Where the requests of an operator arrive, and the answers leave. Each belongs to exactly one agent."""
        return Port(APPROVAL, link_name(APPROVAL, operator))

    def endpoint(self, name: str) -> str:
        """An endpoint of the approval's own, an end of links between its agents: `approval.<name>`."""
        return endpoint(APPROVAL, name)


@dataclass(frozen=True, slots=True)
class ApprovalService:
    """What an approval owns: its agents, and the links between them."""

    agents: Sequence[Agent]
    links: Sequence[LinkSpec] = ()
    """Links that it brings along, of kind `uss`, between endpoints of its own."""


@dataclass(frozen=True, slots=True)
class ApprovalPlugin(Plugin[ApprovalContext, ApprovalService]):
    """A kind of flight approval. What speaks on the `approval` links is `utm.messages`."""

    group: ClassVar[str] = APPROVALS

    policy: Callable[[Any], ApprovalPolicy] | None = None
    """`policy(params)`: what decides, where that is one object (`policy_plugin`); None for another design."""


def is_constraint(intent: OperationalIntent) -> bool:
    """Whether an intent stands for a constraint."""
    return intent.priority == CONSTRAINT_PRIORITY


def overruled_by(higher: OperationalIntent, other: OperationalIntent) -> Overruled:
    """That `higher` overlaps `other`, which has a lower priority."""
    if is_constraint(higher):
        reason = f"{higher.vehicle} closes a part of it"
    else:
        reason = f"{higher.vehicle}, of priority {higher.priority}, has claimed a part of it"
    in_flight = other.state is IntentState.ACTIVATED
    return Overruled(other.id, other.operator, other.vehicle, reason, in_flight, higher.volumes)


def version_number(intent: OperationalIntent) -> str:
    """An OVN for a version of an intent: a digest of its content, the same in every run."""
    content = (
        f"Intent(id={intent.id!r}, operator={intent.operator!r}, vehicle={intent.vehicle!r}, "
        f"volumes={intent.volumes!r}, priority={intent.priority!r})"
    )
    return blake2b(content.encode(), digest_size=16).hexdigest()


def intent_id(vehicle: str, version: int = 0) -> str:
    """A UUID for the `version`-th intent of a vehicle, the same in every run."""
    return make_uuid(f"{vehicle}#{version}")


def make_uuid(name: str) -> str:
    """A UUID for a name, the same in every run.

    Its form is that of version 4, as F3548-21's EntityID asks (RFC 9562, 5.4); its bits come from
    BLAKE2b of the name, since a random one would differ between twins.
    """
    raw = bytearray(blake2b(name.encode(), digest_size=16).digest())
    raw[6] = raw[6] & 0x0F | 0x40
    raw[8] = raw[8] & 0x3F | 0x80
    text = raw.hex()
    return f"{text[:8]}-{text[8:12]}-{text[12:16]}-{text[16:20]}-{text[20:]}"


def claim_of(id_: str, name: str, volumes: Sequence[Volume4D]) -> OperationalIntent:
    """The intent as which an approval treats a constraint."""
    return OperationalIntent(id_, "", f"constraint {name}", tuple(volumes), CONSTRAINT_PRIORITY, IntentState.ACTIVATED)


class Publication:
    """Constraints in the order of their publication. Deep-copyable."""

    def __init__(self, constraints: Sequence[Constraint] = ()) -> None:
        self._waiting = sorted(constraints, key=lambda constraint: (constraint.published_ns, constraint.name))

    @property
    def due(self) -> Time | None:
        """When the next one is published."""
        return self._waiting[0].published_ns if self._waiting else None

    def take(self, now: Time) -> list[Constraint]:
        """Those that are published by `now`, each once."""
        count = sum(constraint.published_ns <= now for constraint in self._waiting)
        published, self._waiting = self._waiting[:count], self._waiting[count:]
        return published
