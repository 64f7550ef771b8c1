"""What is on the air? The radio medium and its receivers, what aircraft broadcast, and what they do about others."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, Strict, ValidationError, model_validator

from skyrange.agent.plugins import AVOIDANCE
from skyrange.agent.settings import Enu
from skyrange.core.errors import Fault, nearest
from skyrange.remoteid.profiles import TRANSPORTS
from skyrange.scenario.base import Id, Model, Number, known, refuse, wrong
from skyrange.scenario.faults import faults_of

if TYPE_CHECKING:
    from skyrange.city.city import City

ReceiverKind = Literal["companion", "sniffer", "hopper", "phone", "phone-idle"]
"""Kinds of receivers, rows of `radio.receivers.PROFILES`."""


class Receiver(Model):
    """A receiver on the ground, which tells an operator's ground station what it hears."""

    id: Id = Field(description="Name, unique among the receivers.")
    operator: str = Field(description="Whose ground station is told.")
    place: Enu = Field(description="Where its antenna is: [east_m, north_m, up_m] in metres from the origin.")
    placing: Literal["exact", "clear"] = Field(
        default="exact", description="exact: there; clear: at the nearest place, as high up, that is in no building."
    )
    kind: ReceiverKind = Field(
        default="sniffer",
        description="What it listens to, and when: sniffer stays on Wi-Fi channel 6; hopper goes through the Wi-Fi "
        "channels and scans Bluetooth; phone is an app in the foreground, phone-idle one in a pocket; companion has "
        "what aircraft have.",
    )
    antenna: Literal["isotropic", "dipole"] = Field(default="isotropic", description="Its antenna's pattern.")


class Radio(Model):
    """The medium that carries Remote ID: 2.4 GHz Wi-Fi and Bluetooth among the buildings."""

    engine: Literal["builtin"] = Field(default="builtin", description="What models the medium.")
    horizon_m: Number = Field(
        default=1000.0, gt=0, le=20_000, description="Beyond this distance in metres nobody hears anybody."
    )
    chance: Annotated[bool, Strict()] = Field(
        default=True, description="Shadowing and fading; without, signals are their medians."
    )
    city_busy: Number = Field(
        default=0.0,
        ge=0,
        lt=1,
        description="Share of time in which the city's own frames fill the Wi-Fi channels 1, 6 and 11, from 0 to 1.",
    )
    city_dbm: Number = Field(
        default=-85.0, gt=-200, lt=60, description="How strong those are at any antenna on average, in dBm."
    )
    aboard: ReceiverKind = Field(default="companion", description="The kind of receiver that aircraft carry.")
    every_pair: Annotated[bool, Strict()] = Field(
        default=False, description="Record also who could not decode what, and why."
    )
    receivers: tuple[Receiver, ...] = Field(default=(), description="Receivers on the ground.")


def _known_transports(names: tuple[str, ...]) -> tuple[str, ...]:
    for name in names:
        if name not in TRANSPORTS:
            raise wrong(name, "a way to broadcast", nearest(name, TRANSPORTS))
    kinds = [kind for name in names for kind in TRANSPORTS[name]]
    if len(set(kinds)) < len(kinds):
        raise wrong(", ".join(names), "each way once")
    return names


class RemoteId(Model):
    """What an aircraft broadcasts about itself."""

    profile: Literal["us", "astm"] = Field(
        default="us",
        description="us: every element of 14 CFR 89.305 each second; astm: what moves each second, the rest every 3 s.",
    )
    transports: Annotated[tuple[str, ...], AfterValidator(_known_transports)] = Field(
        default=("wifi_beacon",),
        description="Over what: wifi_beacon, wifi_nan, bt5, bt4, or bluetooth for the last two; none: it is silent.",
    )
    uas_id: str = Field(
        default="",
        max_length=20,
        description="Serial number by ANSI/CTA-2063-A; default: one made of the vehicle's id.",
        json_schema_extra={"default": None},
    )
    operator_id: str = Field(default="", max_length=20, description="Operator ID to send; default: none is sent.")
    text: str = Field(default="", max_length=23, description="Self-ID text to send; default: none is sent.")
    wifi_dbm: Number = Field(default=15.0, ge=-60, le=60, description="Wi-Fi power into the antenna in dBm.")
    ble_dbm: Number = Field(default=8.0, ge=-60, le=60, description="Bluetooth power into the antenna in dBm.")


class Avoidance(Model):
    """How an aircraft keeps from others that it hears."""

    kind: Annotated[str, known(AVOIDANCE, "a kind of avoidance")] = Field(
        default="none", description="A plugin of skyrange.avoidance."
    )
    params: dict[str, Any] = Field(default_factory=dict, description="The kind's own parameters.")

    @model_validator(mode="after")
    def _made_once(self) -> Avoidance:
        """Making one finds what is wrong with its parameters."""
        self.make(None)
        return self

    def make(self, city: Any) -> Any:
        """The avoidance, aware of the city's walls."""
        from skyrange.agent.plugins import find
        from skyrange.vehicle.avoidance.contract import Limits

        try:
            return find(AVOIDANCE, self.kind)(city, Limits.model_validate(self.params))
        except ValidationError as error:
            found = faults_of(error, Limits, self.params)
            raise refuse(*(Fault(f"params.{f.where}", f.value, f.expected, f.hint) for f in found)) from None


def _kind_alone(value: Any) -> Any:
    return {"kind": value} if isinstance(value, str) else value


AnyAvoidance = Annotated[Avoidance, BeforeValidator(_kind_alone, json_schema_input_type=Avoidance | str)]
"""In short its kind."""


def misplaced(where: str, place: tuple[float, float, float], city: City | None) -> Iterator[Fault]:
    """Antennas below the ground or inside buildings; `where` is the place's key."""
    east_m, north_m, up_m = place
    shown = f"[{east_m:g}, {north_m:g}, {up_m:g}] m"
    building = city.inside(east_m, north_m, up_m) if city is not None else None
    if up_m < 0.0:
        yield Fault(where, shown, "a place on the ground (0) or above")
    elif building is not None:
        yield Fault(
            where,
            shown,
            f"a place outside buildings; this is in {building.name or building.id}, {building.height_m:g} m high",
            "Put it on the roof, or into the street.",
        )
