"""Parameters: table, start values, and the protocol as ArduPilot speaks it (libraries/GCS_MAVLink/GCS_Param.cpp)."""

from __future__ import annotations

import math

import pytest

from skyrange.codec.mavlink import dialect
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError
from skyrange.vehicle.builtin.engine import BuiltinFleet
from skyrange.vehicle.builtin.parameters import INDEX, PARAMETERS
from skyrange.vehicle.spec import VehicleSpec
from tests.integration.flight_harness import EPOCH, ORIGIN, Range

V = "blue/b1"


def fly(**params: float) -> Range:
    return Range([VehicleSpec(V, 7, params=params)])


def values(r: Range) -> dict[str, float]:
    return {m.param_id: m.param_value for m in r.heard("PARAM_VALUE")}


def test_names_fit_the_field_and_defaults_lie_in_range() -> None:
    for parameter in PARAMETERS:
        assert len(parameter.name) <= 16
        assert parameter.low <= parameter.default <= parameter.high


def test_list_names_every_parameter_once() -> None:
    r = fly(RTL_ALT=2000)
    r.send(V, dialect.MAVLink_param_request_list_message(7, 1))
    r.run(0.5)
    heard = r.heard("PARAM_VALUE")
    assert [m.param_index for m in heard] == list(range(len(PARAMETERS)))
    assert {m.param_count for m in heard} == {len(PARAMETERS)}
    assert values(r)["RTL_ALT"] == 2000
    assert values(r)["SYSID_THISMAV"] == 7
    assert values(r)["WPNAV_SPEED"] == 1000


def test_read_by_name_and_index() -> None:
    r = fly()
    r.send(V, dialect.MAVLink_param_request_read_message(7, 1, b"LAND_SPEED", -1))
    r.send(V, dialect.MAVLink_param_request_read_message(7, 1, b"", INDEX["RTL_ALT"]))
    r.send(V, dialect.MAVLink_param_request_read_message(7, 1, b"NO_SUCH", -1))
    r.send(V, dialect.MAVLink_param_request_read_message(7, 1, b"", 9999))
    r.send(V, dialect.MAVLink_param_request_read_message(7, 1, b"", -7))
    r.run(0.05)
    assert values(r) == {"LAND_SPEED": 50.0, "RTL_ALT": 1500.0}


def test_set_stores_inside_the_range_and_says_so() -> None:
    r = fly()
    for name, value in ((b"WPNAV_SPEED", 450.0), (b"RTL_ALT", 1e9), (b"LAND_SPEED", 70.6)):
        r.send(V, dialect.MAVLink_param_set_message(7, 1, name, value, 9))
    r.run(0.05)
    assert values(r) == {"WPNAV_SPEED": 450.0, "RTL_ALT": 300000.0, "LAND_SPEED": 71.0}
    assert [n.data["name"] for n in r.events("event.parameter")] == ["WPNAV_SPEED", "RTL_ALT", "LAND_SPEED"]
    assert all(n.causes for n in r.events("event.parameter"))


def test_nonsense_is_not_answered_and_the_system_id_not_written() -> None:
    r = fly()
    r.send(V, dialect.MAVLink_param_set_message(7, 1, b"RTL_ALT", math.nan, 9))
    r.send(V, dialect.MAVLink_param_set_message(7, 1, b"RTL_ALT", math.inf, 9))
    r.send(V, dialect.MAVLink_param_set_message(7, 1, b"NO_SUCH", 1.0, 9))
    r.run(0.05)
    assert r.heard("PARAM_VALUE") == []
    r.send(V, dialect.MAVLink_param_set_message(7, 1, b"SYSID_THISMAV", 9.0, 9))
    r.run(0.05)
    assert values(r) == {"SYSID_THISMAV": 7.0}
    assert "Param write denied (SYSID_THISMAV)" in r.words()


def test_bad_start_values_are_all_named() -> None:
    with pytest.raises(InputError) as caught:
        fly(WPNAV_SPEEDS=100, RTL_ALT=-5, LAND_SPEED=math.nan, SYSID_THISMAV=3)
    text = str(caught.value)
    for word in ("WPNAV_SPEEDS", "Did you mean 'WPNAV_SPEED", "RTL_ALT: -5", "LAND_SPEED: nan", "system_id"):
        assert word in text


def test_bad_specs_are_all_named() -> None:
    with pytest.raises(InputError, match="at least one vehicle"):
        BuiltinFleet("x", [], ORIGIN, EPOCH, Chance(1))
    with pytest.raises(InputError, match="system_id"):
        Range([VehicleSpec(V, 255)])
    with pytest.raises(InputError, match="iris"):
        BuiltinFleet("x", [VehicleSpec(V, 1, "irs")], ORIGIN, EPOCH, Chance(1))
