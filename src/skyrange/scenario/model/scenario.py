"""The scenario model, which both TOML files and Python build; the reference is generated from its JSON Schema."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime
from os import PathLike, fspath
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, Strict, field_validator, model_validator

from skyrange.contracts.links import Channel
from skyrange.contracts.params import Params
from skyrange.contracts.plugins.registry import (
    APPROVALS,
    ATTACKS,
    AUTOPILOTS,
    AVOIDANCE,
    DEFENCES,
    DETECTORS,
    FAULTS,
    MEDIA,
    kinds,
)
from skyrange.core import elementary_python
from skyrange.core.errors import InputError, Problem, nearest
from skyrange.core.geodesy import Origin as Datum
from skyrange.core.time import Epoch
from skyrange.radio.control_link.params import BaseStation, CellularParams, WifiParams
from skyrange.radio.control_link.sik.params import SikParams
from skyrange.scenario.model.attacks import ActTable, AttackTable, FaultTable, When
from skyrange.scenario.model.base import FileName, Model, Number, Whole, items, refuse, wrong
from skyrange.scenario.model.constraints import ConstraintTable
from skyrange.scenario.model.defences import DefenceCost, DefenceTable, DetectorTable
from skyrange.scenario.model.fleet import Autopilots, Fleet, Start, Vehicle
from skyrange.scenario.model.landing import Landing
from skyrange.scenario.model.links import AirParams, Hosts, Link, Processing, resolve_channel, resolve_over_air
from skyrange.scenario.model.manual_acts import ManualActTable
from skyrange.scenario.model.operators import Operator, ReplanningRules, SigningTimeRules, VolumeMargins, name_operators
from skyrange.scenario.model.optics import OpticalSensor, Optics
from skyrange.scenario.model.plan import (
    Fence,
    FenceCircle,
    FencePolygon,
    Path,
    Plan,
    Route,
    Square,
    mission_file,
    path,
    route,
    square,
)
from skyrange.scenario.model.radio import Avoidance, Radio, Receiver, RemoteId, SightRules, Verify
from skyrange.scenario.validation.cross_checks import cross_check
from skyrange.scenario.validation.plugin_params import checked, describe, describe_by_kind, normalized, params_of
from skyrange.utm.contract import ApprovalPlugin
from skyrange.world.bodies import Wind as Air

__all__ = [
    "AttackTable",
    "Avoidance",
    "BaseStation",
    "CellularParams",
    "City",
    "DefenceCost",
    "DefenceTable",
    "DetectorTable",
    "FaultTable",
    "Fence",
    "FenceCircle",
    "FencePolygon",
    "Fleet",
    "Grid",
    "Landing",
    "Link",
    "ManualActTable",
    "Operator",
    "OpticalSensor",
    "Optics",
    "Origin",
    "Path",
    "Plan",
    "Processing",
    "Radio",
    "Receiver",
    "Record",
    "RemoteId",
    "ReplanningRules",
    "Route",
    "Scenario",
    "Sensors",
    "SightRules",
    "SigningTimeRules",
    "SikParams",
    "Square",
    "Start",
    "Vehicle",
    "Verify",
    "VolumeMargins",
    "When",
    "WifiParams",
    "Wind",
    "json_schema",
    "mission_file",
    "path",
    "route",
    "square",
]


_KNOT_MPS = 1852 / 3600


class Origin(Model):
    """The origin of all coordinates, a point on Earth. The ground is flat and lies at its height."""

    lat: Number = Field(
        ge=-80,
        le=80,
        description="WGS 84 latitude in degrees, north positive. The flat map is not accurate nearer to the poles.",
    )
    lon: Number = Field(ge=-180, le=180, description="WGS 84 longitude in degrees, east positive.")
    alt_msl_m: Number = Field(
        default=0.0, ge=-500, le=9_000, description="Height of the ground above mean sea level, in metres."
    )
    geoid_m: Number = Field(
        default=0.0,
        ge=-120,
        le=100,
        description="Height of mean sea level above the WGS 84 ellipsoid at the origin, in metres.",
    )

    @property
    def datum(self) -> Datum:
        """The geodetic datum of this origin, which converts between metres and degrees."""
        return Datum(self.lat, self.lon, self.alt_msl_m, self.geoid_m)


class Grid(Model):
    """A generated downtown centred on the origin: square blocks of four buildings, separated by streets."""

    blocks: tuple[Annotated[Whole, Field(ge=1, le=100)], Annotated[Whole, Field(ge=1, le=100)]] = Field(
        default=(8, 6), description="Number of blocks, [east-west, north-south]."
    )
    height_m: tuple[Annotated[Number, Field(gt=0, le=1000)], Annotated[Number, Field(gt=0, le=1000)]] = Field(
        default=(20.0, 90.0), description="Range of the heights of the buildings in metres, [lowest, highest]."
    )
    street_m: Number = Field(default=24.0, gt=0, le=1000, description="Width of the streets in metres.")
    block_m: Number = Field(default=72.0, gt=0, le=1000, description="Side of a block in metres.")
    seed: Whole = Field(default=0, ge=0, le=2**63 - 1, description="Seed of the building generator.")

    @model_validator(mode="after")
    def _low_to_high(self) -> Grid:
        low, high = self.height_m
        if low > high:
            raise wrong(list(self.height_m), "[lowest, highest], the lower height first", where="height_m")
        return self


class City(Model):
    """The buildings: either a file or a generated grid."""

    buildings: FileName | None = Field(
        default=None,
        description="File of buildings, such as GeoJSON with OpenStreetMap's height or building:levels tags, "
        "relative to the scenario's file.",
    )
    grid: Grid | None = Field(default=None, description="Generated downtown; {} uses all defaults.")

    @model_validator(mode="after")
    def _one_source(self) -> City:
        if (self.buildings is None) == (self.grid is None):
            raise wrong("neither" if self.grid is None else "both", "exactly one of buildings and grid")
        return self


TURBULENCE_MPS = {"none": 0.0, "light": 15 * _KNOT_MPS, "moderate": 30 * _KNOT_MPS, "severe": 45 * _KNOT_MPS}
"""Wind speed 20 ft above the ground of each turbulence grade: MIL-F-8785C, figure 7 of 3.7.3.4."""


class Wind(Model):
    """The mean wind is the same everywhere. Turbulence is independent for each aircraft."""

    speed_mps: Number = Field(default=0.0, ge=0, le=60, description="Mean wind speed in m/s.")
    from_deg: Number = Field(
        default=0.0,
        ge=0,
        le=360,
        description="Direction that the wind comes from, in degrees clockwise from true north.",
    )
    turbulence: Literal["none", "light", "moderate", "severe"] = Field(
        default="none",
        description="Turbulence grade of MIL-F-8785C: light, moderate and severe mean a wind of 15, 30 and 45 knots "
        "20 ft above the ground.",
    )
    w20_mps: Number | None = Field(
        default=None,
        ge=0,
        le=60,
        description="Wind speed 20 ft above the ground in m/s, which sets the turbulence instead of a grade.",
    )

    @model_validator(mode="after")
    def _one_grade(self) -> Wind:
        if self.w20_mps is not None and self.turbulence != "none":
            raise wrong(
                f"{self.w20_mps:g} and turbulence = {self.turbulence!r}",
                "either w20_mps or turbulence, not both",
                where="w20_mps",
            )
        return self

    @property
    def air(self) -> Air:
        """The wind in the form that the world uses: the velocity of the air, east, north and up."""
        from_rad, speed_mps = math.radians(self.from_deg), -self.speed_mps
        steady = (speed_mps * elementary_python.sin(from_rad), speed_mps * elementary_python.cos(from_rad), 0.0)
        return Air(steady, TURBULENCE_MPS[self.turbulence] if self.w20_mps is None else self.w20_mps)


class Sensors(Model):
    """Errors of the sensors of all aircraft."""

    noise: Number = Field(
        default=1.0, ge=0, le=10, description="Scale factor of all sensor errors: 1 is typical, 0 is ideal."
    )
    warming_k: Number = Field(
        default=0.0,
        ge=0,
        le=100,
        description="Kelvin by which inertial sensors and barometer warm up from power-on, with a time constant of 300 "
        "s; the bias of the barometer changes by the coefficient of a data sheet, the others by assumed ones. 20 is "
        "usual for a small aircraft (assumed).",
    )
    instability: Number = Field(
        default=0.0,
        ge=0,
        le=100,
        description="Scale factor of the biases of inertial sensors that wander during a run: 1 is 10 deg/h and 0.1 mg "
        "over 100 s (assumed).",
    )
    gnss: Number = Field(
        default=1.0,
        ge=0,
        le=100,
        description="Scale factor of the slow error of satellite fixes and of their velocity error, which the receiver "
        "does not claim.",
    )


class Record(Model):
    """What a run keeps, and at which rates."""

    level: Literal["full", "study", "summary"] = Field(
        default="full",
        description="Which tables are kept: all (full); all but frames, payloads, receptions and telemetry, with "
        "features in their place (study); only decisions, events and alerts (summary). The flight and its fingerprint "
        "are the same.",
    )

    truth_hz: Number = Field(
        default=10.0, ge=0, le=400, description="Rows of truth per aircraft and second; 0 records none."
    )
    sensors_hz: Number = Field(
        default=5.0, ge=0, le=400, description="Rows of sensors per aircraft and second; 0 records none."
    )
    features_hz: Number = Field(
        default=1.0,
        gt=0,
        le=400,
        description="Rows of features per direction of a link and second, at level study.",
    )
    csv: bool = Field(
        default=False,
        description="Whether the run ends with a CSV file and tlogs of each operator; only at level full. `skyrange "
        "export --csv --tlog` writes them later.",
    )


OnDeath = Literal["stop", "continue", "restart"]


class Live(Model):
    """Settings that only `skyrange live` uses. It also uses `hosts`."""

    on_death: OnDeath = Field(
        default="stop",
        description="Reaction to the death of a process: stop the range, continue without the process, or restart it, "
        "at most three times. If the process of the world dies, the range always stops.",
    )


def _origin(value: Any) -> Any:
    """(lat, lon) or (lat, lon, alt_msl_m) as an Origin's keys."""
    value = items(value)
    if isinstance(value, (list, tuple)) and len(value) in (2, 3):
        return dict(zip(("lat", "lon", "alt_msl_m"), value, strict=False))
    return value


def _utc(moment: datetime) -> datetime:
    """`moment` in UTC; a moment without a time zone is UTC."""
    if not 1970 <= moment.year < 2100:
        raise wrong(moment.isoformat(), "a date from 1970 to 2099")
    return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)


class Scenario(Model):
    """A whole scenario. A built one has every id, colour and system id filled in, and vehicles instead of fleets."""

    name: str = Field(
        default="scenario", min_length=1, max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9 ._-]*$",
        description="Name of the run; its folder has this name by default.",
    )  # fmt: skip
    seed: Whole = Field(
        default=1,
        ge=0,
        le=2**63 - 1,
        description="Seed of all random numbers of the run; the same seed gives the same run.",
    )
    duration_s: Number = Field(
        default=300.0,
        ge=0.001,
        le=31_536_000,
        description="Simulated duration of the run in seconds. The run does not end earlier, even if all missions "
        "are complete.",
    )
    start_utc: Annotated[datetime, Strict(), AfterValidator(_utc)] = Field(
        default=datetime(2026, 1, 1, 12, tzinfo=UTC),
        description="Date and time at simulated time 0; UTC unless it has a time zone.",
    )
    origin: Annotated[Origin, BeforeValidator(_origin, json_schema_input_type=Origin | list[float])] = Field(
        description="Origin of all coordinates; short form: [lat, lon] or [lat, lon, alt_msl_m]."
    )
    city: City | None = Field(default=None, description="Buildings; default: none.")
    wind: Wind = Field(default_factory=Wind, description="Wind; default: none.")
    sensors: Sensors = Field(default_factory=Sensors, description="Errors of the aircraft's sensors.")
    record: Record = Field(default_factory=Record, description="Recording rates.")
    autopilots: Autopilots = Field(
        default_factory=Autopilots, description="Deadlines and options of autopilots that are separate programs."
    )
    radio: Radio | None = Field(
        default=None,
        description="Radio medium of Remote ID, over which aircraft broadcast and receive each other; default: none.",
    )
    optics: Optics | None = Field(
        default=None,
        description="Weather and surfaces as LiDARs and depth cameras see them; default: the defaults of all keys.",
    )
    links: tuple[Link, ...] = Field(
        default=(), description="Changes to channels of links; a later rule overrides an earlier one."
    )
    processing: tuple[Processing, ...] = Field(
        default=(), description="Limits of what endpoints process; default: none."
    )
    hosts: Hosts = Field(default_factory=dict)
    live: Live = Field(default_factory=Live, description="Settings of a live range.")
    operators: tuple[Operator, ...] = Field(description="Operators, at least one.")
    approvals: dict[str, dict[str, Any]] = Field(
        default_factory=dict,
        description="Parameters of approval services, by kind, such as approvals.authority. One service of a kind "
        "serves all operators that use the kind. Default: the defaults of each kind.",
    )
    constraints: tuple[ConstraintTable, ...] = Field(
        default=(), description="Areas that are closed to flight; default: none."
    )
    attacks: tuple[AttackTable, ...] = Field(default=(), description="Attacks; default: none.")
    faults: tuple[FaultTable, ...] = Field(default=(), description="Benign faults; default: none.")
    defences: tuple[DefenceTable, ...] = Field(default=(), description="Defences, in order; default: none.")
    detectors: tuple[DetectorTable, ...] = Field(default=(), description="Detectors; default: none.")
    manual_acts: tuple[ManualActTable, ...] = Field(
        default=(), description="Starts and stops by hand, as in a run in which they were done; default: none."
    )

    @classmethod
    def from_file(
        cls,
        name_or_file: str | PathLike[str],
        changes: Iterable[str] = (),
        *,
        seed: int | None = None,
        buildings: str | PathLike[str] | None = None,
    ) -> Scenario:
        """The shipped scenario of this name, or the scenario in this TOML file.

        `buildings` is a file that replaces its city and moves its origin. `changes` are `path=value`, as for `--set`,
        and are applied next; `seed` is applied last. Raises `InputError` with all problems.
        """
        from skyrange.scenario.shipped import load

        return load(
            fspath(name_or_file), changes, seed=seed, buildings=None if buildings is None else fspath(buildings)
        )

    @classmethod
    def from_toml(cls, text: str, changes: Iterable[str] = (), *, folder: str | PathLike[str] = ".") -> Scenario:
        """The scenario in a text of TOML; the names of files in it are relative to `folder`.

        Raises `InputError` with all problems, also for a path, which `from_file` takes.
        """
        from skyrange.scenario.toml_files import load_text

        if not isinstance(text, str):
            raise InputError.one("scenario", "text", str(text), "TOML", "Scenario.from_file reads a file.")
        return load_text(text, folder=fspath(folder), overrides=changes)

    @field_validator("approvals")
    @classmethod
    def _of_their_kinds(cls, approvals: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
        """The parameters, checked and completed with defaults."""
        offered = kinds(APPROVALS)
        unknown = [kind for kind in approvals if kind not in offered]
        if unknown:
            raise refuse(*(Problem(kind, kind, "an approval service", nearest(kind, offered)) for kind in unknown))
        return {kind: normalized(ApprovalPlugin.find(kind), given, kind) for kind, given in approvals.items()}

    @model_validator(mode="after")
    def _as_a_whole(self) -> Scenario:
        object.__setattr__(self, "operators", name_operators(self.operators))
        problems = cross_check(self)
        if problems:
            raise refuse(*problems)
        for kind in sorted({operator.approval for operator in self.operators} - self.approvals.keys()):
            checked(ApprovalPlugin.find(kind), {}, f"approvals.{kind}")  # a kind may have required parameters
        return self

    @classmethod
    def cross_check(cls, data: Any) -> list[Problem]:
        """The problems that the cross-checks find in `data`, a table from which a scenario is built."""
        return cross_check(data)

    @property
    def epoch(self) -> Epoch:
        """The UTC time at simulated time 0."""
        return Epoch.from_datetime(self.start_utc)

    @property
    def fleet(self) -> Iterator[tuple[Operator, Vehicle]]:
        """Every vehicle with its operator, in order."""
        return ((operator, vehicle) for operator in self.operators for vehicle in operator.vehicles)

    @property
    def acts(self) -> tuple[ActTable, ...]:
        """Every attack and every fault, in order."""
        return (*self.attacks, *self.faults)

    @property
    def acting(self) -> dict[str, ActTable | DefenceTable]:
        """Every attack, fault and defence by its id, in order."""
        tables: tuple[ActTable | DefenceTable, ...] = (*self.acts, *self.defences)
        return {table.id: table for table in tables}

    def is_started(self, act: ActTable | DefenceTable) -> bool:
        """Whether an attack, fault or defence starts by itself, or `manual_acts` start it."""
        return not act.manual or any((one.act, one.action) == (act.id, "start") for one in self.manual_acts)

    def channel(self, name: str, default: Channel) -> Channel:
        """The channel of the link `name`: `default` with the changes of every rule in `links` that matches."""
        return resolve_channel(self.links, name, default)

    def over_air(self, name: str) -> AirParams | None:
        """The parameters of the channel of the link `name` over the air; `None` for a fixed channel."""
        return resolve_over_air(self.links, name)

    def approval_params(self, kind: str) -> Params:
        """The parameters of an approval service as its plugin's own model."""
        return params_of(ApprovalPlugin.find(kind), self.approvals.get(kind, {}), f"approvals.{kind}")

    def data(self) -> dict[str, Any]:
        """The scenario as plain data, without None and with lists for tuples; `toml_reader.load_data` reads it back."""
        return {key: _listed(value) for key, value in self.model_dump(exclude_none=True).items()}


def _listed(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _listed(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_listed(item) for item in value]
    return value


_OF_NUMBERS = {"ge": "minimum", "gt": "exclusiveMinimum", "le": "maximum", "lt": "exclusiveMaximum"}
_BOUNDS = {
    "number": _OF_NUMBERS,
    "integer": _OF_NUMBERS,
    "array": {"minLength": "minItems", "maxLength": "maxItems"},
    "object": {"minLength": "minProperties", "maxLength": "maxProperties"},
}
"""By type: pydantic's names of bounds where validators come first, and those of JSON Schema."""


def json_schema() -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of a scenario; the description of each property gives meaning and unit."""
    schema = Scenario.model_json_schema(mode="validation")
    models = schema["$defs"]
    describe_by_kind(schema, models["AttackTable"], ATTACKS)
    describe_by_kind(schema, models["FaultTable"], FAULTS)
    describe_by_kind(schema, models["DefenceTable"], DEFENCES)
    describe_by_kind(schema, models["DetectorTable"], DETECTORS)
    describe_by_kind(schema, models["Avoidance"], AVOIDANCE)
    describe_by_kind(schema, models["Radio"], MEDIA, "engine")
    options = models["Autopilots"]["properties"]["options"]
    for group, table in ((APPROVALS, schema["properties"]["approvals"]), (AUTOPILOTS, options)):
        table["properties"] = {kind: describe(schema, group, kind) for kind in kinds(group)}
        table["additionalProperties"] = False
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **_bounded(schema)}


def _bounded(part: Any) -> Any:
    """The schema with JSON Schema's names for bounds."""
    if isinstance(part, list):
        return [_bounded(item) for item in part]
    if not isinstance(part, dict):
        return part
    kind = part.get("type")
    names = _BOUNDS.get(kind, {}) if isinstance(kind, str) else {}
    return {names.get(key, key): _bounded(value) for key, value in part.items()}
