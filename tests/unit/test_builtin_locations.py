"""Points as ArduPilot's Locations, and yaw targets between modes, against ArduPilot's own arithmetic."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest

from skyrange.core.geodesy import Origin
from skyrange.vehicle.builtin import locations
from skyrange.vehicle.builtin.guidance import yaw_target
from skyrange.vehicle.builtin.layout import FLIGHT, new_records

RANGE = Origin(-35.363328, 149.1652241, 10.0)


def place_of(lat_e7: int, lon_e7: int, up_m: float = 18.2) -> tuple[float, float, float]:
    return (*RANGE.enu_of(lat_e7 * 1e-7, lon_e7 * 1e-7), up_m)


def units(place: tuple[float, float, float], origin_e7: tuple[int, int]) -> tuple[int, int]:
    lat, lon = RANGE.geodetic_of(*place[:2])
    return round(lat * 1e7) - origin_e7[0], round(lon * 1e7) - origin_e7[1]


def parts(origin_e7: tuple[int, int]) -> tuple[Any, Any]:
    return SimpleNamespace(origin=RANGE), SimpleNamespace(origin_e7=origin_e7)


@pytest.mark.parametrize(
    ("goal", "origin", "rounded"),
    [
        ((-353628097, 1491367524), (-353633280, 1491377162), (5183, -9637)),
        ((-353632919, 1491596477), (-353633280, 1491597225), (361, -747)),
        ((-353631595, 1491807804), (-353633280, 1491817289), (1685, -9484)),
    ],
)
def test_a_destination_loses_the_unit_that_it_loses_in_ardupilot(
    goal: tuple[int, int], origin: tuple[int, int], rounded: tuple[int, int]
) -> None:
    """By Location.cpp's expressions in C++ with -fsingle-precision-constant, as ArduPilot's build has them."""
    found = locations.rounded_destination(*parts(origin), place_of(*goal))
    assert units(found, origin) == rounded
    assert found[2] == 18.2


@pytest.mark.parametrize(("offset", "kept"), [(5.7, 5), (-5.7, -5), (0.4, 0)])
def test_a_position_is_truncated_towards_where_it_was_switched_on(offset: float, kept: int) -> None:
    origin = (-353633280, 1491652241)
    east_m, north_m = RANGE.enu_of((origin[0] + offset) * 1e-7, (origin[1] + offset) * 1e-7)
    found = locations.truncated(*parts(origin), (east_m, north_m, 7.128))
    assert units(found, origin) == (kept, kept)
    assert found[2] == pytest.approx(7.12)


@pytest.mark.parametrize(("speed", "yaw"), [(2.0, 0.25 * math.pi), (0.1, 0.0)])
def test_hold_and_look_at_next_wp_request_the_yaw_of_the_track(speed: float, yaw: float) -> None:
    """Or, below 5 % of the speed limit, that of the attitude target."""
    flight = new_records(FLIGHT, 2)
    flight["ref_vel"][1] = speed * math.sqrt(0.5), speed * math.sqrt(0.5), 0.0
    flight["speed_xy"][1] = 10.0
    flight["att_target"][1] = 1.0, 0.0, 0.0, 0.0
    flight["target_yaw"][1] = 3.0
    yaw_target.request_track_yaw(flight, 1)
    assert flight["target_yaw"][1] == pytest.approx(yaw)
    assert flight["target_yaw"][0] == 0.0
