"""Vehicles of a scenario, fleets of vehicles that differ only in start and departure, and options of autopilots."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, ValidationError, model_validator

from skyrange.contracts.params import Params as PluginParams
from skyrange.contracts.plugins.registry import AUTOPILOTS, kinds
from skyrange.core import elementary_python
from skyrange.core.errors import Problem, nearest
from skyrange.scenario.model.base import Id, Model, Number, Whole, items, refuse, wrong
from skyrange.scenario.model.landing import AnyLanding
from skyrange.scenario.model.optics import MAX_SENSORS, OpticalSensor
from skyrange.scenario.model.plan import Plan
from skyrange.scenario.model.radio import AnyAvoidance, RemoteId
from skyrange.scenario.validation.error_messages import input_error
from skyrange.scenario.validation.plugin_params import checked, known, params_of
from skyrange.vehicle.contract import AutopilotPlugin
from skyrange.world.airframes import AIRFRAMES

MAX_SYSTEM_ID = 250
"""Largest number of aircraft in one MAVLink network: system ids have 8 bits, 0 is broadcast, and 251…255 are left to
ground stations."""
MAX_NETWORK = 255
"""Highest network number of one operator: 256 networks hold 64,000 aircraft."""
REACH_M = 100_000
"""Largest distance of a start from the origin, east-west or north-south."""
LATEST_S = 86_400
"""Latest departure."""


def _known_airframe(name: str) -> str:
    if name not in AIRFRAMES:
        raise wrong(name, "the name of an airframe", nearest(name, AIRFRAMES))
    return name


def _start(value: Any) -> Any:
    """(east, north) or (east, north, heading) as a Start's keys."""
    value = items(value)
    if isinstance(value, (list, tuple)) and len(value) in (2, 3):
        return dict(zip(("east_m", "north_m", "heading_deg"), value, strict=False))
    return value


class Start(Model):
    """Start of an aircraft: its position on the ground and its heading."""

    east_m: Number = Field(default=0.0, ge=-REACH_M, le=REACH_M, description="Metres east of the origin.")
    north_m: Number = Field(default=0.0, ge=-REACH_M, le=REACH_M, description="Metres north of the origin.")
    heading_deg: Number = Field(
        default=0.0, ge=-180, le=360, description="Direction of the nose, in degrees clockwise from true north."
    )


Autopilot = Annotated[
    str,
    known(AUTOPILOTS, "an autopilot"),
    Field(description="Kind of autopilot, a plugin of skyrange.autopilots."),
]
AirframeName = Annotated[
    str, AfterValidator(_known_airframe), Field(description="Airframe, by its name in the airframe table.")
]
Placing = Annotated[
    Literal["exact", "clear"],
    Field(
        description="exact: use the start as it is; clear: shift start and plan together to the nearest place where "
        "both keep clear of buildings and of the paths of other aircraft."
    ),
]


_CONVERT = "awk -F'[,[:space:]]+' '/^[A-Z]/ {print $1, \"=\", $2}' FILE"


def _refuse_param_file(value: Any) -> Any:
    name = value.get("file") if isinstance(value, Mapping) else value
    if isinstance(name, str):
        hint = f"Write its lines into the table; `{_CONVERT}` converts a .param file."
        raise wrong(name, "a table of parameters, such as { FENCE_ENABLE = 1 }", hint)
    return value


Params = Annotated[
    dict[Annotated[str, Field(pattern=r"^[A-Z][A-Z0-9_]{0,15}$")], Number],
    BeforeValidator(_refuse_param_file, json_schema_input_type=dict[str, float]),
]
Departs = Annotated[Number, Field(ge=0, le=LATEST_S, description="Earliest simulated time of take-off, in seconds.")]
Charge = Annotated[Number, Field(ge=0, le=1, description="Initial charge of the battery, from 0 (empty) to 1 (full).")]
Broadcasts = Annotated[
    RemoteId | None,
    Field(
        description="Remote ID broadcasts; they need a radio medium. Default: the operator's table, else the defaults "
        "of all keys."
    ),
]
Avoids = Annotated[
    AnyAvoidance | None,
    Field(
        description="Avoidance of other aircraft; short form: the name of the kind. Default: that of the operator, "
        "else none."
    ),
]
OpticalSensors = Annotated[
    tuple[OpticalSensor, ...],
    Field(max_length=MAX_SENSORS, description="LiDARs and depth cameras; default: none."),
]
_Coordinate = Annotated[Number, Field(ge=-REACH_M, le=REACH_M)]
AnyStation = Annotated[
    tuple[_Coordinate, _Coordinate] | None,
    Field(
        description="Position of its control station, [east_m, north_m] in metres from the origin; default: the start "
        "of its first aircraft."
    ),
]
AnyStart = Annotated[Start, BeforeValidator(_start, json_schema_input_type=Start | list[float])]


def refuse_anchored(part: Any) -> None:
    """Raise if `placing` would shift a mission that is anchored at the coordinates in its file."""
    if part.placing == "clear" and part.plan.anchor == "file":
        raise wrong(
            "clear",
            "exact, because the mission file is anchored at its own coordinates",
            'Set plan.anchor = "start", so that the mission can be shifted.',
            where="placing",
        )


class Vehicle(Model):
    """One aircraft."""

    id: Id = Field(
        default="",
        description="Name, unique within the operator; default: the operator's initial and a number, such as b1.",
        json_schema_extra={"default": None},
    )
    autopilot: Autopilot = "builtin"
    airframe: AirframeName = "iris"
    start: AnyStart = Field(
        default_factory=Start,
        description="Start position; short form: [east_m, north_m] or [east_m, north_m, heading_deg].",
    )
    placing: Placing = "exact"
    plan: Plan = Field(description="Plan to fly.")
    params: Params = Field(
        default_factory=dict,
        description="Autopilot parameters, with ArduPilot's names and units; they override the operator's.",
    )
    depart_s: Departs = 0.0
    charge: Charge = 1.0
    remote_id: Broadcasts = None
    avoidance: Avoids = None
    sensors: OpticalSensors = ()
    landing: AnyLanding = None
    network: Whole = Field(
        default=-1,
        ge=0,
        le=MAX_NETWORK,
        description="Number of its MAVLink network within the operator; default: the first with a free system id.",
        json_schema_extra={"default": None},
    )
    system_id: Whole = Field(
        default=0,
        ge=1,
        le=MAX_SYSTEM_ID,
        description="MAVLink system id, unique within the network; default: the lowest free one.",
        json_schema_extra={"default": None},
    )


class Fleet(Model):
    """Many aircraft that fly the same plan, each from its own start. A built scenario has them as vehicles."""

    id: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,25}$")] = Field(
        default="",
        description="First part of the ids of its aircraft, before a number; default: the operator's initial.",
        json_schema_extra={"default": None},
    )
    count: Whole = Field(ge=1, le=10_000, description="Number of aircraft.")
    autopilot: Autopilot = "builtin"
    airframe: AirframeName = "iris"
    start: AnyStart = Field(
        default_factory=Start,
        description="Start of the first aircraft. The others start around it, nearest first; a larger count adds "
        "aircraft and moves none.",
    )
    spacing_m: tuple[Annotated[Number, Field(gt=0, le=10_000)], Annotated[Number, Field(gt=0, le=10_000)]] = Field(
        default=(20.0, 20.0), description="Distances between neighbours in metres, [east-west, north-south]."
    )
    placing: Placing = "exact"
    plan: Plan = Field(description="Plan of each aircraft; squares and paths are relative to its own start.")
    params: Params = Field(
        default_factory=dict,
        description="Autopilot parameters, with ArduPilot's names and units; they override the operator's.",
    )
    depart_s: Departs = 0.0
    charge: Charge = 1.0
    remote_id: Broadcasts = None
    avoidance: Avoids = None
    sensors: OpticalSensors = ()
    landing: AnyLanding = None
    every_s: Number = Field(
        default=0.0,
        ge=0,
        le=3600,
        description="Time between two departures in seconds; the aircraft depart in the order of their ids.",
    )

    @model_validator(mode="after")
    def _within_bounds(self) -> Fleet:
        refuse_anchored(self)
        problems = []
        last_s = self.depart_s + self.every_s * (self.count - 1)
        if last_s > LATEST_S:
            value = f"the last aircraft departs at {last_s:g} s"
            problems.append(Problem("every_s", value, f"at most {LATEST_S} s", "Reduce every_s or count."))
        far_m = max(max(abs(start.east_m), abs(start.north_m)) for start in self.starts())
        if far_m > REACH_M:
            value = f"the farthest aircraft starts {far_m:g} m from the origin"
            problems.append(Problem("spacing_m", value, f"at most {REACH_M} m", "Reduce spacing_m or count."))
        if problems:
            raise refuse(*problems)
        return self

    def starts(self) -> list[Start]:
        """The starts of its aircraft: a lattice around `start`, nearest first, equal distances by angle from east."""
        wide_m, deep_m = self.spacing_m
        # A circle of either radius around the first start contains at least `count` points of the lattice. The first
        # radius is that of a circle with the area of `count` cells, plus the diagonal of a cell; the second contains
        # `count` points in one line. The smaller one is used: the first is far too large for a narrow lattice, the
        # second for a square one.
        cells_m = math.sqrt(self.count * wide_m * deep_m / math.pi) + elementary_python.hypot(wide_m, deep_m)
        line_m = (self.count // 2 + 1) * min(wide_m, deep_m)
        radius_m = min(cells_m, line_m)
        columns, rows = int(radius_m / wide_m), int(radius_m / deep_m)
        places = [
            (i * wide_m, j * deep_m)
            for i in range(-columns, columns + 1)
            for j in range(-rows, rows + 1)
            if elementary_python.hypot(i * wide_m, j * deep_m) <= radius_m
        ]
        digits = 6 + max(
            0, math.ceil(-elementary_python.log10(min(wide_m, deep_m)))
        )  # sums of equal distances differ by rounding
        places.sort(
            key=lambda place: (
                round(elementary_python.hypot(*place), digits),
                elementary_python.atan2(place[1], place[0]),
            )
        )
        first = self.start
        return [
            first.model_copy(update={"east_m": first.east_m + east_m, "north_m": first.north_m + north_m})
            for east_m, north_m in places[: self.count]
        ]

    def vehicles(self) -> list[Vehicle]:
        """Its aircraft as vehicles, without ids."""
        keys = ("autopilot", "airframe", "placing", "plan", "charge", "remote_id", "avoidance", "sensors", "landing")
        shared = {key: getattr(self, key) for key in keys}
        return [
            Vehicle.model_construct(
                **shared, start=start, params=dict(self.params), depart_s=self.depart_s + self.every_s * number
            )
            for number, start in enumerate(self.starts())
        ]


class Autopilots(Model):
    """Settings of autopilots that are separate programs."""

    on_silent: Literal["stop", "continue"] = Field(
        default="stop",
        description="Reaction to an autopilot that ends or does not answer in time: stop the run, or continue "
        "without it; the motors of a simulated aircraft then stop.",
    )
    on_unready: Literal["fail", "wait"] = Field(
        default="fail",
        description="Reaction to an autopilot that is not ready at time 0: fail ends the run, wait starts the run and "
        "lets the autopilot join later.",
    )
    deadline_s: Number = Field(
        default=5.0, gt=0, le=3600, description="Wall time in seconds within which an autopilot must answer each tick."
    )
    options: dict[str, dict[str, Any]] = Field(
        default_factory=dict, description="Options of each kind of autopilot, such as options.ardupilot."
    )

    @model_validator(mode="after")
    def _of_their_kinds(self) -> Autopilots:
        for kind in self.options:
            if kind not in kinds(AUTOPILOTS):
                raise refuse(Problem(f"options.{kind}", kind, "an autopilot", nearest(kind, kinds(AUTOPILOTS))))
            checked(AutopilotPlugin.find(kind), self.options[kind], f"options.{kind}")
        return self

    def with_options(self, kind: str, given: Mapping[str, Any], who: str) -> Autopilots:
        """A copy with the options `given` set for `kind`. Raises `InputError` for `who` if they are invalid."""
        data = self.model_dump() | {"options": {**self.options, kind: {**self.options.get(kind, {}), **given}}}
        try:
            return Autopilots.model_validate(data)
        except ValidationError as error:
            raise input_error(who, error, Autopilots, data) from None

    def params_of(self, kind: str) -> PluginParams:
        """The options of a kind as its plugin's own model. Raises InputError if a required option is missing."""
        return params_of(AutopilotPlugin.find(kind), self.options.get(kind, {}), f"autopilots.options.{kind}")
