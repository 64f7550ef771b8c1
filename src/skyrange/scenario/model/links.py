"""Link rules of a scenario: changes to channels by name pattern, the later over the earlier."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import Any, Literal

from pydantic import Field

from skyrange.contracts.links import Channel
from skyrange.core.ids import link_name, vehicle_id
from skyrange.core.time import NS_PER_MS
from skyrange.scenario.model.base import Model, Number, Whole
from skyrange.scenario.model.operators import Operator

VEHICLE_LINKS = ("gcs", "log", "autopilot", "rid_data")
"""Kinds of link that every aircraft has one of."""
AIR_LINKS = ("rid_up", "rid_down")
"""Kinds of link that every aircraft has one of where there is a radio medium."""
OPERATOR_LINKS = ("approval",)
"""Kinds of link that every operator has one of."""


class Link(Model):
    """Changes to the channel of every link whose name matches; what is not given stays as it is."""

    match: str = Field(
        min_length=1, description="A link's name, such as 'gcs:blue/b1', or a pattern with *, such as 'gcs:*'."
    )
    mode: Literal["reliable", "datagram"] | None = Field(
        default=None, description="reliable: in order, a loss delays; datagram: loses, duplicates, reorders."
    )
    latency_ms: Number | None = Field(
        default=None, ge=0.001, le=600_000, description="Delay of every frame in milliseconds, at least 0.001."
    )
    jitter_ms: Number | None = Field(
        default=None, ge=0, le=600_000, description="Extra delay in milliseconds, uniform from 0 up to this."
    )
    loss: Number | None = Field(default=None, ge=0, le=1, description="Probability that a frame is lost, 0…1.")
    duplicate: Number | None = Field(default=None, ge=0, le=1, description="Probability of a second copy, 0…1.")
    reorder: Number | None = Field(
        default=None, ge=0, le=1, description="Probability that a frame is held back and overtaken, 0…1."
    )
    reorder_ms: Number | None = Field(
        default=None, ge=0, le=600_000, description="How long such a frame is held back, in milliseconds."
    )
    rate_bps: Number | None = Field(
        default=None, ge=0, le=1e12, description="Serialisation rate in bits per second; 0 is without limit."
    )
    queue_bytes: Whole | None = Field(
        default=None, ge=1, le=2**31, description="Bytes that wait before the rate limiter; more overflow."
    )

    def over(self, channel: Channel) -> Channel:
        """`channel` with this rule's changes, milliseconds as nanoseconds."""
        changes: dict[str, Any] = self.model_dump(exclude={"match"}, exclude_none=True)
        for name in ("latency", "jitter", "reorder"):
            if f"{name}_ms" in changes:
                changes[f"{name}_ns"] = round(changes.pop(f"{name}_ms") * NS_PER_MS)
        return replace(channel, **changes)


def resolve_channel(rules: Iterable[Link], name: str, default: Channel) -> Channel:
    """The channel of the link called `name`: `default` under every rule that matches, in order."""
    for rule in rules:
        if fnmatchcase(name, rule.match):
            default = rule.over(default)
    return default


def link_names(operators: Iterable[Operator], radio: bool = False) -> list[str]:
    """The names of all links that these operators' fleets have, those to a `radio` medium too."""
    names = []
    for operator in operators:
        names += [link_name(kind, operator.id) for kind in OPERATOR_LINKS]
        kinds = (*VEHICLE_LINKS, *(AIR_LINKS if radio else ()))
        for vehicle in operator.vehicles:
            names += [link_name(kind, vehicle_id(operator.id, vehicle.id)) for kind in kinds]
    return names
