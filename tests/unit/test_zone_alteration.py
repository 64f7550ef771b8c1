"""Zones that are moved, or made smaller or larger, item by item."""

from __future__ import annotations

from typing import Any

import pytest

from skyrange.attack.bases.mavlink.message_fields import read_fields
from skyrange.attack.contract import AttackPlugin
from skyrange.attack.ground.geo_zones import Form, ZoneAlteration
from skyrange.codec.mavlink import Packer
from skyrange.codec.mavlink import dialect as mav
from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin

ORIGIN = Origin(40.7780, -73.9550, 20.0, -32.7)
CIRCLE_OUT, CIRCLE_IN = mav.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION, mav.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION
CORNER_OUT = mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION


def zone(seq: int, command: int, size: float, east_m: float, north_m: float) -> Any:
    lat, lon = ORIGIN.geodetic_of(east_m, north_m)
    message = mav.MAVLink_mission_item_int_message(
        1, 1, seq, 0, command, 0, 1, size, 0, 0, 0, round(lat * 1e7), round(lon * 1e7), 0.0, 1
    )
    return read_fields(Packer(255, 190).pack(message), mav.MAVLINK_MSG_ID_MISSION_ITEM_INT)


def place(fields: Any) -> Any:
    return pytest.approx(ORIGIN.enu_of(fields["x"] * 1e-7, fields["y"] * 1e-7), abs=0.03)


def made(form: Form = "scale", factor: float = 0.5, all_zones: bool = False) -> ZoneAlteration:
    return ZoneAlteration(form, factor, (30.0, -40.0), ORIGIN, all_zones)


def test_a_radius_is_scaled_about_its_centre_and_is_never_zero() -> None:
    fields = zone(0, CIRCLE_OUT, 30.0, 5.0, 6.0)
    assert made(factor=0.3048).alter_item(fields, 1)
    assert fields["param1"] == pytest.approx(9.144)
    assert place(fields) == (5.0, 6.0)
    assert made(factor=0.001).alter_item(fields, 1)
    assert fields["param1"] == pytest.approx(0.1)


def test_polygons_are_scaled_about_their_first_corners_even_if_an_item_is_sent_again() -> None:
    alteration, corners = made(), [(0, 0), (20, 0), (20, 20), (100, 100), (120, 100), (100, 140)]
    found = []
    for seq in (0, 0, 1, 2, 1, 3, 4, 5):
        fields = zone(seq, CORNER_OUT, 3.0, *corners[seq])
        assert alteration.alter_item(fields, 6)
        assert fields["param1"] == 3.0
        found.append((seq, fields))
    expected = [(0, 0), (10, 0), (10, 10), (100, 100), (110, 100), (100, 120)]
    assert all(expected[seq] == place(fields) for seq, fields in found)
    again = zone(0, CORNER_OUT, 3.0, 50.0, 50.0)
    assert alteration.alter_item(again, 3)
    second = zone(1, CORNER_OUT, 3.0, 60.0, 50.0)
    assert alteration.alter_item(second, 3)
    assert place(second) == (55.0, 50.0), "another upload has other polygons"


def test_zones_are_moved_and_those_to_stay_in_only_if_asked_for() -> None:
    fields = zone(0, CORNER_OUT, 3.0, 1.0, 2.0)
    assert made("move").alter_item(fields, 3)
    assert place(fields) == (31.0, -38.0)
    inside = zone(0, CIRCLE_IN, 100.0, 0.0, 0.0)
    assert not made().alter_item(inside, 1)
    assert inside["param1"] == 100.0
    assert made(all_zones=True).alter_item(inside, 1)
    assert inside["param1"] == 50.0
    assert not made(all_zones=True).alter_item(zone(0, mav.MAV_CMD_NAV_FENCE_RETURN_POINT, 0, 0, 0), 1)


@pytest.mark.parametrize(
    ("params", "named"), [({"form": "move"}, "east_m"), ({"factor": 1.0}, "factor"), ({"factor": 0.0}, "factor")]
)
def test_an_alteration_that_is_none_is_an_error(params: dict[str, Any], named: str) -> None:
    with pytest.raises((InputError, ValueError), match=named):
        AttackPlugin.find("ground.geo_zones").params.model_validate({"vehicles": ["blue/b1"], **params})
