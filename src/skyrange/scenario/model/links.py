"""Rules of a scenario by name or pattern: channels of links, processing limits of endpoints, and machines."""

from __future__ import annotations

import ipaddress
from collections.abc import Iterable, Iterator
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, field_validator, model_validator

from skyrange.contracts.links import Channel
from skyrange.core.ids import APPROVAL, endpoint, link_name, vehicle_id
from skyrange.core.time import NS_PER_MS
from skyrange.radio.control_link.params import CellularParams, WifiParams
from skyrange.radio.control_link.sik.params import SikParams
from skyrange.scenario.model.base import Model, Number, Whole, wrong
from skyrange.scenario.model.operators import Operator

VEHICLE_LINKS = ("gcs", "log", "autopilot", "rid_data")
"""Kinds of link; every aircraft has one of each."""
AIR_LINKS = ("rid_up", "rid_down")
SCAN_LINK = "scan"
"""Kinds of link; with a radio medium, every aircraft has one of each."""
OPERATOR_LINKS = ("approval",)
"""Kinds of link; every operator has one of each."""

AirParams = WifiParams | CellularParams | SikParams
"""Parameters of a channel over the air."""
_OVER_AIR = ("wifi", "cellular", "sik")


class Link(Model):
    """Changes to the channel of every link whose name matches. An omitted key does not change its value."""

    match: str = Field(
        min_length=1, description="Name of a link, such as 'gcs:blue/b1', or a pattern with *, such as 'gcs:*'."
    )
    channel: Literal["fixed", "wifi", "cellular", "sik"] | None = Field(
        default=None,
        description="fixed: the channel that the other keys describe, which is the default; wifi: over 802.11g between "
        "the ground station and the aircraft; cellular: over the LTE cells that `cellular` declares; sik: over a pair "
        "of SiK telemetry radios. The latter three are for gcs links, need [radio], and take the place of a fixed "
        "channel.",
    )
    wifi: WifiParams | None = Field(default=None, description='Parameters of channel = "wifi".')
    cellular: CellularParams | None = Field(default=None, description='Parameters of channel = "cellular".')
    sik: SikParams | None = Field(default=None, description='Parameters of channel = "sik".')
    mode: Literal["reliable", "datagram"] | None = Field(
        default=None,
        description="reliable: frames keep their order, and a loss becomes a retransmission delay; datagram: frames "
        "can be lost, duplicated and reordered.",
    )
    latency_ms: Number | None = Field(
        default=None, ge=0.001, le=600_000, description="Delay of every frame in milliseconds."
    )
    jitter_ms: Number | None = Field(
        default=None,
        ge=0,
        le=600_000,
        description="Range of the random extra delay in milliseconds, uniform from 0 to this value.",
    )
    loss: Number | None = Field(default=None, ge=0, le=1, description="Probability that a frame is lost.")
    duplicate: Number | None = Field(default=None, ge=0, le=1, description="Probability that a frame is duplicated.")
    reorder: Number | None = Field(
        default=None, ge=0, le=1, description="Probability that a frame is held back, so that later frames overtake it."
    )
    reorder_ms: Number | None = Field(
        default=None, ge=0, le=600_000, description="Time for which such a frame is held back, in milliseconds."
    )
    rate_bps: Number | None = Field(
        default=None, ge=0, le=1e12, description="Serialisation rate in bits per second, at least 1; 0 means no limit."
    )
    queue_bytes: Whole | None = Field(
        default=None,
        ge=1,
        le=2**31,
        description="Size of the queue before the rate limiter in bytes; a frame that does not fit is lost.",
    )

    @field_validator("rate_bps")
    @classmethod
    def _a_bit_a_second(cls, rate_bps: float | None) -> float | None:
        if rate_bps is not None and 0.0 < rate_bps < 1.0:
            raise wrong(rate_bps, "0 or a number from 1 to 1e12")
        return rate_bps

    @model_validator(mode="after")
    def _one_kind_of_channel(self) -> Link:
        for kind in _OVER_AIR:
            if getattr(self, kind) is not None and self.channel != kind:
                raise wrong("a table", f'no such table, or channel = "{kind}"', where=kind)
        if self.channel == "cellular" and self.cellular is None:
            raise wrong("none", "the base stations of the network", "Add base_stations.", where="cellular")
        if self.channel in _OVER_AIR:
            fixed = sorted(self.model_fields_set - {"match", "channel", *_OVER_AIR})
            if fixed:
                hint = f"The table {self.channel} has the parameters of such a channel."
                raise wrong(getattr(self, fixed[0]), f"no such key, because channel is {self.channel}", hint, fixed[0])
        return self

    @property
    def over_air(self) -> AirParams | None:
        """The parameters of a channel over the air; `None` for a fixed one."""
        if self.channel == "wifi":
            return self.wifi or WifiParams()
        if self.channel == "sik":
            return self.sik or SikParams()
        return self.cellular if self.channel == "cellular" else None

    def over(self, channel: Channel) -> Channel:
        """`channel` with the changes of this rule, converted from milliseconds to nanoseconds."""
        changes: dict[str, Any] = self.model_dump(exclude={"match", "channel", *_OVER_AIR}, exclude_none=True)
        for name in ("latency", "jitter", "reorder"):
            if f"{name}_ms" in changes:
                changes[f"{name}_ns"] = round(changes.pop(f"{name}_ms") * NS_PER_MS)
        return replace(channel, **changes)


def resolve_channel(rules: Iterable[Link], name: str, default: Channel) -> Channel:
    """The channel of the link `name`: `default` with the changes of every rule that matches, in order."""
    for rule in rules:
        if fnmatchcase(name, rule.match):
            default = rule.over(default)
    return default


def resolve_over_air(rules: Iterable[Link], name: str) -> AirParams | None:
    """The parameters of the link's channel over the air, by the last rule that says what its channel is."""
    params: AirParams | None = None
    for rule in rules:
        if rule.channel is not None and fnmatchcase(name, rule.match):
            params = rule.over_air
    return params


def link_names(operators: Iterable[Operator], *, radio: bool = False) -> list[str]:
    """The names of all links of these operators and their vehicles; with `radio`, those to the medium too."""
    names = []
    for operator in operators:
        names += [link_name(kind, operator.id) for kind in OPERATOR_LINKS]
        kinds = (*VEHICLE_LINKS, *(AIR_LINKS if radio else ()))
        for vehicle in operator.vehicles:
            scanned = (SCAN_LINK,) if vehicle.sensors else ()
            names += [link_name(kind, vehicle_id(operator.id, vehicle.id)) for kind in (*kinds, *scanned)]
    return names


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


def _address(text: str) -> str:
    try:
        address = ipaddress.ip_address(text)
    except ValueError:
        raise wrong(text, "an IP address", "Host names are not resolved; write an IP address.") from None
    if address.is_unspecified or address.is_multicast:
        raise wrong(text, "the IP address of one machine, not an unspecified or multicast one")
    return str(address)


Hosts = Annotated[
    dict[Annotated[str, Field(min_length=1, max_length=128)], Annotated[str, AfterValidator(_address)]],
    Field(
        description="IP addresses of the machines of a live range, by component. A key is the name of a component, "
        "such as blue.gcs, blue/b1.companion, blue/b1.proxy, approval or world (which has all autopilots), or a "
        "pattern with *; a later key overrides an earlier one. A component that no key matches runs on the machine of "
        "the world. Default: all components run on the machine that starts the range.",
    ),
]
