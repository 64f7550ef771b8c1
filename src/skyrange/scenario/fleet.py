"""Who flies what, from where? Vehicles and the operators that own them, and the ids they get unless named."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field

from skyrange.agent.plugins import APPROVALS, AUTOPILOTS, kinds
from skyrange.core.errors import nearest
from skyrange.scenario.base import Id, Model, Number, Whole, items, wrong
from skyrange.scenario.plan import Plan
from skyrange.world.airframes import AIRFRAMES

MAX_VEHICLES = 250
"""Aircraft of one operator: MAVLink's 8-bit system id, less 0 (broadcast) and 251…255 for ground stations."""

COLORS = (
    "blue", "green", "red", "orange", "purple", "teal", "magenta", "brown", "gold", "navy", "olive", "gray", "black",
)  # fmt: skip
"""Colours by name; the first ones go, in this order, to operators that choose none."""


def _known(group: str, what: str) -> AfterValidator:
    def check(kind: str) -> str:
        offered = kinds(group)
        if kind not in offered:
            raise wrong(kind, f"{what} that is installed", nearest(kind, offered))
        return kind

    return AfterValidator(check)


def _known_airframe(name: str) -> str:
    if name not in AIRFRAMES:
        raise wrong(name, "an airframe of the table", nearest(name, AIRFRAMES))
    return name


def _known_color(color: str) -> str:
    if color not in COLORS and not (len(color) == 7 and color[0] == "#" and _is_hex(color[1:])):
        raise wrong(color, "a colour's name or '#rrggbb'", nearest(color, COLORS))
    return color


def _is_hex(text: str) -> bool:
    return all(char in "0123456789abcdefABCDEF" for char in text)


def _start(value: Any) -> Any:
    """(east, north) or (east, north, heading) as a Start's keys."""
    value = items(value)
    if isinstance(value, (list, tuple)) and len(value) in (2, 3):
        return dict(zip(("east_m", "north_m", "heading_deg"), value, strict=False))
    return value


class Start(Model):
    """Where an aircraft stands on the ground at first, from the origin."""

    east_m: Number = Field(default=0.0, ge=-100_000, le=100_000, description="Metres east of the origin.")
    north_m: Number = Field(default=0.0, ge=-100_000, le=100_000, description="Metres north of the origin.")
    heading_deg: Number = Field(
        default=0.0, ge=-180, le=360, description="Where the nose points: degrees clockwise from true north."
    )


class Vehicle(Model):
    """One aircraft."""

    id: Id = Field(
        default="",
        description="Name, unique within the operator; default: the operator's initial and a number, such as b1.",
        json_schema_extra={"default": None},
    )
    autopilot: Annotated[str, _known(AUTOPILOTS, "an autopilot")] = Field(
        default="builtin", description="Kind of autopilot, a plugin of skyrange.autopilots."
    )
    airframe: Annotated[str, AfterValidator(_known_airframe)] = Field(
        default="iris", description="Name of a row of the airframe table."
    )
    start: Annotated[Start, BeforeValidator(_start, json_schema_input_type=Start | list[float])] = Field(
        default_factory=Start, description="Where it stands at first; in short [east_m, north_m] or with heading_deg."
    )
    placing: Literal["exact", "clear"] = Field(
        default="exact",
        description="exact: start as given; clear: shift start and plan together to the nearest place where neither "
        "meets a building.",
    )
    plan: Plan = Field(description="What it flies.")
    params: dict[Annotated[str, Field(pattern=r"^[A-Z][A-Z0-9_]{0,15}$")], Number] = Field(
        default_factory=dict, description="Autopilot parameters to set, by ArduPilot's names and in its units."
    )
    depart_s: Number = Field(
        default=0.0, ge=0, le=86_400, description="Not to take off before this simulated time, in seconds."
    )
    system_id: Whole = Field(
        default=0,
        ge=1,
        le=MAX_VEHICLES,
        description="MAVLink system id, unique within the operator; default: the lowest free one, in order.",
        json_schema_extra={"default": None},
    )


class Operator(Model):
    """Who owns a fleet and flies it from one ground station."""

    id: Id = Field(
        default="",
        description="Name, unique in the scenario; default: its colour's name, else op1, op2…",
        json_schema_extra={"default": None},
    )
    color: Annotated[str, AfterValidator(_known_color)] = Field(
        default="",
        description="Colour in figures: a name or '#rrggbb'; default: its id if that names one, else the next free.",
        json_schema_extra={"default": None},
    )
    approval: Annotated[str, _known(APPROVALS, "an approval service")] = Field(
        default="approve-all", description="Who approves its flight plans, a plugin of skyrange.approvals."
    )
    vehicles: tuple[Vehicle, ...] = Field(description="Its aircraft, one or more.")


def operator_names(given: Iterable[tuple[str, str]]) -> list[tuple[str, str]]:
    """(id, colour) of every operator, with "" replaced by a name or colour that nobody took."""
    given = list(given)
    ids = {name for name, _ in given}
    colors = {color for _, color in given} | {name for name, _ in given if name in COLORS}
    named = []
    for number, (name, color) in enumerate(given, start=1):
        if not name:
            name = color if color in COLORS and color not in ids else _free("op", number, ids)
            ids.add(name)
        if not color:
            free = [one for one in COLORS if one not in colors]
            color = name if name in COLORS else (free or COLORS)[0]
            colors.add(color)
        named.append((name, color))
    return named


def vehicle_names(operator: str, given: Sequence[str]) -> list[str]:
    """The ids of an operator's vehicles, with "" replaced by its initial and a number that nobody took."""
    taken = set(given)
    named = []
    for number, name in enumerate(given, start=1):
        if not name:
            name = _free(operator[0].lower(), number, taken)
            taken.add(name)
        named.append(name)
    return named


def system_ids(given: Sequence[int]) -> list[int]:
    """System ids with every 0 replaced by the lowest that is free, in order."""
    taken = set(given)
    numbered, candidate = [], 1
    for number in given:
        if not number:
            while candidate in taken:
                candidate += 1
            taken.add(candidate)
            number = candidate
        numbered.append(number)
    return numbered


def named(operators: Sequence[Operator]) -> tuple[Operator, ...]:
    """The operators with every id, colour and system id filled in."""
    names = operator_names((operator.id, operator.color) for operator in operators)
    return tuple(
        operator.model_copy(update={"id": name, "color": color, "vehicles": _named_vehicles(name, operator.vehicles)})
        for operator, (name, color) in zip(operators, names, strict=True)
    )


def _named_vehicles(operator: str, vehicles: Sequence[Vehicle]) -> tuple[Vehicle, ...]:
    ids = vehicle_names(operator, [vehicle.id for vehicle in vehicles])
    numbers = system_ids([vehicle.system_id for vehicle in vehicles])
    return tuple(
        vehicle.model_copy(update={"id": name, "system_id": number})
        for vehicle, name, number in zip(vehicles, ids, numbers, strict=True)
    )


def _free(stem: str, number: int, taken: set[str]) -> str:
    """`stem` with `number`, or with the first number after it that makes it free."""
    while f"{stem}{number}" in taken:
        number += 1
    return f"{stem}{number}"
