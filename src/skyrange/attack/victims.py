"""Aircraft that an attack or a fault is declared for: the type of the parameter, and its check against the scenario."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from pydantic import AfterValidator, BeforeValidator, Field

from skyrange.attack.contract import AttackContext
from skyrange.contracts.params import items, refuse
from skyrange.core.errors import InputError, Problem, nearest


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
