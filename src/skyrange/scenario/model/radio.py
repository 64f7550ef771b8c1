"""The air in a scenario: the radio medium and its receivers, what aircraft broadcast, what they do about others."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, Strict, ValidationInfo, field_validator

from skyrange.contracts.params import Enu, Params
from skyrange.contracts.plugins import AVOIDANCE, MEDIA
from skyrange.core.errors import nearest
from skyrange.radio.contract import MediumPlugin
from skyrange.remoteid.broadcast_profiles import TRANSPORTS
from skyrange.scenario.model.base import Id, Model, Number, wrong
from skyrange.scenario.validation.plugin_params import checked, known, normalized
from skyrange.vehicle.avoidance.contract import AvoidancePlugin

ReceiverKind = Literal["companion", "sniffer", "hopper", "phone", "phone-idle"]
"""Kinds of receivers, rows of `radio.builtin.listening.PROFILES`."""


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

    engine: Annotated[str, known(MEDIA, "a radio medium")] = Field(
        default="builtin", description="What models the medium, a plugin of skyrange.media."
    )
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
    params: dict[str, Any] = Field(
        default_factory=dict, validate_default=True, description="The engine's own parameters."
    )
    receivers: tuple[Receiver, ...] = Field(default=(), description="Receivers on the ground.")

    @field_validator("params")
    @classmethod
    def _of_its_engine(cls, params: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
        """The parameters with every default; untouched where the engine is unknown."""
        return normalized(MediumPlugin.find(info.data["engine"]), params) if "engine" in info.data else params

    @property
    def plugin(self) -> MediumPlugin:
        """The plugin of its engine."""
        return MediumPlugin.find(self.engine)

    @property
    def settings(self) -> Params:
        """The parameters as the engine's own model."""
        return self.plugin.params.model_validate(self.params)


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
    params: dict[str, Any] = Field(
        default_factory=dict, validate_default=True, description="The kind's own parameters."
    )

    @field_validator("params")
    @classmethod
    def _of_its_kind(cls, params: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
        """The parameters as given, once they are checked; of an unknown kind they are not."""
        if "kind" in info.data:
            checked(AvoidancePlugin.find(info.data["kind"]), params)
        return params

    @property
    def plugin(self) -> AvoidancePlugin:
        """The plugin of its kind."""
        return AvoidancePlugin.find(self.kind)

    @property
    def settings(self) -> Params:
        """The parameters as the kind's own model."""
        return self.plugin.params.model_validate(self.params)


def _kind_alone(value: Any) -> Any:
    return {"kind": value} if isinstance(value, str) else value


AnyAvoidance = Annotated[Avoidance, BeforeValidator(_kind_alone, json_schema_input_type=Avoidance | str)]
"""In short its kind."""
