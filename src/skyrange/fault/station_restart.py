"""Restart of a ground station: for some seconds it neither sends nor receives."""

from __future__ import annotations

from typing import Final

from pydantic import Field

from skyrange.attack.link.connection_loss import Breaker
from skyrange.attack.on_path import TapMaker
from skyrange.contracts.links import TapPlacement
from skyrange.contracts.params import Number, Params
from skyrange.core.errors import InputError, nearest
from skyrange.core.ids import link_name, operator_of
from skyrange.core.time import NEVER, from_seconds
from skyrange.fault.contract import FaultContext, FaultParts, FaultPlugin
from skyrange.fault.links import rule_for

SIDE: Final = "gcs"
"""The taps are on the station's side: frames to it cross the channel before they are lost."""


class Restart(Params):
    """The station of one operator is away once, from the start of the fault on."""

    operator: str = Field(description="Operator whose ground station restarts, such as 'blue'.")
    down_s: Number = Field(
        default=15.0, gt=0, le=3_600, description="Time in seconds until the station is back, or until the fault stops."
    )


def make(params: Restart, context: FaultContext) -> FaultParts:
    """The parts. Raises `InputError` for an operator that the scenario does not have."""
    own = [vehicle for vehicle in context.vehicles if operator_of(vehicle) == params.operator]
    if not own:
        operators = list(dict.fromkeys(map(operator_of, context.vehicles)))
        hint = nearest(params.operator, operators)
        raise InputError.one(context.id, "operator", params.operator, "an operator of the scenario", hint)
    names = [link_name("approval", params.operator), *(link_name("gcs", vehicle) for vehicle in own)]
    maker = TapMaker(Breaker, (rule_for(context), from_seconds(params.down_s), NEVER))
    return FaultParts(taps=[TapPlacement(name, SIDE, maker) for name in names if name in context.links])


STATION_RESTART = FaultPlugin(
    Restart,
    make,
    "Restarts the ground station of an operator: all its links are silent for some seconds.",
    surface=("gcs", "approval"),
    effect="all aircraft of an operator lose their station at once, and it hears none of them",
    cause="a crash or an update of the station's program or computer",
    not_modelled="loss of the station's memory: its program goes on behind silent links, with missions and parameters "
    "known, and counts the silence as a lost link; a new start would read them from the aircraft again",
    realism={"the station's frames": "assumed: none leaves and none is read while it restarts, then all do at once"},
)
