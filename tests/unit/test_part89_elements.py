"""14 CFR 89.305 and 89.315, paragraph by paragraph: which field carries it, and that its absence is seen."""

from __future__ import annotations

from typing import Any

import pytest

from skyrange.codec.f3411 import BasicId, Location, MessagePack, SingleMessage, System, decode, encode
from skyrange.codec.f3411.part89 import MODULE, STANDARD, missing_elements

IDENTITY = BasicId(1, 2, "1ABCD2345EF678XYZ")
LOCATION = Location(2, 40.7, -73.9, 12.5, None, 30.0, 0, 12.0, -1.0, 271.0, 11, 5, 0, 3, 1, 1234.5)
STATION = System(1, 40.7, -73.9, 3.0, timestamp_s=220_000_000)
TAKEOFF = STATION._replace(operator_location_type=0)

TABLE: list[tuple[str, str, str, Any]] = [
    # clause, message, field, a value that says nothing
    ("89.305(a)", "BasicId", "uas_id", ""),
    ("89.305(a)", "BasicId", "id_type", 0),
    ("89.305(b)", "System", "operator_lat_deg", None),
    ("89.305(c)", "System", "operator_alt_geo_m", None),
    ("89.305(d)", "Location", "lat_deg", None),
    ("89.305(e)", "Location", "alt_geo_m", None),
    ("89.305(f)", "Location", "speed_mps", None),
    ("89.305(f)", "Location", "vertical_mps", None),
    ("89.305(f)", "Location", "track_deg", None),
    ("89.305(g)", "Location", "timestamp_s", None),
    ("89.305(h)", "Location", "status", 0),
    ("89.315(a)", "BasicId", "uas_id", ""),
    ("89.315(a)", "BasicId", "id_type", 4),
    ("89.315(b)", "Location", "lat_deg", None),
    ("89.315(c)", "Location", "alt_geo_m", None),
    ("89.315(d)", "Location", "speed_mps", None),
    ("89.315(e)", "System", "operator_lat_deg", None),
    ("89.315(f)", "System", "operator_alt_geo_m", None),
    ("89.315(g)", "Location", "timestamp_s", None),
]


def sent(*messages: SingleMessage) -> MessagePack:
    """What a receiver gets of a pack."""
    pack = decode(encode(MessagePack(messages)))
    assert isinstance(pack, MessagePack)
    return pack


def test_every_paragraph_is_there_once() -> None:
    assert [element.clause for element in STANDARD] == [f"89.305({letter})" for letter in "abcdefgh"]
    assert [element.clause for element in MODULE] == [f"89.315({letter})" for letter in "abcdefg"]


def test_a_whole_broadcast_lacks_nothing() -> None:
    assert missing_elements([sent(IDENTITY, LOCATION, STATION)]) == ()
    assert missing_elements([IDENTITY, LOCATION, STATION]) == ()
    assert missing_elements([sent(IDENTITY, LOCATION, TAKEOFF)], MODULE) == ()
    assert missing_elements([sent(IDENTITY._replace(id_type=4), LOCATION, STATION)]) == ()  # a session ID


@pytest.mark.parametrize(("clause", "kind", "field", "nothing"), TABLE)
def test_each_field_carries_its_paragraph_and_no_other(clause: str, kind: str, field: str, nothing: Any) -> None:
    module = clause.startswith("89.315")
    messages: list[Any] = [IDENTITY, LOCATION, TAKEOFF if module else STATION]
    change = {field: nothing}
    if field.endswith("lat_deg"):
        change[field.replace("lat", "lon")] = None
    without = [part._replace(**change) if type(part).__name__ == kind else part for part in messages]
    assert missing_elements([sent(*without)], MODULE if module else STANDARD) == (clause,)


def test_a_take_off_place_is_no_control_station_and_the_other_way_round() -> None:
    assert missing_elements([sent(IDENTITY, LOCATION, TAKEOFF)]) == ("89.305(b)", "89.305(c)")
    assert missing_elements([sent(IDENTITY, LOCATION, STATION)], MODULE) == ("89.315(e)", "89.315(f)")


def test_silence_lacks_everything() -> None:
    assert len(missing_elements([])) == 8
    assert len(missing_elements([], MODULE)) == 7
