"""Vehicles of a scenario, one by one, and fleets of many that differ only in place and time."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from skyrange.contracts.plugins import AUTOPILOTS
from skyrange.core.errors import Problem, nearest
from skyrange.scenario.model.base import Id, Model, Number, Whole, items, refuse, wrong
from skyrange.scenario.model.plan import Plan
from skyrange.scenario.model.radio import AnyAvoidance, RemoteId
from skyrange.scenario.validation.plugin_params import known
from skyrange.world.airframes import AIRFRAMES

MAX_SYSTEM_ID = 250
"""Aircraft of one MAVLink network: its 8-bit system id, less 0 (broadcast) and 251…255 for ground stations."""
MAX_NETWORK = 255
"""Networks of one operator, less one; 64,000 aircraft are enough."""
REACH_M = 100_000
"""How far from the origin an aircraft may start."""
LATEST_S = 86_400
"""How late an aircraft may depart."""


def _known_airframe(name: str) -> str:
    if name not in AIRFRAMES:
        raise wrong(name, "an airframe of the table", nearest(name, AIRFRAMES))
    return name


def _start(value: Any) -> Any:
    """(east, north) or (east, north, heading) as a Start's keys."""
    value = items(value)
    if isinstance(value, (list, tuple)) and len(value) in (2, 3):
        return dict(zip(("east_m", "north_m", "heading_deg"), value, strict=False))
    return value


class Start(Model):
    """Where an aircraft stands on the ground at first, from the origin."""

    east_m: Number = Field(default=0.0, ge=-REACH_M, le=REACH_M, description="Metres east of the origin.")
    north_m: Number = Field(default=0.0, ge=-REACH_M, le=REACH_M, description="Metres north of the origin.")
    heading_deg: Number = Field(
        default=0.0, ge=-180, le=360, description="Where the nose points: degrees clockwise from true north."
    )


Autopilot = Annotated[
    str,
    known(AUTOPILOTS, "an autopilot"),
    Field(description="Kind of autopilot, a plugin of skyrange.autopilots."),
]
AirframeName = Annotated[
    str, AfterValidator(_known_airframe), Field(description="Name of a row of the airframe table.")
]
Placing = Annotated[
    Literal["exact", "clear"],
    Field(
        description="exact: start as given; clear: shift start and plan together to the nearest place where neither "
        "meets a building or comes near another aircraft's path."
    ),
]
Params = dict[Annotated[str, Field(pattern=r"^[A-Z][A-Z0-9_]{0,15}$")], Number]
Departs = Annotated[
    Number, Field(ge=0, le=LATEST_S, description="Not to take off before this simulated time, in seconds.")
]
Charge = Annotated[Number, Field(ge=0, le=1, description="How full its battery is at first, from 0 to 1.")]
Broadcasts = Annotated[
    RemoteId | None,
    Field(description="What it broadcasts; default: its operator's, else the usual, where there is a radio medium."),
]
Avoids = Annotated[
    AnyAvoidance | None, Field(description="How it keeps from others that it hears; in short the kind; default: none.")
]
AnyStation = Annotated[
    tuple[Number, Number] | None,
    Field(
        description="Where its control station is: [east_m, north_m] from the origin; default: its first "
        "aircraft's start."
    ),
]
AnyStart = Annotated[Start, BeforeValidator(_start, json_schema_input_type=Start | list[float])]


def refuse_anchored(part: Any) -> None:
    """Raise if a mission that stays where it was drawn shall be shifted."""
    if part.placing == "clear" and part.plan.anchor == "file":
        raise wrong(
            "clear",
            "exact, because the mission file is anchored where it was drawn",
            'Set plan.anchor = "start" to let it be shifted.',
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
        default_factory=Start, description="Where it stands at first; in short [east_m, north_m] or with heading_deg."
    )
    placing: Placing = "exact"
    plan: Plan = Field(description="What it flies.")
    params: Params = Field(
        default_factory=dict,
        description="Autopilot parameters to set, by ArduPilot's names and in its units; over the operator's.",
    )
    depart_s: Departs = 0.0
    charge: Charge = 1.0
    remote_id: Broadcasts = None
    avoidance: Avoids = None
    network: Whole = Field(
        default=-1,
        ge=0,
        le=MAX_NETWORK,
        description="The operator's MAVLink network that it is in; default: the first with a system id left.",
        json_schema_extra={"default": None},
    )
    system_id: Whole = Field(
        default=0,
        ge=1,
        le=MAX_SYSTEM_ID,
        description="MAVLink system id, unique within the network; default: the lowest free one, in order.",
        json_schema_extra={"default": None},
    )


class Fleet(Model):
    """Many aircraft that fly one plan, each from a place of its own; once built they are vehicles."""

    id: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,25}$")] = Field(
        default="",
        description="What their ids begin with, a number follows; default: the operator's initial.",
        json_schema_extra={"default": None},
    )
    count: Whole = Field(ge=1, le=10_000, description="How many aircraft.")
    autopilot: Autopilot = "builtin"
    airframe: AirframeName = "iris"
    start: AnyStart = Field(
        default_factory=Start,
        description="Where the first stands; the others stand around it, nearest first, so that a greater count adds "
        "some and moves none.",
    )
    spacing_m: tuple[Annotated[Number, Field(gt=0, le=10_000)], Annotated[Number, Field(gt=0, le=10_000)]] = Field(
        default=(20.0, 20.0), description="Metres between neighbours, [east-west, north-south]."
    )
    placing: Placing = "exact"
    plan: Plan = Field(description="What each flies; squares and paths are relative to its own start.")
    params: Params = Field(
        default_factory=dict,
        description="Autopilot parameters to set, by ArduPilot's names and in its units; over the operator's.",
    )
    depart_s: Departs = 0.0
    charge: Charge = 1.0
    remote_id: Broadcasts = None
    avoidance: Avoids = None
    every_s: Number = Field(
        default=0.0, ge=0, le=3600, description="Seconds from one departure to the next, in the order of their ids."
    )

    @model_validator(mode="after")
    def _within_bounds(self) -> Fleet:
        refuse_anchored(self)
        faults = []
        last_s = self.depart_s + self.every_s * (self.count - 1)
        if last_s > LATEST_S:
            faults.append(Problem("every_s", f"the last departs at {last_s:g} s", f"at most {LATEST_S} s"))
        far_m = max(max(abs(start.east_m), abs(start.north_m)) for start in self.starts())
        if far_m > REACH_M:
            faults.append(Problem("spacing_m", f"the farthest starts {far_m:g} m away", f"at most {REACH_M} m"))
        if faults:
            raise refuse(*faults)
        return self

    def starts(self) -> list[Start]:
        """Where each starts: on a lattice about `start`, nearest first, equal distances by angle from east."""
        wide_m, deep_m = self.spacing_m
        # a circle of either radius around the first holds at least `count` places of the lattice: the one is a cell's
        # diagonal larger than the circle of `count` cells' area, the other has as many in one line. The first grows
        # without end against the cells of a narrow lattice, the second against those of a square one
        cells_m = math.sqrt(self.count * wide_m * deep_m / math.pi) + math.hypot(wide_m, deep_m)
        line_m = (self.count // 2 + 1) * min(wide_m, deep_m)
        radius_m = min(cells_m, line_m)
        columns, rows = int(radius_m / wide_m), int(radius_m / deep_m)
        places = [
            (i * wide_m, j * deep_m)
            for i in range(-columns, columns + 1)
            for j in range(-rows, rows + 1)
            if math.hypot(i * wide_m, j * deep_m) <= radius_m
        ]
        digits = 6 + max(0, math.ceil(-math.log10(min(wide_m, deep_m))))  # equal but for what the sums were rounded
        places.sort(key=lambda place: (round(math.hypot(*place), digits), math.atan2(place[1], place[0])))
        first = self.start
        return [
            first.model_copy(update={"east_m": first.east_m + east_m, "north_m": first.north_m + north_m})
            for east_m, north_m in places[: self.count]
        ]

    def vehicles(self) -> list[Vehicle]:
        """Its aircraft, without ids."""
        keys = ("autopilot", "airframe", "placing", "plan", "charge", "remote_id", "avoidance")
        shared = {key: getattr(self, key) for key in keys}
        return [
            Vehicle.model_construct(
                **shared, start=start, params=dict(self.params), depart_s=self.depart_s + self.every_s * number
            )
            for number, start in enumerate(self.starts())
        ]
