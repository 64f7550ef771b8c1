"""Parameters and base of kinds that judge signal strengths: what they assume of the channel, and errors of their map.

The defaults are those of standards and measurements, and an exact map. ITU-R P.1411-11 (4.1.1, table 2) and TR 38.901
state other spreads for other streets; a footprint of OpenStreetMap is off by about 4 m (H. Fan, A. Zipf, Q. Fu and P.
Neis, "Quality assessment for building footprints data on OpenStreetMap", IJGIS 28/4, 2014: Munich).
"""

from __future__ import annotations

from typing import Annotated, Any, Protocol

from pydantic import AfterValidator, BeforeValidator

import skyrange.plugin as sky
from skyrange.defence.bases.receptions import BroadcastJudge
from skyrange.defence.building_map import map_with_errors
from skyrange.defence.remote_id.strength_test import DECORRELATION_M, RICIAN_K_DB, AssumedChannel


def _is_pair(values: tuple[float, ...]) -> tuple[float, ...]:
    if len(values) != 2:
        raise sky.refuse(sky.Problem("", repr(list(values)), "east and north in metres, such as [4, -3]"))
    return values


Shift = Annotated[
    tuple[sky.Number, ...],
    BeforeValidator(sky.items, json_schema_input_type=list[float]),
    AfterValidator(_is_pair),
]


def assumed_k() -> Any:
    """The parameter `rician_k_db`."""
    return sky.param(
        "Rician K of signals in sight that it assumes, in dB; the default is by Matolak & Sun, 2017.",
        default=RICIAN_K_DB, ge=-20, le=60,
    )  # fmt: skip


def assumed_decorrelation() -> Any:
    """The parameter `decorrelation_m`."""
    return sky.param(
        "Decorrelation distance of shadowing that it assumes, in metres; the default is by 3GPP TR 38.901.",
        default=DECORRELATION_M, gt=0, le=1_000,
    )  # fmt: skip


def assumed_shadowing() -> Any:
    """The parameter `shadowing_db`."""
    return sky.param(
        "Standard deviation of shadowing in sight that it assumes, in dB; default: by the height of the lower antenna, "
        "3GPP TR 36.777.",
        default=None, gt=0, le=30,
    )  # fmt: skip


def assumed_shift() -> Any:
    """The parameter `map_shift_m`."""
    return sky.param(
        "Error of its map, [east, north] in metres, by which every building is off; about 4 m in OpenStreetMap.",
        default=(0.0, 0.0),
    )


def assumed_missing() -> Any:
    """The parameter `map_missing`."""
    return sky.param("Share of the buildings that its map lacks.", default=0.0, ge=0, le=1)


class Knowing(Protocol):
    """A kind with these parameters."""

    rician_k_db: float
    decorrelation_m: float
    shadowing_db: float | None
    map_shift_m: tuple[float, ...]
    map_missing: float


def channel_of(kind: Knowing) -> AssumedChannel:
    """The channel that a kind assumes."""
    return AssumedChannel(kind.rician_k_db, kind.decorrelation_m, kind.shadowing_db)


def map_of(kind: Knowing, context: sky.DefenceContext) -> sky.City | None:
    """The map that a kind has."""
    east_m, north_m = kind.map_shift_m
    return map_with_errors(context.city, (east_m, north_m), kind.map_missing, context.chance)


class SignalJudge(BroadcastJudge):
    """Judges broadcasts by their signals: what it assumes of the channel and of its map are parameters."""

    rician_k_db: sky.Number = assumed_k()
    decorrelation_m: sky.Number = assumed_decorrelation()
    shadowing_db: sky.Number | None = assumed_shadowing()
    map_shift_m: Shift = assumed_shift()
    map_missing: sky.Number = assumed_missing()
    city: sky.City | None
    """Its map."""

    def prepare(self, context: sky.DefenceContext) -> None:
        """Draw the map."""
        self.city = map_of(self, context)
