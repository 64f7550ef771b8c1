"""Operators of a scenario, with ids, colours and MAVLink addresses filled in where none are given."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field

from skyrange.contracts.plugins import APPROVALS
from skyrange.core.errors import nearest
from skyrange.scenario.model.base import Id, Model, wrong
from skyrange.scenario.model.fleet import MAX_SYSTEM_ID, AnyStation, Avoids, Broadcasts, Fleet, Params, Vehicle
from skyrange.scenario.validation.plugin_params import known

COLORS = (
    "blue", "green", "red", "orange", "purple", "teal", "magenta", "brown", "gold", "navy", "olive", "gray", "black",
)  # fmt: skip
"""Colours by name; the first ones go, in this order, to operators that choose none."""
Signing = Literal["off", "on", "wrong-key"]


def _known_color(color: str) -> str:
    if color not in COLORS and not (len(color) == 7 and color[0] == "#" and _is_hex(color[1:])):
        raise wrong(color, "a colour's name or '#rrggbb'", nearest(color, COLORS))
    return color


def _is_hex(text: str) -> bool:
    return all(char in "0123456789abcdefABCDEF" for char in text)


def _known_streams(name: str) -> str:
    from skyrange.gcs.telemetry.streams import (
        PROFILES,  # what it needs is slow to import, and the default needs no check
    )

    if name not in PROFILES:
        raise wrong(name, " or ".join(map(repr, PROFILES)), nearest(name, PROFILES))
    return name


class Operator(Model):
    """Who owns aircraft and flies them from one ground station."""

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
    approval: Annotated[str, known(APPROVALS, "an approval service")] = Field(
        default="approve-all", description="Who approves its flight plans, a plugin of skyrange.approvals."
    )
    streams: Annotated[str, AfterValidator(_known_streams)] = Field(
        default="light",
        description="Which telemetry its ground station asks for: the name of a profile.",
    )
    params: Params = Field(
        default_factory=dict, description="Autopilot parameters of all its aircraft, unless one sets its own."
    )
    signing: Signing = Field(
        default="off",
        description="MAVLink 2 signing between its ground station and its aircraft: off, on, or on with a ground "
        "station that holds another key than they do.",
    )
    station: AnyStation = None
    remote_id: Broadcasts = None
    avoidance: Avoids = None
    vehicles: tuple[Vehicle, ...] = Field(default=(), description="Its aircraft one by one.")
    fleets: tuple[Fleet, ...] = Field(default=(), description="Its aircraft by the dozen; they follow the vehicles.")


_HANDED_ON: dict[str, Any] = {"fleets": (), "params": {}, "remote_id": None, "avoidance": None}
"""What a built operator has no longer: its vehicles have it."""


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
    return _numbered(operator[0].lower(), given, set(given))


def assign_addresses(given: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """(network, system id) of an operator's vehicles, with -1 and 0 replaced by the lowest that are free, in order.

    A system id given without a network is one of network 0.
    """
    taken = {(max(network, 0), system_id) for network, system_id in given if system_id}
    candidates: dict[int, int] = {}
    at = 0
    out = []
    for network, system_id in given:
        if system_id:
            out.append((max(network, 0), system_id))
            continue
        chosen = at if network < 0 else network
        while True:
            candidate = candidates.get(chosen, 1)
            while (chosen, candidate) in taken:
                candidate += 1
            if candidate <= MAX_SYSTEM_ID or network >= 0:  # a network that is named may overflow: that is a fault
                break
            candidates[chosen] = candidate
            chosen = at = at + 1
        candidates[chosen] = candidate + 1
        out.append((chosen, candidate))
    return out


def name_operators(operators: Sequence[Operator]) -> tuple[Operator, ...]:
    """The operators with fleets as vehicles, shared params in each, and every id, colour and system id filled in."""
    names = operator_names((operator.id, operator.color) for operator in operators)
    return tuple(
        operator.model_copy(update={"id": name, "color": color, "vehicles": _vehicles(name, operator), **_HANDED_ON})
        for operator, (name, color) in zip(operators, names, strict=True)
    )


def _vehicles(name: str, operator: Operator) -> tuple[Vehicle, ...]:
    vehicles = list(operator.vehicles)
    ids = vehicle_names(name, [vehicle.id for vehicle in vehicles])
    for fleet in operator.fleets:
        vehicles += fleet.vehicles()
        ids += _numbered(fleet.id or name[0].lower(), [""] * fleet.count, set(ids), 1 if fleet.id else len(ids) + 1)
    where = assign_addresses([(vehicle.network, vehicle.system_id) for vehicle in vehicles])
    return tuple(
        vehicle.model_copy(
            update={
                "id": own,
                "network": network,
                "system_id": system_id,
                "params": {**operator.params, **vehicle.params},
                "remote_id": vehicle.remote_id or operator.remote_id,
                "avoidance": vehicle.avoidance or operator.avoidance,
            }
        )
        for vehicle, own, (network, system_id) in zip(vehicles, ids, where, strict=True)
    )


def _numbered(stem: str, given: Sequence[str], taken: set[str], first: int = 1) -> list[str]:
    named = []
    for number, name in enumerate(given, start=first):
        if not name:
            name = _free(stem, number, taken)
            taken.add(name)
        named.append(name)
    return named


def _free(stem: str, number: int, taken: set[str]) -> str:
    """`stem` with `number`, or with the first number after it that makes it free."""
    while f"{stem}{number}" in taken:
        number += 1
    return f"{stem}{number}"
