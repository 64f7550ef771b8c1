"""The scenario: the model that TOML files and Python both build; its JSON Schema is its reference."""

from __future__ import annotations

import math
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, Strict, field_validator, model_validator

from skyrange.contracts.links import Channel
from skyrange.contracts.params import Params
from skyrange.contracts.plugins import APPROVALS, ATTACKS, AUTOPILOTS, AVOIDANCE, DETECTORS, MEDIA, kinds
from skyrange.core.errors import Problem, nearest
from skyrange.core.geodesy import Origin as Datum
from skyrange.core.time import Epoch
from skyrange.scenario.model.attacks import AttackTable, When
from skyrange.scenario.model.autopilots import Autopilots
from skyrange.scenario.model.base import FileName, Model, Number, Whole, items, refuse, wrong
from skyrange.scenario.model.detectors import DetectorTable
from skyrange.scenario.model.fleet import Fleet, Start, Vehicle
from skyrange.scenario.model.hosts import Hosts
from skyrange.scenario.model.links import Link, resolve_channel
from skyrange.scenario.model.operators import Operator, name_operators
from skyrange.scenario.model.plan import Path, Plan, Square, mission_file, path, square
from skyrange.scenario.model.radio import Avoidance, Radio, Receiver, RemoteId
from skyrange.scenario.validation.cross_checks import cross_check
from skyrange.scenario.validation.plugin_params import checked, describe, describe_by_kind, normalized, params_of
from skyrange.utm.contract import ApprovalPlugin
from skyrange.world.wind import Wind as Air

__all__ = [
    "AttackTable",
    "Avoidance",
    "City",
    "DetectorTable",
    "Fleet",
    "Grid",
    "Link",
    "Operator",
    "Origin",
    "Path",
    "Plan",
    "Radio",
    "Receiver",
    "Record",
    "RemoteId",
    "Scenario",
    "Sensors",
    "Square",
    "Start",
    "Vehicle",
    "When",
    "Wind",
    "json_schema",
    "mission_file",
    "path",
    "square",
]


_KNOT_MPS = 1852 / 3600


class Origin(Model):
    """The point on Earth that all metres are measured from; the ground is flat at its height."""

    lat: Number = Field(ge=-89, le=89, description="WGS 84 latitude in degrees, north positive.")
    lon: Number = Field(ge=-180, le=180, description="WGS 84 longitude in degrees, east positive.")
    alt_msl_m: Number = Field(
        default=0.0, ge=-500, le=9_000, description="Height of the ground above mean sea level, in metres."
    )
    geoid_m: Number = Field(
        default=0.0,
        ge=-120,
        le=100,
        description="Height of mean sea level above the WGS 84 ellipsoid there, in metres.",
    )

    @property
    def datum(self) -> Datum:
        """The same point as the geodesy's map between metres and degrees."""
        return Datum(self.lat, self.lon, self.alt_msl_m, self.geoid_m)


class Grid(Model):
    """A generated downtown about the origin: square blocks of four buildings with streets between."""

    blocks: tuple[Annotated[Whole, Field(ge=1, le=100)], Annotated[Whole, Field(ge=1, le=100)]] = Field(
        default=(8, 6), description="Number of blocks, [east-west, north-south]."
    )
    height_m: tuple[Annotated[Number, Field(gt=0, le=1000)], Annotated[Number, Field(gt=0, le=1000)]] = Field(
        default=(20.0, 90.0), description="Least and greatest height of a building in metres, [low, high]."
    )
    street_m: Number = Field(default=24.0, gt=0, le=1000, description="Width of the streets in metres.")
    block_m: Number = Field(default=72.0, gt=0, le=1000, description="Side of a block in metres.")
    seed: Whole = Field(default=0, ge=0, le=2**63 - 1, description="Chance of the buildings, not that of the run.")

    @model_validator(mode="after")
    def _low_to_high(self) -> Grid:
        low, high = self.height_m
        if low > high:
            raise wrong(list(self.height_m), "the lower height first", where="height_m")
        return self


class City(Model):
    """The buildings: exactly one of a file and a generated grid."""

    buildings: FileName | None = Field(
        default=None,
        description="GeoJSON file of building footprints with OpenStreetMap's height or building:levels tags, "
        "relative to the scenario's file.",
    )
    grid: Grid | None = Field(default=None, description="Generate a downtown; {} for one of the usual size.")

    @model_validator(mode="after")
    def _one_source(self) -> City:
        if (self.buildings is None) == (self.grid is None):
            raise wrong("none of them" if self.grid is None else "both", "exactly one of buildings and grid")
        return self


TURBULENCE_MPS = {"none": 0.0, "light": 15 * _KNOT_MPS, "moderate": 30 * _KNOT_MPS, "severe": 45 * _KNOT_MPS}
"""Wind 20 ft above the ground that stirs each grade of turbulence: MIL-F-8785C, figure 7 of 3.7.3.4."""


class Wind(Model):
    """The same everywhere but for turbulence, which each aircraft meets on its own."""

    speed_mps: Number = Field(default=0.0, ge=0, le=60, description="Speed in m/s.")
    from_deg: Number = Field(
        default=0.0, ge=0, le=360, description="Where it blows from: degrees clockwise from true north."
    )
    turbulence: Literal["none", "light", "moderate", "severe"] = Field(
        default="none",
        description="Gusts by the grades of MIL-F-8785C: 15, 30 and 45 knots of wind 20 ft above the ground.",
    )
    w20_mps: Number | None = Field(
        default=None, ge=0, le=60, description="Gusts by that wind itself, in m/s, instead of a grade."
    )

    @model_validator(mode="after")
    def _one_grade(self) -> Wind:
        if self.w20_mps is not None and self.turbulence != "none":
            raise wrong(f"{self.w20_mps:g} and turbulence = {self.turbulence!r}", "one of the two", where="w20_mps")
        return self

    @property
    def air(self) -> Air:
        """The same wind as the world takes it: where the air goes, east, north and up."""
        from_rad, speed_mps = math.radians(self.from_deg), -self.speed_mps
        steady = (speed_mps * math.sin(from_rad), speed_mps * math.cos(from_rad), 0.0)
        return Air(steady, TURBULENCE_MPS[self.turbulence] if self.w20_mps is None else self.w20_mps)


class Sensors(Model):
    """How good the sensors of every aircraft are."""

    noise: Number = Field(
        default=1.0, ge=0, le=10, description="Factor on every error of the sensors: 1 usual, 0 ideal sensors."
    )


class Record(Model):
    """What is written down how often, beside every frame, decision and event."""

    truth_hz: Number = Field(default=10.0, ge=0, le=400, description="Rows of truth per aircraft and second; 0 none.")
    sensors_hz: Number = Field(
        default=5.0, ge=0, le=400, description="Rows of sensors per aircraft and second; 0 none."
    )


OnDeath = Literal["stop", "continue", "restart"]


class Live(Model):
    """What holds for `skyrange live` alone, beside `hosts`."""

    on_death: OnDeath = Field(
        default="stop",
        description="When a process dies: stop the range, continue without it, or restart it, at most three times. "
        "Without the world the range stops in any case.",
    )


def _origin(value: Any) -> Any:
    """(lat, lon) or (lat, lon, alt_msl_m) as an Origin's keys."""
    value = items(value)
    if isinstance(value, (list, tuple)) and len(value) in (2, 3):
        return dict(zip(("lat", "lon", "alt_msl_m"), value, strict=False))
    return value


def _utc(moment: datetime) -> datetime:
    """In UTC; a moment without a zone is taken as UTC."""
    if not 1970 <= moment.year < 2100:
        raise wrong(moment.isoformat(), "a moment from 1970 to 2099, as Unix time in microseconds carries it")
    return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)


class Scenario(Model):
    """A whole scenario. Once built, every id, colour and system id is filled in, and fleets are vehicles."""

    name: str = Field(
        default="scenario", min_length=1, max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9 ._-]*$",
        description="Title of the run and of its folder.",
    )  # fmt: skip
    seed: Whole = Field(default=1, ge=0, le=2**63 - 1, description="Chance of the run: the same seed, the same run.")
    duration_s: Number = Field(
        default=300.0,
        gt=0,
        le=31_536_000,
        description="Simulated seconds that the run goes on for, also when all missions are over.",
    )
    start_utc: Annotated[datetime, Strict(), AfterValidator(_utc)] = Field(
        default=datetime(2026, 1, 1, 12, tzinfo=UTC), description="Date and time in UTC when simulated time is 0."
    )
    origin: Annotated[Origin, BeforeValidator(_origin, json_schema_input_type=Origin | list[float])] = Field(
        description="The point on Earth that metres count from; in short [lat, lon] or with alt_msl_m."
    )
    city: City | None = Field(default=None, description="The buildings; default: none.")
    wind: Wind = Field(default_factory=Wind, description="The wind; default: none.")
    sensors: Sensors = Field(default_factory=Sensors, description="The aircraft's sensors; default: usual ones.")
    record: Record = Field(default_factory=Record, description="Rates of recording.")
    autopilots: Autopilots = Field(
        default_factory=Autopilots, description="How autopilots that are programs are run; default: as usual."
    )
    radio: Radio | None = Field(
        default=None,
        description="The medium of Remote ID: with it aircraft broadcast and hear each other; default: none.",
    )
    links: tuple[Link, ...] = Field(
        default=(), description="Changes to links' channels; later ones stand over earlier."
    )
    hosts: Hosts = Field(default_factory=dict)
    live: Live = Field(default_factory=Live, description="How a live range is run; default: as usual.")
    operators: tuple[Operator, ...] = Field(description="Who takes part, one operator or more.")
    approvals: dict[str, dict[str, Any]] = Field(
        default_factory=dict,
        description="Parameters of approval services, by kind, such as approvals.authority; one service of a kind "
        "serves all operators that have it. Default: those of each kind.",
    )
    attacks: tuple[AttackTable, ...] = Field(default=(), description="What is done to them; default: nothing.")
    detectors: tuple[DetectorTable, ...] = Field(
        default=(), description="What listens to links and raises alerts; default: nothing."
    )

    @field_validator("approvals")
    @classmethod
    def _of_their_kinds(cls, approvals: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
        """The parameters with every default."""
        offered = kinds(APPROVALS)
        unknown = [kind for kind in approvals if kind not in offered]
        if unknown:
            raise refuse(*(Problem(kind, kind, "an approval service", nearest(kind, offered)) for kind in unknown))
        return {kind: normalized(ApprovalPlugin.find(kind), given, kind) for kind, given in approvals.items()}

    @model_validator(mode="after")
    def _as_a_whole(self) -> Scenario:
        object.__setattr__(self, "operators", name_operators(self.operators))
        faults = cross_check(self)
        if faults:
            raise refuse(*faults)
        for kind in sorted({operator.approval for operator in self.operators} - self.approvals.keys()):
            checked(ApprovalPlugin.find(kind), {}, f"approvals.{kind}")  # the kind may need some that are not given
        return self

    @classmethod
    def cross_check(cls, data: Any) -> list[Problem]:
        """What `whole` finds in a table that is no scenario yet."""
        return cross_check(data)

    @property
    def epoch(self) -> Epoch:
        """Where simulated time 0 lies in UTC."""
        return Epoch.from_datetime(self.start_utc)

    @property
    def fleet(self) -> Iterator[tuple[Operator, Vehicle]]:
        """Every vehicle with its operator, in order."""
        return ((operator, vehicle) for operator in self.operators for vehicle in operator.vehicles)

    def channel(self, name: str, default: Channel) -> Channel:
        """The channel of the link called `name`: `default` under every rule of `links` that matches."""
        return resolve_channel(self.links, name, default)

    def approval_params(self, kind: str) -> Params:
        """The parameters of an approval service as its plugin's own model."""
        return params_of(ApprovalPlugin.find(kind), self.approvals.get(kind, {}), f"approvals.{kind}")

    def data(self) -> dict[str, Any]:
        """The scenario as plain data that `toml_reader.load_data` turns into its equal: no None, tuples as lists."""
        return {key: _listed(value) for key, value in self.model_dump(exclude_none=True).items()}


def _listed(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _listed(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_listed(item) for item in value]
    return value


_BOUNDS = {"ge": "minimum", "gt": "exclusiveMinimum", "le": "maximum", "lt": "exclusiveMaximum"}


def json_schema() -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of a scenario; every property says its meaning and unit."""
    schema = Scenario.model_json_schema(mode="validation")
    models = schema["$defs"]
    describe_by_kind(schema, models["AttackTable"], ATTACKS)
    describe_by_kind(schema, models["DetectorTable"], DETECTORS)
    describe_by_kind(schema, models["Avoidance"], AVOIDANCE)
    describe_by_kind(schema, models["Radio"], MEDIA, "engine")
    options = models["Autopilots"]["properties"]["options"]
    for group, table in ((APPROVALS, schema["properties"]["approvals"]), (AUTOPILOTS, options)):
        table["properties"] = {kind: describe(schema, group, kind) for kind in kinds(group)}
        table["additionalProperties"] = False
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **_bounded(schema)}


def _bounded(part: Any) -> Any:
    """Bounds of optional numbers by their JSON Schema names: pydantic leaves its own, which no validator knows."""
    if isinstance(part, list):
        return [_bounded(item) for item in part]
    if not isinstance(part, dict):
        return part
    names = _BOUNDS if part.get("type") in ("number", "integer") else {}
    return {names.get(key, key): _bounded(value) for key, value in part.items()}
