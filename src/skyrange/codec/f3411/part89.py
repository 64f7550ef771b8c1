"""Message elements required by 14 CFR part 89, as fields of F3411 messages.

14 CFR 89.305 (standard Remote ID aircraft) and 89.315 (broadcast modules), Amdt. 89-1, 86 FR 4505. An element counts
as carried if its fields are known; whether they are accurate is another question (89.310, 89.320).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Final, NamedTuple

from skyrange.codec.f3411.messages import (
    BasicId,
    IdType,
    Location,
    Message,
    MessagePack,
    OperatorLocationType,
    Status,
    System,
)


class Element(NamedTuple):
    """One paragraph of the rule."""

    clause: str
    what: str
    fields: str
    """Message and fields, as the reference page shows them."""
    carried: Callable[[Message], bool]
    """Whether a message carries the whole element."""


def _identity(*kinds: int) -> Callable[[Message], bool]:
    return lambda message: isinstance(message, BasicId) and message.id_type in kinds and bool(message.uas_id)


def _known(kind: type[Location], *names: str) -> Callable[[Message], bool]:
    return lambda message: isinstance(message, kind) and all(getattr(message, name) is not None for name in names)


def _operator(kinds: tuple[int, ...], *names: str) -> Callable[[Message], bool]:
    return lambda message: (
        isinstance(message, System)
        and message.operator_location_type in kinds
        and all(getattr(message, name) is not None for name in names)
    )


_STATION: Final = (OperatorLocationType.LIVE_GNSS, OperatorLocationType.FIXED)
_TAKEOFF: Final = (OperatorLocationType.TAKEOFF,)
_PLACE: Final = ("lat_deg", "lon_deg")
_OPERATOR_PLACE: Final = ("operator_lat_deg", "operator_lon_deg")
_VELOCITY: Final = ("speed_mps", "vertical_mps", "track_deg")
_VELOCITY_TEXT: Final = "Location: speed_mps, vertical_mps, track_deg"
_PLACE_TEXT: Final = "Location: lat_deg, lon_deg"
_TIME_TEXT: Final = "Location: timestamp_s"

STANDARD: Final = (
    Element(
        "89.305(a)", "serial number or session ID", "Basic ID: id_type 1 or 4, uas_id",
        _identity(IdType.SERIAL_NUMBER, IdType.SPECIFIC_SESSION),
    ),
    Element(
        "89.305(b)", "latitude and longitude of the control station",
        "System: operator_lat_deg, operator_lon_deg, operator_location_type 1 or 2",
        _operator(_STATION, *_OPERATOR_PLACE),
    ),
    Element(
        "89.305(c)", "geometric altitude of the control station",
        "System: operator_alt_geo_m, operator_location_type 1 or 2", _operator(_STATION, "operator_alt_geo_m"),
    ),
    Element("89.305(d)", "latitude and longitude of the aircraft", _PLACE_TEXT, _known(Location, *_PLACE)),
    Element("89.305(e)", "geometric altitude of the aircraft", "Location: alt_geo_m", _known(Location, "alt_geo_m")),
    Element("89.305(f)", "velocity of the aircraft", _VELOCITY_TEXT, _known(Location, *_VELOCITY)),
    Element("89.305(g)", "time mark (UTC) of a position", _TIME_TEXT, _known(Location, "timestamp_s")),
    Element(
        "89.305(h)", "emergency status", "Location: status, declared",
        lambda message: isinstance(message, Location) and message.status != Status.UNDECLARED,
    ),
)  # fmt: skip
"""The elements of a standard Remote ID aircraft."""

MODULE: Final = (
    Element(
        "89.315(a)", "serial number of the module", "Basic ID: id_type 1, uas_id", _identity(IdType.SERIAL_NUMBER)
    ),
    Element("89.315(b)", "latitude and longitude of the aircraft", _PLACE_TEXT, _known(Location, *_PLACE)),
    Element("89.315(c)", "geometric altitude of the aircraft", "Location: alt_geo_m", _known(Location, "alt_geo_m")),
    Element("89.315(d)", "velocity of the aircraft", _VELOCITY_TEXT, _known(Location, *_VELOCITY)),
    Element(
        "89.315(e)", "latitude and longitude of the take-off location",
        "System: operator_lat_deg, operator_lon_deg, operator_location_type 0",
        _operator(_TAKEOFF, *_OPERATOR_PLACE),
    ),
    Element(
        "89.315(f)", "geometric altitude of the take-off location",
        "System: operator_alt_geo_m, operator_location_type 0", _operator(_TAKEOFF, "operator_alt_geo_m"),
    ),
    Element("89.315(g)", "time mark (UTC) of a position", _TIME_TEXT, _known(Location, "timestamp_s")),
)  # fmt: skip
"""The elements of a Remote ID broadcast module."""


def missing_elements(messages: Iterable[Message], elements: tuple[Element, ...] = STANDARD) -> tuple[str, ...]:
    """The clauses whose element is in none of `messages`; packs are searched."""
    parts: list[Message] = []
    for message in messages:
        parts += message.messages if isinstance(message, MessagePack) else (message,)
    return tuple(element.clause for element in elements if not any(map(element.carried, parts)))
