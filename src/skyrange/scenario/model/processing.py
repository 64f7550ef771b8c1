"""Processing limits of a scenario: how many frames an endpoint processes in a second, and how many may wait there."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from fnmatch import fnmatchcase

from pydantic import Field

from skyrange.core.ids import APPROVAL, endpoint, vehicle_id
from skyrange.scenario.model.base import Model, Number, Whole
from skyrange.scenario.model.operators import Operator

ONBOARD = ("companion", "proxy", "autopilot")
"""Endpoints; every aircraft has one of each."""


class Processing(Model):
    """Limit of every endpoint whose name matches. Each has one queue for the frames of all links that end there. This
    is a model: every frame takes the same time, whatever it contains. An endpoint without a limit processes frames at
    once.
    """

    match: str = Field(
        min_length=1,
        description="Endpoint such as 'blue/b1.autopilot', 'blue/b1.companion', 'blue/b1.proxy', 'blue.gcs' or "
        "'approval', or a pattern with *, such as '*.autopilot'.",
    )
    frames_per_s: Number = Field(ge=0.001, le=1e6, description="Frames that it processes in a second.")
    queue_frames: Whole = Field(
        ge=1,
        le=1_000_000,
        description="Frames that may wait until they are processed; a frame that finds the queue full is lost.",
    )


def endpoint_names(operators: Iterable[Operator]) -> Iterator[str]:
    """The names of all endpoints that can have a limit: those of these operators and their vehicles, and approval."""
    yield APPROVAL
    for operator in operators:
        yield endpoint(operator.id, "gcs")
        for vehicle in operator.vehicles:
            yield from (endpoint(vehicle_id(operator.id, vehicle.id), role) for role in ONBOARD)


def find_matches(table: Processing, names: Iterable[str]) -> list[str]:
    """Those of `names` to which a table applies."""
    return [name for name in names if fnmatchcase(name, table.match)]
