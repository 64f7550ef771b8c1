"""Remote ID in a scenario: the radio medium, receivers on the ground, broadcasts of aircraft, and avoidance."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, Strict, ValidationInfo, field_validator, model_validator

from skyrange.contracts.params import Enu, Params
from skyrange.contracts.plugins.registry import AVOIDANCE, MEDIA
from skyrange.core.errors import nearest
from skyrange.radio.contract import MediumPlugin
from skyrange.remoteid.broadcast_profiles import TRANSPORTS
from skyrange.remoteid.drip.verification.verdicts import Authorities, ClockError, VerificationRate
from skyrange.scenario.model.base import FileName, Id, Model, Number, Whole, wrong
from skyrange.scenario.validation.plugin_params import checked, known, normalized
from skyrange.vehicle.avoidance.contract import AvoidancePlugin
from skyrange.vehicle.sight.settings import Air, FalseRate, MissedRate, PositionError

ReceiverKind = Literal["companion", "sniffer", "hopper", "phone", "phone-idle"]
"""Kinds of receiver: keys of `radio.builtin.listening.PROFILES`."""


Policy = Literal["accept", "ignore-forged", "ignore-unsigned", "ignore-unverified"]


class Verify(Model):
    """How a receiver verifies Remote ID, and which senders it believes."""

    method: Literal["drip"] = Field(
        default="drip", description="Method of authentication. drip: signatures after RFC 9575."
    )
    authorities: Authorities = "apex"
    policy: Policy = Field(
        default="accept",
        description="Senders that avoidance ignores. accept: none; ignore-forged: those that were refused, replayed or "
        "contradicted; ignore-unsigned: these and those that sign nothing; ignore-unverified: all but those with a "
        "signed Location or System message that was verified in the last 15 s.",
    )
    clock_error_s: ClockError = 0.0
    verifications_per_s: VerificationRate = None


def _method_alone(value: Any) -> Any:
    return {"method": value} if isinstance(value, str) else value


Verifies = Annotated[
    Annotated[Verify, BeforeValidator(_method_alone, json_schema_input_type=Verify | str)] | None,
    Field(description="Verification of the Remote ID that it receives; short form: the method. Default: none."),
]


class Receiver(Model):
    """A receiver on the ground. It reports the broadcasts that it decodes to the ground station of an operator."""

    id: Id = Field(description="Name, unique among the receivers.")
    operator: str = Field(description="Operator whose ground station gets the reports.")
    place: Enu = Field(description="Position of its antenna, [east_m, north_m, up_m] in metres from the origin.")
    placing: Literal["exact", "clear"] = Field(
        default="exact",
        description="exact: use the place as it is; clear: use the nearest place of the same height outside buildings.",
    )
    kind: ReceiverKind = Field(
        default="sniffer",
        description="Channels that it receives. companion: Wi-Fi channel 6, and Bluetooth; sniffer: Wi-Fi channel 6; "
        "hopper: all Wi-Fi channels in turn, and Bluetooth; phone (app in the foreground): Bluetooth, and a Wi-Fi "
        "scan every 30 s; phone-idle (phone in a pocket): Bluetooth for 10 % of the time.",
    )
    antenna: Literal["isotropic", "dipole"] = Field(default="isotropic", description="Pattern of its antenna.")
    verify: Verifies = None


class Radio(Model):
    """The radio medium of Remote ID: Wi-Fi and Bluetooth at 2.4 GHz, with the effect of buildings."""

    engine: Annotated[str, known(MEDIA, "a radio medium")] = Field(
        default="builtin", description="Model of the medium, a plugin of skyrange.media."
    )
    horizon_m: Number = Field(
        default=1000.0, gt=0, le=20_000, description="Largest distance in metres at which a broadcast can be received."
    )
    chance: Annotated[bool, Strict()] = Field(
        default=True,
        description="Whether there is random shadowing and fading; without it, signals have their median power.",
    )
    city_busy: Number = Field(
        default=0.0,
        ge=0,
        lt=1,
        description="Share of time in which background traffic of the city fills the Wi-Fi channels 1, 6 and 11.",
    )
    city_dbm: Number = Field(
        default=-85.0, gt=-200, lt=60, description="Mean power of that background traffic at any antenna, in dBm."
    )
    carrier_sense_dbm: Number | None = Field(
        default=None,
        gt=-200,
        lt=60,
        description="Power in dBm of the weakest Wi-Fi frame that senders defer to; default: every frame whose "
        "preamble they detect. IEEE 802.11 permits -82 dBm at most.",
    )
    aboard: ReceiverKind = Field(default="companion", description="Kind of receiver of all aircraft.")
    losses: Literal["city", "engine", "table"] = Field(
        default="city",
        description="Source of the losses between antennas. city: skyrange's models of open ground and buildings; "
        "table: a loss table, and the city where the table has no value; engine: an engine that is another program, by "
        "its own model.",
    )
    table: FileName | None = Field(
        default=None,
        description='Loss table of `skyrange radio map` for losses = "table", relative to the scenario\'s file.',
    )
    every_pair: Annotated[bool, Strict()] = Field(
        default=False, description="Whether to record receptions that were not decoded too, with the reason."
    )
    params: dict[str, Any] = Field(default_factory=dict, validate_default=True, description="Parameters of the engine.")
    receivers: tuple[Receiver, ...] = Field(default=(), description="Receivers on the ground.")

    @field_validator("params")
    @classmethod
    def _of_its_engine(cls, params: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
        """The parameters, checked and completed with the engine's defaults; unchanged if the engine is unknown."""
        return normalized(MediumPlugin.find(info.data["engine"]), params) if "engine" in info.data else params

    @model_validator(mode="after")
    def _table_for_its_losses(self) -> Radio:
        if self.losses == "table" and self.table is None:
            raise wrong("none", "the file of a loss table, because losses is table", where="table")
        if self.losses != "table" and self.table is not None:
            raise wrong(self.table, f"no file, because losses is {self.losses}", where="table")
        return self

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
            raise wrong(name, "a Remote ID transport", nearest(name, TRANSPORTS))
    kinds = [kind for name in names for kind in TRANSPORTS[name]]
    if len(set(kinds)) < len(kinds):
        raise wrong(", ".join(names), "each transport once; bluetooth is bt4 and bt5")
    return names


class RemoteId(Model):
    """Remote ID broadcasts of an aircraft."""

    profile: Literal["us", "astm"] = Field(
        default="us",
        description="us: every element of 14 CFR 89.305 each second; astm: dynamic messages each second, static ones "
        "every 3 s.",
    )
    transports: Annotated[tuple[str, ...], AfterValidator(_known_transports)] = Field(
        default=("wifi_beacon",),
        description="Transports: wifi_beacon, wifi_nan, bt5, bt4, or bluetooth for both bt4 and bt5. With an empty "
        "list the aircraft does not broadcast.",
    )
    uas_id: str = Field(
        default="",
        max_length=20,
        description="Serial number as in ANSI/CTA-2063-A; default: one that is derived from the vehicle's id.",
        json_schema_extra={"default": None},
    )
    operator_id: str = Field(default="", max_length=20, description="Operator ID to broadcast; default: none.")
    text: str = Field(default="", max_length=23, description="Self-ID text to broadcast; default: none.")
    wifi_dbm: Number = Field(default=15.0, ge=-60, le=60, description="Wi-Fi power into the antenna, in dBm.")
    ble_dbm: Number = Field(default=8.0, ge=-60, le=60, description="Bluetooth power into the antenna, in dBm.")
    auth: Literal["none", "drip"] = Field(
        default="none",
        description="Authentication of its broadcasts. drip: its identifier is a DRIP entity tag (RFC 9374), and it "
        "sends signatures after RFC 9575.",
    )
    auth_rates: Literal["required", "recommended"] = Field(
        default="required",
        description="How often it sends authentication messages. required: as seldom as RFC 9575 allows, a Manifest "
        "every 5 s, its own Link every minute, the Links of authorities every 5 minutes; recommended: a Manifest every "
        "second and Links every 16, 32 and 64 s.",
    )
    auth_repeats: Whole = Field(
        default=1,
        ge=1,
        le=3,
        description="How often it sends each authentication message over Bluetooth 4. A receiver that divides its time "
        "misses half of the pages.",
    )
    registry: Literal["range", "unknown"] = Field(
        default="range",
        description="Registry that endorses its key. unknown: one whose keys no receiver holds.",
    )
    verify: Verifies = None

    @model_validator(mode="after")
    def _can_be_signed(self) -> RemoteId:
        if self.auth == "drip" and self.uas_id:
            hint = "Omit uas_id: it is derived from the key."
            raise wrong(self.uas_id, 'no uas_id with auth = "drip"', hint, where="uas_id")
        if self.auth == "drip" and not self.transports:
            raise wrong("drip", "a transport that carries the authentication pages", "Add transports.", where="auth")
        return self


Fusion = Literal["radio", "sight", "confirm", "either"]


class SightRules(Model):
    """How a companion judges by sight whether an aircraft is where a broadcast claims it."""

    missed: MissedRate = 0.01
    false: FalseRate = 0.01
    sigma_m: PositionError = 2.5
    air: Air = "estimated"


class Avoidance(Model):
    """How an aircraft avoids the aircraft whose Remote ID it receives."""

    kind: Annotated[str, known(AVOIDANCE, "a kind of avoidance")] = Field(
        default="none", description="Kind of avoidance, a plugin of skyrange.avoidance."
    )
    params: dict[str, Any] = Field(default_factory=dict, validate_default=True, description="Parameters of the kind.")
    fusion: Fusion | None = Field(
        default=None,
        description="What the aircraft avoids, if it has LiDARs or depth cameras. radio: the tracks of Remote ID; "
        "confirm: those tracks without the ones at which its sensors looked and saw nothing; sight: what its sensors "
        "see; either: both. Default: radio.",
    )
    sight: SightRules | None = Field(
        default=None, description="What it assumes when it compares sight and radio; default: the defaults of all keys."
    )

    @field_validator("params")
    @classmethod
    def _of_its_kind(cls, params: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
        """The parameters, checked but without defaults; unchecked if the kind is unknown."""
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
"""An avoidance table; the short form is the name of the kind."""
