"""Attacks as plugins: the context that an attack is made from, and the parts that it consists of.

A kind of attack is a class with the decorator `attack` (`attack.declaration`), which is kept as an `AttackPlugin`
under a dotted name. Assembled in an `AttackContext`, an instance gives an `Attack`.

An attack does not decide whether its output takes effect. Its agents, taps and sensor hooks run for the whole run.
While the attack acts, the kernel passes their output on and labels every hostile act; at all other times it discards
the output. So an attack can be muted, and a muted run is the nominal twin of the attacked run, to the byte.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Protocol

from skyrange.attack.techniques import NO_FIT, Technique
from skyrange.contracts.params import Params
from skyrange.contracts.plugins.registry import ATTACKS, Plugin
from skyrange.core.ids import endpoint, link_name
from skyrange.core.time import Epoch, Time

if TYPE_CHECKING:
    from skyrange.attack.exclusive import Exclusive
    from skyrange.city.city import City
    from skyrange.contracts.claims import ClaimedTrack
    from skyrange.contracts.components import Agent, BodyHook, SensorHook
    from skyrange.contracts.links import LinkSpec, Schedule, TapPlacement
    from skyrange.contracts.scan_light import ScanHook
    from skyrange.core.chance import Chance
    from skyrange.core.geodesy import Origin
    from skyrange.optics.mounted_sensors import MountedSensor
    from skyrange.remoteid.drip.registry import Anchor, Registration

Place = tuple[float, float, float]
"""East, north and up in metres from the origin."""

Counterfactual = Literal["sham", "mute"]

Persistence = Literal["acts", "upload", "mode", "flight"]
"""What ends the effect of an attack: its last act (`acts`); its ground station's next upload of mission, fence and
rally points (`upload`); its ground station's next change of the mode (`mode`); nothing but the end of the flight, which
ends the others too (`flight`)."""

ORACLE = "oracle"
"""The endpoint at the other end of the links of every radio."""


@dataclass(frozen=True, slots=True)
class Aircraft:
    """What an attacker can know of an aircraft before the run: its registration and its start."""

    start_enu_m: Place
    uas_id: str
    """The UAS ID in its Remote ID broadcasts."""
    system_id: int = 1
    """Its system id in the MAVLink network of its operator, which every frame tells."""


@dataclass(frozen=True, slots=True)
class AirLink:
    """What an attacker can hear of a control link over the air: its channel, and the addresses of its two radios."""

    kind: Literal["wifi", "cellular", "sik"]
    centre_mhz: float
    width_mhz: float
    channel: int = 0
    """Wi-Fi channel; 0 for another link."""
    station_address: bytes = b""
    """MAC address of the access point, 6 bytes; empty for another link."""
    aircraft_address: bytes = b""


@dataclass(frozen=True, slots=True)
class GroundReceiver:
    """A receiver of Remote ID on the ground."""

    operator: str
    """Whose ground station gets its reports."""
    place: Place


class RemoteIdKeys(Protocol):
    """DRIP keys of the scenario that an adversary can hold. They are made when they are asked for."""

    def registered(self, name: str) -> Registration:
        """A registration of the adversary's own, in the registry that receivers know."""
        ...

    def unregistered(self, name: str) -> Registration:
        """A registration in a registry that the adversary has made up, whose keys no receiver holds."""
        ...

    def stolen(self, vehicle: str) -> Registration | None:
        """The registration of an aircraft of the scenario, with its private key; `None` if it signs nothing."""
        ...


def no_anchors(authorities: str) -> Sequence[Anchor]:
    """The anchors of a context that has none."""
    return ()


@dataclass(frozen=True, slots=True)
class AttackContext:
    """The context of an attack: data of the scenario, and the names of the attack's own endpoint and links.

    Its tables are the attack's own: to alter them alters nothing for others.
    """

    id: str
    """The attack's id, unique in the scenario."""
    vehicles: Mapping[str, Aircraft]
    """The aircraft by vehicle id (`green/g1`)."""
    links: Sequence[str]
    """The names of all links, without those of attacks."""
    origin: Origin
    epoch: Epoch
    chance: Chance
    duration_ns: Time
    schedule: Schedule
    """When the attack acts. The kernel fills it in during the run; keep a reference and read it then."""
    sham: bool = False
    """Whether to make the sham: the same transmitter, airtime and timing, with benign content."""
    city: City | None = None
    """The buildings, if there are any."""
    over_air: Mapping[str, AirLink] = field(default_factory=dict)
    """The control links that are on the air, by name."""
    receivers: Mapping[str, GroundReceiver] = field(default_factory=dict)
    """The receivers of Remote ID on the ground, by name: what their operators know of them."""
    sensors: Mapping[str, Sequence[MountedSensor]] = field(default_factory=dict)
    """The LiDARs and depth cameras of aircraft that have some, by vehicle id."""
    honest: bool = False
    """Whether to make the honest arm: a real aircraft flies on each of `Attack.claims` and carries its radio, so the
    attack has to send each aircraft's broadcasts on the `rid_up` link of that claim's radio."""
    signed: Sequence[str] = ()
    """The operators whose station and aircraft sign their MAVLink, as a flag in each frame tells."""
    keys: RemoteIdKeys | None = None
    """The keys of authenticated Remote ID that an adversary can hold; `None` where there is no registry, and for a
    defence."""
    anchors: Callable[[str], Sequence[Anchor]] = no_anchors
    """The public DRIP keys that receivers hold before the flight, by `authorities` of the settings of verification."""

    def __post_init__(self) -> None:
        for name in ("vehicles", "over_air", "receivers", "sensors"):  # each attack's own
            object.__setattr__(self, name, dict(getattr(self, name)))
        for name in ("links", "signed"):
            object.__setattr__(self, name, tuple(getattr(self, name)))

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
        """The link on which that radio receives."""
        return link_name("rid_down", self.id)


@dataclass(frozen=True, slots=True)
class Transmitter:
    """A radio of the attacker. It is a node of the medium, so range, walls and collisions apply to it."""

    endpoint: str
    at_enu_m: Place | None
    """`None`: aboard the body of its name, as in the honest arm; an attack gives a place."""
    power_dbm: float
    """Equivalent isotropically radiated power."""
    listens: bool = False
    """Whether the broadcasts that it decodes are sent to it on its `rid_down` link."""


@dataclass(frozen=True, slots=True)
class ThreatModel:
    """What an adversary needs for a kind of attack: each a phrase, such as "on the path to the aircraft"."""

    knowledge: str
    """What it has to know before, and what it learns meanwhile."""
    position: str
    """Where it has to be, in the network or in the air."""
    equipment: str
    """What it has to have."""
    budget: str
    """What it spends while it acts: frames, airtime, power."""


@dataclass(frozen=True, slots=True)
class Attack:
    """The parts of an attack, which become parts of the range. Labels of their acts have the attack's id."""

    agents: Sequence[Agent] = ()
    taps: Sequence[TapPlacement] = ()
    sensor_hooks: Sequence[SensorHook] = ()
    links: Sequence[LinkSpec] = ()
    """Links that the attack adds."""
    radios: Sequence[Transmitter] = ()
    claims: Sequence[ClaimedTrack] = ()
    """The aircraft that it claims to be there and that are not: where a real one flies in the honest arm."""
    shown: Mapping[str, Place] = field(default_factory=dict)
    """Places to mark on a map, such as that of a ghost, by label."""
    threat: ThreatModel | None = None
    """What this adversary needs, if it differs from what is said of the kind."""
    one_process: bool = False
    """Whether its parts share state, so that a live range must have all of them in one process."""
    body_hooks: Sequence[BodyHook] = ()
    """What it does to bodies: of benign faults alone."""
    exclusive: Sequence[Exclusive] = ()
    """What it alters as the only one. Another attack that alters the same at the same time is an error before the run.
    """
    scan_hooks: Sequence[ScanHook] = ()
    """What it does to the light of LiDARs and depth cameras."""


@dataclass(frozen=True, slots=True)
class Controls:
    """What separates the effect of the lie from that of its load: each a phrase, or "none, because …"."""

    load: str
    """An attack of the same frames, size and airtime, without the lie."""
    content: str
    """The same act with true or meaningless content, as far as it is another one than the load control. Of a kind that
    is `honest` it is the honest arm: the same frames, and a real aircraft where they say that one is."""
    placement: str
    """The same act on another link, aircraft or place."""


@dataclass(frozen=True, slots=True)
class AttackPlugin(Plugin[AttackContext, Attack]):
    """A kind of attack."""

    group: ClassVar[str] = ATTACKS

    technique: Technique = NO_FIT
    """Id of the technique in `attack.techniques`, ids by the value of a parameter, or `NO_FIT`."""
    mechanism: str = ""
    """The kind whose act this one is, with parameters that suit one purpose; empty for an act of its own."""
    counterfactual: Counterfactual = "sham"
    """What stands for "without it" in a comparison: the sham of an attack that lies, because muting it would remove its
    airtime too; `mute` for one that works by load, such as a jammer or a flood, and for one that alters readings of
    sensors alone, because its sham leaves them as they are and sends nothing, unless it denies them before it lies."""
    honest: bool = False
    """Whether it can make the honest arm: its attacks name the tracks of the aircraft that they claim
    (`Attack.claims`)."""
    places: Sequence[str] = ("at", "transmitter_m", "radio_m")
    """Names of parameters that are places, which `anchor` of an attack moves. The kind need not have all of them."""
    from_start: bool = False
    """Whether it has an effect only if it acts from 0 s on, such as one on what is loaded then."""
    move: Callable[[Any, Place], Params] | None = None
    """Moves places within other parameters, in metres east, north and up: `move(params, by)` returns the new ones."""
    intrudes: bool = False
    """Whether its sham puts frames on a link or in the air that are of somebody unauthorised. The kernel labels those
    acts as harmless intrusions, which are neither attacks nor benign. Not of a sham that only holds frames back or
    replaces them by themselves, nor of one that asks what an operator may ask."""
    family: str = ""
    """The mechanism family of a kind that is not shipped (`dataset.families` has the others): kinds of one family are
    held out of training together."""
    persists: Persistence | None = None
    """What ends its effect, by which alarms about it are scored. A kind that does not say so counts as `acts`."""
    surface: Sequence[str] = ()
    """What it acts on: roles of links (`gcs`, `log`, `autopilot`, `rid_up`), `medium`, or sensors (`gnss`, `baro`)."""
    effect: str = ""
    """What changes for its victims, as a phrase: "commands arrive late"."""
    threat: ThreatModel | None = None
    controls: Controls | None = None
    realism: Mapping[str, str] = field(default_factory=dict)
    """What a sensor or receiver reports under attack → "simulated", "cited: …" or "assumed: …"."""


def moved(plugin: AttackPlugin, params: Params, by: Place) -> Params:
    """The parameters of an attack with all their places moved, in metres east, north and up."""
    moved_params = move_places(plugin.places, params, by)
    return moved_params if plugin.move is None else plugin.move(moved_params, by)


def move_places(names: Sequence[str], params: Params, by: Place) -> Params:
    """The parameters with the places of these names moved; a name that they lack or leave empty is passed over."""
    places = {name: getattr(params, name, None) for name in names}
    return params.model_copy(update={name: move_place(at, by) for name, at in places.items() if at is not None})


def move_place(place: Place, by: Place) -> Place:
    """A place moved in metres east, north and up."""
    return (place[0] + by[0], place[1] + by[1], place[2] + by[2])
