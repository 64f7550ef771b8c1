"""Parameters that attacks and faults have in common: places, and aircraft of the scenario."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field

from skyrange.attack.contract import AttackContext
from skyrange.contracts.params import items, refuse
from skyrange.contracts.plugins.form import MISSING, param
from skyrange.core.errors import InputError, Problem, nearest


def place_param(what: str, *, default: Any = MISSING) -> Any:
    """A parameter that is a place; its description begins with `what`, such as "Position of the jammer".

    The anchor of an attack moves it, if it is one of the kind's `places`.
    """
    description = f"{what}, [east_m, north_m, up_m] in metres from the origin or the attack's anchor."
    return param(description, default=default)


def _each_once(names: tuple[str, ...]) -> tuple[str, ...]:
    if len(set(names)) < len(names):
        raise refuse(Problem("", repr(list(names)), "each aircraft once"))
    return names


Vehicles = Annotated[
    tuple[str, ...], BeforeValidator(items, json_schema_input_type=list[str]), AfterValidator(_each_once)
]
"""Vehicle ids, each once."""
Victims = Annotated[Vehicles, Field(min_length=1)]
"""Vehicle ids, one or more, each once."""


def check_vehicles(context: AttackContext, vehicles: Sequence[str]) -> None:
    """Raises `InputError` for vehicles that are not in the scenario."""
    strangers = [
        Problem(f"vehicles.{place}", vehicle, "a vehicle of the scenario", nearest(vehicle, context.vehicles))
        for place, vehicle in enumerate(vehicles)
        if vehicle not in context.vehicles
    ]
    if strangers:
        raise InputError(context.id, strangers)
