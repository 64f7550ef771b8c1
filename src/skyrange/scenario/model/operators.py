"""Operators of a scenario, and the ids, colours and MAVLink addresses that they get by default."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, model_validator

from skyrange.contracts.plugins.registry import APPROVALS
from skyrange.core.errors import nearest
from skyrange.scenario.model.base import Id, Model, Number, wrong
from skyrange.scenario.model.fleet import MAX_SYSTEM_ID, AnyStation, Avoids, Broadcasts, Fleet, Params, Vehicle
from skyrange.scenario.model.optics import name_sensors
from skyrange.scenario.validation.plugin_params import known

COLORS = (
    "blue", "green", "red", "orange", "purple", "teal", "magenta", "brown", "gold", "navy", "olive", "gray", "black",
)  # fmt: skip
"""Names of colours. Operators without a colour get the first unused ones, in this order."""
Signing = Literal["off", "on", "wrong-key", "gateway", "exempt"]


def _known_color(color: str) -> str:
    if color not in COLORS and not (len(color) == 7 and color[0] == "#" and _is_hex(color[1:])):
        raise wrong(color, "the name of a colour, or '#rrggbb'", nearest(color, COLORS))
    return color


def _is_hex(text: str) -> bool:
    return all(char in "0123456789abcdefABCDEF" for char in text)


def _known_streams(name: str) -> str:
    from skyrange.gcs.telemetry_streams import (
        PROFILES,  # its imports are slow, and the default needs no check
    )

    if name not in PROFILES:
        raise wrong(name, " or ".join(map(repr, PROFILES)), nearest(name, PROFILES))
    return name


class VolumeMargins(Model):
    """By how much the airspace that an operator claims for a leg exceeds the leg.

    It has to cover the errors of navigation and control, wind, and the estimate of times.
    """

    horizontal_m: Number = Field(default=5.0, gt=0, le=1_000, description="On all sides, in metres.")
    vertical_m: Number = Field(default=3.0, ge=0, le=1_000, description="Above and below, in metres.")
    early_s: Number = Field(default=5.0, ge=0, le=3_600, description="Before the estimated time, in seconds.")
    late_s: Number = Field(default=30.0, ge=0, le=3_600, description="After the estimated time, in seconds.")
    drift: Number = Field(
        default=0.25, ge=0, le=10, description="By how much a leg may be late, as a share of the flight time up to it."
    )


class SigningTimeRules(Model):
    """By what the timestamps of an operator's signatures advance, at its aircraft and at its ground station."""

    aircraft: Literal["every-fix", "first-fix", "bounded", "never"] = Field(
        default="every-fix",
        description="Settings of the aircraft's clock by GNSS that advance its timestamp. every-fix: all of them, as "
        "ArduPilot; first-fix: the first alone; bounded: those by at most a minute; never: none.",
    )
    saved_ago_s: Number | None = Field(
        default=None,
        ge=0,
        le=1e9,
        description="How long before time 0 the aircraft stored the timestamp with which it starts, in seconds; "
        "default: it starts with a clock that is right.",
    )
    station: Literal["received", "computer"] = Field(
        default="received",
        description="Timestamps of the ground station. received: they advance to those of the aircraft, as MAVLink's "
        "C library does; computer: they are the time of its computer, as those of Mission Planner.",
    )


class ReplanningRules(Model):
    """What the ground station replans flights for while they are flown, through an approval that tracks intents."""

    battery_reserve: Number | None = Field(
        default=None,
        gt=0,
        lt=1,
        description="Share of the battery that is to be left at the end. An aircraft whose battery would end below "
        "skips the points between, or returns; default: none.",
    )
    jammed_radius_m: Number | None = Field(
        default=None,
        gt=0,
        le=10_000,
        description="How far around the place where the link of an aircraft was lost others do not fly, in metres; "
        "default: they do.",
    )
    jammed_s: Number = Field(
        default=600.0, gt=0, le=86_400, description="How long such a place counts as jammed, in seconds."
    )


class Operator(Model):
    """One operator: its aircraft, and the ground station that flies them."""

    id: Id = Field(
        default="",
        description="Name, unique in the scenario; default: the name of its colour, else op1, op2…",
        json_schema_extra={"default": None},
    )
    color: Annotated[str, AfterValidator(_known_color)] = Field(
        default="",
        description=f"Colour in figures, '#rrggbb' or a name: {', '.join(COLORS)}. Default: its id if that is a "
        "colour, else an unused colour.",
        json_schema_extra={"default": None},
    )
    approval: Annotated[str, known(APPROVALS, "an approval service")] = Field(
        default="approve-all", description="Service that approves its flight plans, a plugin of skyrange.approvals."
    )
    margins: VolumeMargins = Field(
        default_factory=VolumeMargins, description="Margins of the airspace that it claims for its flights."
    )
    replan: ReplanningRules | None = Field(
        default=None, description="What its ground station replans flights for in flight; default: closed volumes only."
    )
    request_ahead_s: Number | None = Field(
        default=None,
        ge=0,
        le=86_400,
        description="How long before its departure approval of a flight is requested, in seconds; default: of all "
        "flights at the beginning.",
    )
    streams: Annotated[str, AfterValidator(_known_streams)] = Field(
        default="light",
        description="Telemetry profile that its ground station requests: light, or operator (that of QGroundControl).",
    )
    params: Params = Field(
        default_factory=dict,
        description="Autopilot parameters of all its aircraft; a vehicle's own ones override them.",
    )
    signing: Signing = Field(
        default="off",
        description="MAVLink 2 signing between its ground station and its aircraft. wrong-key: signing is on, and the "
        "key of the ground station differs from that of the aircraft. gateway: the aircraft sign, and a gateway on "
        "board signs what reaches it unsigned. exempt: signing is on, and the aircraft's channel is exempt from it.",
    )
    signing_time: SigningTimeRules | None = Field(
        default=None,
        description="By what the timestamps of signatures advance; default: as in ArduPilot and MAVLink's C library.",
    )
    station: AnyStation = None
    remote_id: Broadcasts = None
    avoidance: Avoids = None
    vehicles: tuple[Vehicle, ...] = Field(default=(), description="Its individual aircraft.")
    fleets: tuple[Fleet, ...] = Field(default=(), description="Its fleets; their aircraft come after the vehicles.")

    @model_validator(mode="after")
    def _replans_through_its_approval(self) -> Operator:
        if self.replan is not None and self.approval == "approve-all":
            raise wrong(
                "a table", "none, because approve-all tracks no intents", "Set approval = 'authority'.", where="replan"
            )
        return self


_HANDED_ON: dict[str, Any] = {"fleets": (), "params": {}, "remote_id": None, "avoidance": None}
"""Values that a built operator has instead of its own, which its vehicles have taken over."""


def operator_names(given: Iterable[tuple[str, str]]) -> list[tuple[str, str]]:
    """(id, colour) of every operator, with "" replaced by an unused name or colour."""
    given = list(given)
    ids = {name for name, _ in given}
    colors = {color for _, color in given} | {name for name, _ in given if name in COLORS}
    named = []
    for number, (name, color) in enumerate(given, start=1):
        if not name:
            name = color if color in COLORS and color not in ids else _free("op", number, ids)
            ids.add(name)
        if not color:
            free = [colour for colour in COLORS if colour not in colors]
            color = name if name in COLORS else (free or COLORS)[0]
            colors.add(color)
        named.append((name, color))
    return named


def vehicle_names(operator: str, given: Sequence[str]) -> list[str]:
    """The ids of an operator's vehicles, with "" replaced by its initial and an unused number."""
    return _numbered(operator[0].lower(), given, set(given))


def assign_addresses(given: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """(network, system id) of an operator's vehicles, with -1 and 0 replaced by the lowest free ones, in order.

    A system id without a network belongs to network 0.
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
            if candidate <= MAX_SYSTEM_ID or network >= 0:  # a given network may overflow, which cross_check reports
                break
            candidates[chosen] = candidate
            chosen = at = at + 1
        candidates[chosen] = candidate + 1
        out.append((chosen, candidate))
    return out


def name_operators(operators: Sequence[Operator]) -> tuple[Operator, ...]:
    """The operators with every id, colour and system id filled in, and with vehicles that include fleets and params."""
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
                "id": id_,
                "network": network,
                "system_id": system_id,
                "params": {**operator.params, **vehicle.params},
                "remote_id": vehicle.remote_id or operator.remote_id,
                "avoidance": vehicle.avoidance or operator.avoidance,
                "sensors": name_sensors(vehicle.sensors),
            }
        )
        for vehicle, id_, (network, system_id) in zip(vehicles, ids, where, strict=True)
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
    """`stem` with `number`, or with the first larger number whose name is unused."""
    while f"{stem}{number}" in taken:
        number += 1
    return f"{stem}{number}"
