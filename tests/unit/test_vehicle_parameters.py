"""Parameters: table, start values, and the protocol as ArduPilot speaks it (libraries/GCS_MAVLink/GCS_Param.cpp)."""

from __future__ import annotations

import math

import numpy as np
import pytest

from skyrange.codec.mavlink import dialect
from skyrange.core.errors import InputError
from skyrange.vehicle.builtin.engine import BuiltinFleet
from skyrange.vehicle.builtin.parameters.renames import RENAMED, canonical_name, from_canonical, to_canonical
from skyrange.vehicle.builtin.parameters.table import INDEX, PARAMETERS, count_listed
from skyrange.vehicle.contract import VehicleSpec
from tests.integration.flight_harness import EPOCH, ORIGIN, Range

V = "blue/b1"
LISTED = count_listed(np.zeros(len(PARAMETERS)))
"""Parameters of an aircraft without range sensors."""


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
    assert [m.param_index for m in heard] == list(range(LISTED))
    assert {m.param_count for m in heard} == {LISTED}
    assert values(r)["RTL_ALT"] == 2000
    assert values(r)["SYSID_THISMAV"] == 7
    assert values(r)["WPNAV_SPEED"] == 1000


def test_a_list_is_sent_at_the_pace_of_the_port_and_slows_streams() -> None:
    """Measured with ArduCopter 4.7-dev: every 100 ms, 81 values if they are asked anew 10 ms before they are due."""
    r = fly()
    position = dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
    interval = dialect.MAV_CMD_SET_MESSAGE_INTERVAL
    r.send(V, dialect.MAVLink_command_long_message(7, 1, interval, 0, position, 100_000, 0, 0, 0, 0, 0))
    r.run(2.0)
    nominal = len(r.heard("GLOBAL_POSITION_INT"))
    assert nominal in (19, 20)
    phase_s = int(r.engines[0]._fleet.report_phases_ns[0]) * 1e-9 % 0.1
    for tenth in range(20):  # 10 ms before values are due: 30 % of 10 Mbit/s in 10 ms
        r.run(2.09 + phase_s + tenth * 0.1 - r.now * 1e-9)
        r.send(V, dialect.MAVLink_param_request_list_message(7, 1))
    r.run(0.02)
    heard = r.heard("PARAM_VALUE")
    assert len(heard) == 20 * 81
    assert max(m.param_index for m in heard) == 80
    assert len(r.heard("GLOBAL_POSITION_INT")) - nominal in (5, 6)
    r.run(2.0)
    assert r.heard("PARAM_VALUE")[-1].param_index == LISTED - 1
    assert len(r.heard("GLOBAL_POSITION_INT")) - nominal > 18
    assert len(r.heard("HEARTBEAT")) in (6, 7)


def test_read_by_name_and_index() -> None:
    r = fly()
    r.send(V, dialect.MAVLink_param_request_read_message(7, 1, b"LAND_SPEED", -1))
    r.send(V, dialect.MAVLink_param_request_read_message(7, 1, b"", INDEX["RTL_ALT"]))
    r.send(V, dialect.MAVLink_param_request_read_message(7, 1, b"NO_SUCH", -1))
    r.send(V, dialect.MAVLink_param_request_read_message(7, 1, b"", 9999))
    r.send(V, dialect.MAVLink_param_request_read_message(7, 1, b"", -7))
    r.run(0.05)
    assert values(r) == {"LAND_SPEED": 50.0, "RTL_ALT": 1500.0}


def test_set_stores_what_comes_and_flies_inside_the_range() -> None:
    r = fly()
    sent = ((b"WPNAV_SPEED", 450.0), (b"RTL_ALT", 1e9), (b"LAND_SPEED", 70.6), (b"DISARM_DELAY", 4000.0))
    for name, value in sent:
        r.send(V, dialect.MAVLink_param_set_message(7, 1, name, value, 9))
    r.run(0.05)
    # AP_Param::set_float: whole types are cut, not rounded, and stop at their ends; ranges are for people
    assert values(r) == {"WPNAV_SPEED": 450.0, "RTL_ALT": 1e9, "LAND_SPEED": 70.0, "DISARM_DELAY": 127.0}
    assert [n.data["name"] for n in r.events("event.parameter")] == [name.decode() for name, _ in sent]
    assert all(n.causes for n in r.events("event.parameter"))
    fleet = r.engines[0]._fleet
    assert fleet.param(fleet.vehicles[0], "RTL_ALT") == 300_000.0
    r.send(V, dialect.MAVLink_param_set_message(7, 1, b"WPNAV_ACCEL", -1e30, 9))
    r.run(0.05)
    assert values(r)["WPNAV_ACCEL"] == pytest.approx(-1e30, rel=1e-6)
    assert fleet.settings["WPNAV_ACCEL"][0] == 50.0


def test_nonsense_is_not_answered() -> None:
    r = fly()
    r.send(V, dialect.MAVLink_param_set_message(7, 1, b"RTL_ALT", math.nan, 9))
    r.send(V, dialect.MAVLink_param_set_message(7, 1, b"RTL_ALT", math.inf, 9))
    r.send(V, dialect.MAVLink_param_set_message(7, 1, b"NO_SUCH", 1.0, 9))
    r.run(0.05)
    assert r.heard("PARAM_VALUE") == []


def test_the_system_id_is_stored_and_changes_at_the_next_boot() -> None:
    r = fly()
    r.send(V, dialect.MAVLink_param_set_message(7, 1, b"SYSID_THISMAV", 9.0, 9))
    r.run(1.0)
    assert values(r) == {"SYSID_THISMAV": 9.0}
    assert {said.message.get_srcSystem() for said in r.said} == {7}
    assert r.command(V, dialect.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0) == 0
    assert r.said[-1].message.get_srcSystem() == 7  # the acknowledgement comes before
    before = len(r.said)
    r.run(1.5)
    assert {said.message.get_srcSystem() for said in r.said[before:]} == {9}
    r.system[V] = 9
    assert r.command(V, dialect.MAV_CMD_REQUEST_MESSAGE, 0) == 0


def test_names_of_4_7_are_answered_under_that_name_and_unit() -> None:
    r = Range([VehicleSpec(V, 7, params={"WP_SPD": 4.5, "PSC_D_ACC_I": 0.08, "MAV1_POSITION": 2, "SR0_EXTRA1": 4})])
    fleet = r.engines[0]._fleet
    vehicle = fleet.vehicles[0]
    assert fleet.param(vehicle, "WPNAV_SPEED") == 450.0
    assert fleet.settings["PSC_ACCZ_I"][0] == pytest.approx(0.8)
    assert fleet.param(vehicle, "SR0_POSITION") == 2.0
    r.send(V, dialect.MAVLink_param_request_read_message(7, 1, b"MAV_SYSID", -1))
    r.send(V, dialect.MAVLink_param_request_read_message(7, 1, b"rtl_alt", -1))  # AP_Param::find knows no case
    r.send(V, dialect.MAVLink_param_set_message(7, 1, b"RTL_ALT_M", 22.5, 9))
    r.run(0.05)
    assert values(r) == {"MAV_SYSID": 7.0, "rtl_alt": 1500.0, "RTL_ALT_M": 22.5}
    assert fleet.param(vehicle, "RTL_ALT") == 2250.0


@pytest.mark.parametrize(("check", "skip"), [(1.0, 0.0), (0.0, -1.0), (2.0, float(((1 << 21) - 1) & ~3))])
def test_checks_to_make_and_checks_to_skip(check: float, skip: float) -> None:
    assert canonical_name("ARMING_SKIPCHK") == "ARMING_CHECK"
    assert to_canonical("ARMING_SKIPCHK", skip) == check
    assert from_canonical("ARMING_SKIPCHK", check) == skip


def test_every_new_name_means_an_old_one_and_fits_the_field() -> None:
    assert not set(RENAMED) & set(INDEX)
    assert all(len(name) <= 16 for name in RENAMED)
    assert not {old for old, _ in RENAMED.values()} & set(RENAMED)


def test_one_parameter_under_two_names_is_an_error() -> None:
    with pytest.raises(InputError, match="WPNAV_SPEED is the same parameter"):
        fly(WPNAV_SPEED=500, WP_SPD=5)


def test_bad_start_values_are_all_named() -> None:
    with pytest.raises(InputError) as caught:
        fly(WPNAV_SPEEDS=100, RTL_ALT=-5, LAND_SPEED=math.nan, SYSID_THISMAV=3)
    text = str(caught.value)
    for word in ("WPNAV_SPEEDS", "Did you mean 'WPNAV_SPEED", "RTL_ALT: -5", "LAND_SPEED: nan", "system_id"):
        assert word in text


def test_bad_specs_are_all_named() -> None:
    with pytest.raises(InputError, match="at least one vehicle"):
        BuiltinFleet("x", [], ORIGIN, EPOCH)
    with pytest.raises(InputError, match="system_id"):
        Range([VehicleSpec(V, 255)])
    with pytest.raises(InputError, match="iris"):
        BuiltinFleet("x", [VehicleSpec(V, 1, "irs")], ORIGIN, EPOCH)
