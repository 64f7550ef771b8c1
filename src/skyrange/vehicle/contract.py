"""Autopilots as plugins: what an engine is told of its aircraft and of the range when it is made."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

from skyrange.codec.mavlink.signing import SIGNING_TIME, SigningKey, SigningTime
from skyrange.contracts.components import Engine
from skyrange.contracts.plugins.registry import AUTOPILOTS, Plugin
from skyrange.core.chance import Chance
from skyrange.core.geodesy import Origin
from skyrange.core.time import Epoch

if TYPE_CHECKING:
    from skyrange.city.city import City


@dataclass(frozen=True, slots=True)
class VehicleSpec:
    """One aircraft: it starts at `home_enu_m`, with `heading_deg` clockwise from north.

    `system_id` is its MAVLink system in the operator's network number `network`. `params` are ArduCopter parameters in
    their own units that replace defaults. `wind_enu_mps` is the steady wind, for engines with dynamics of their own.
    With a `signing_key` its MAVLink is signed, and commands to it must be signed, unless its channel is exempt from
    that (`signing_exempt`). With a `telemetry_radio` its control link is over a SiK radio. `run` is the run of a batch
    that it belongs to, whose own name `vehicle` is; `seed` is that of the run's chance.
    """

    vehicle: str
    system_id: int
    airframe: str = "iris"
    home_enu_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    heading_deg: float = 0.0
    params: Mapping[str, float] = field(default_factory=dict)
    network: int = 0
    wind_enu_mps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    signing_key: SigningKey | None = field(default=None, repr=False)
    signing_exempt: bool = False
    telemetry_radio: bool = False
    signing_time: SigningTime = SIGNING_TIME
    run: int = 0
    seed: int = 0


@dataclass(frozen=True, slots=True)
class AutopilotContext:
    """What the scenario tells an engine that it makes: one engine flies all aircraft of its kind."""

    name: str
    """The engine's name: its kind."""
    specs: Sequence[VehicleSpec]
    """Its aircraft, in the order of its rows."""
    origin: Origin
    epoch: Epoch
    chance: Chance
    motion: bool = False
    """The command line's word that vehicles outside the range may be moved (`--allow-motion`)."""
    city: City | None = None
    fleet: Sequence[VehicleSpec] = ()
    """All aircraft of the world, in its order: for an engine that shows those of other engines too."""


def _opens_none(params: Any, count: int) -> Sequence[int]:
    return ()


def _measures_the_worlds(params: Any) -> str:
    return ""


def _accepts_all(item: Any) -> int:
    return 0


def _always(params: Any) -> bool:
    return True


@dataclass(frozen=True, slots=True)
class AutopilotPlugin(Plugin[AutopilotContext, Engine]):
    """A kind of autopilot."""

    group: ClassVar[str] = AUTOPILOTS

    signs: bool = False
    """Whether they obey `VehicleSpec.signing_key`."""
    exempts: bool = False
    """Whether they obey `VehicleSpec.signing_exempt`."""
    reads_sensors: Callable[[Any], bool] = _always
    """`reads_sensors(params)`: whether they fly by the range's sensors. Physics of their own, or a vehicle outside, has
    others, which no attack on sensors, no sensor fault and no sensor check can reach."""
    opened_ports: Callable[[Any, int], Sequence[int]] = _opens_none
    """`opened_ports(params, count)`: the ports where that many aircraft obey whoever connects; of each one, or none."""
    other_battery: Callable[[Any], str] = _measures_the_worlds
    """`other_battery(params)`: which battery they measure instead of the world's; "" if they measure the world's. Their
    battery failsafes follow what they measure."""
    mission_result: Callable[[Any], int] = _accepts_all
    """`mission_result(item)`: the MAV_MISSION_RESULT with which they answer the upload of a MISSION_ITEM_INT.

    A scenario is checked with it before it is flown; what is not known beforehand is 0, accepted."""
