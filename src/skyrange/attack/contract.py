"""Attacks as plugins: what one is told when it is made, and what it then owns.

An attack kind is one file: a model of its parameters, and a function that makes an `Attack` of them and of a
`AttackContext`. It is offered as an `AttackPlugin` under a dotted name, in the entry point group `skyrange.attacks`.

An attack never decides whether it counts. Its agents, taps and faults run from the beginning of the run to its end;
the kernel lets through what they do while the attack acts, writes a label of each deed, and throws the rest away. So
an attack can be muted, and a muted run is its nominal twin to the byte.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

from skyrange.contracts.plugins import ATTACKS, Plugin
from skyrange.core.ids import endpoint, link_name
from skyrange.core.time import Epoch, Time

if TYPE_CHECKING:
    from skyrange.city.city import City
    from skyrange.contracts.components import Agent, SensorFault
    from skyrange.contracts.links import LinkSpec, Schedule, TapPlacement
    from skyrange.core.chance import Chance
    from skyrange.core.geodesy import Origin

Place = tuple[float, float, float]
"""East, north and up in metres from the origin."""

ORACLE = "oracle"
"""The endpoint at the other end of every radio's links."""


@dataclass(frozen=True, slots=True)
class Aircraft:
    """One aircraft as an attacker may know it beforehand: what a look at its registration and its start tells."""

    start_enu_m: Place
    uas_id: str
    """The identifier in its Remote ID broadcast."""


@dataclass(frozen=True, slots=True)
class AttackContext:
    """What the scenario tells an attack that it makes. Endpoints and links are named by these methods."""

    id: str
    """The attack's id, unique in the scenario."""
    vehicles: Mapping[str, Aircraft]
    """By vehicle id (`green/g1`)."""
    links: Sequence[str]
    """Every link's name, without those of attacks."""
    origin: Origin
    epoch: Epoch
    chance: Chance
    duration_ns: Time
    schedule: Schedule
    """From when until when the attack acts: filled in during the run, not before. Keep it and read it."""
    sham: bool = False
    """Make the sham: the same transmitter, airtime and timing, with content that harms nobody."""
    city: City | None = None
    """The buildings, if there are any: anybody can see those."""

    @property
    def radio(self) -> str:
        """The endpoint of the attacker's radio."""
        return endpoint(self.id, "radio")

    @property
    def up(self) -> str:
        """The link on which that radio sends."""
        return link_name("rid_up", self.id)

    @property
    def down(self) -> str:
        """The link on which it hears."""
        return link_name("rid_down", self.id)


@dataclass(frozen=True, slots=True)
class Transmitter:
    """A radio of the attacker: a node in the medium like any other, so that range, walls and collisions apply to it."""

    endpoint: str
    at_enu_m: Place
    power_dbm: float
    """Equivalent isotropically radiated power."""
    listens: bool = False
    """Whether what it hears is sent to it on its `rid_down` link."""


@dataclass(frozen=True, slots=True)
class Attack:
    """What an attack owns. The scenario puts it into the range; every part of it is labelled with the attack's id."""

    agents: Sequence[Agent] = ()
    taps: Sequence[TapPlacement] = ()
    faults: Sequence[SensorFault] = ()
    links: Sequence[LinkSpec] = ()
    """Links that it brings along."""
    radios: Sequence[Transmitter] = ()
    shown: Mapping[str, Place] = field(default_factory=dict)
    """Places worth a mark on a map, such as where a ghost stands, by what to call them."""


@dataclass(frozen=True, slots=True)
class AttackPlugin(Plugin[AttackContext, Attack]):
    """A kind of attack."""

    group: ClassVar[str] = ATTACKS

    technique: str = "no fit"
    """Id of the technique in MITRE ATT&CK for ICS, or "no fit"."""
    places: Sequence[str] = ("at", "transmitter_m")
    """Parameters that are places, where it has them: an attack's `anchor` moves them."""
