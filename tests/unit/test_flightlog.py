"""Do readers find in a log what was written into it, and say what is wrong with it?"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyrange.core.errors import InputError
from skyrange.flightlog import read_log, split_flights
from skyrange.flightlog.conversion import convert_flight
from skyrange.flightlog.flown_path import simplify_path
from tests.written_logs import HOME, START_US, Moment, TlogWriter, hop, write_dataflash, write_tlog, write_ulog

WRITERS: dict[str, Callable[..., Path]] = {"tlog": write_tlog, "dataflash": write_dataflash, "ulog": write_ulog}
SUFFIX = {"tlog": ".tlog", "dataflash": ".BIN", "ulog": ".ulg"}


@pytest.mark.parametrize("kind", WRITERS)
def test_a_flight_is_read_as_it_was_written(kind: str, tmp_path: Path) -> None:
    moments = [moment._replace(roll_rad=0.1, pitch_rad=-0.2, yaw_rad=2.5) for moment in hop()]
    log = read_log(WRITERS[kind](tmp_path / f"a{SUFFIX[kind]}", moments))
    assert log.format == kind
    assert log.vehicle_type == "QUADROTOR"
    (flight,) = split_flights(log)
    assert flight.take_off_s == pytest.approx(5.5, abs=0.3)
    assert flight.landing_s == pytest.approx(44.5, abs=0.3)
    assert flight.armed_s == pytest.approx(3.25, abs=0.3)
    assert flight.disarmed_s == pytest.approx(47.0, abs=0.6)
    assert flight.home == pytest.approx(HOME, abs=1e-5)
    rows = flight.rows("attitude")
    for name, value in (("roll_rad", 0.1), ("pitch_rad", -0.2), ("yaw_rad", 2.5)):
        assert np.abs(rows[name] - value).max() < 2e-4
    position = flight.rows("position")
    wanted = {round(moment.time_s, 2): moment for moment in moments}
    for row in position:
        moment = wanted[round(float(row["time_s"]), 2)]
        assert (row["lat_deg"], row["lon_deg"], row["alt_msl_m"]) == pytest.approx(moment.place, abs=2e-3)
        assert row["east_mps"] == pytest.approx(moment.east_mps, abs=0.01)


@pytest.mark.parametrize("kind", ["tlog", "dataflash"])
def test_the_mission_is_that_which_was_uploaded(kind: str, tmp_path: Path) -> None:
    (flight,) = split_flights(read_log(WRITERS[kind](tmp_path / f"a{SUFFIX[kind]}", hop())))
    assert flight.mission is not None
    assert [item.command for item in flight.mission.items] == [22, 16, 21]
    assert flight.mission.items[1].y == pytest.approx(8.0007)
    assert flight.modes == ("AUTO",)


def test_a_mission_of_px4_has_no_home_among_its_items(tmp_path: Path) -> None:
    mission = 4 << 16 | 4 << 24  # PX4_CUSTOM_MAIN_MODE_AUTO, PX4_CUSTOM_SUB_MODE_AUTO_MISSION
    px4 = dialect.MAV_AUTOPILOT_PX4
    (flight,) = split_flights(read_log(write_tlog(tmp_path / "a.tlog", hop(), autopilot=px4, mode=mission)))
    assert flight.modes == ("MISSION",)
    assert flight.mission is not None
    assert [item.command for item in flight.mission.items] == [16, 22, 16, 21]


def test_a_dataflash_log_has_parameters_battery_and_gps_time(tmp_path: Path) -> None:
    log = read_log(write_dataflash(tmp_path / "a.BIN", hop()))
    assert log.firmware == "ArduCopter V4.5.7"
    assert log.params["WPNAV_SPEED"] == 700.0
    assert log.tables["battery"]["voltage_v"][0] == pytest.approx(12.4)
    assert log.start_unix_s is not None
    assert log.start_unix_s > 1.6e9


def test_a_dataflash_log_that_begins_armed_says_so_at_its_disarming(tmp_path: Path) -> None:
    """ArduPilot begins a log after it has armed."""
    log = read_log(write_dataflash(tmp_path / "a.BIN", hop(), told=[False]))
    (flight,) = split_flights(log)
    assert flight.armed_s == 0.0
    assert flight.disarmed_s == pytest.approx(47.0, abs=0.6)
    assert "arming" not in [remark.subject for remark in log.remarks]


def test_a_dataflash_log_that_never_says_whether_it_is_armed_is_a_flight_with_a_remark(tmp_path: Path) -> None:
    log = read_log(write_dataflash(tmp_path / "a.BIN", hop(), told=[]))
    (flight,) = split_flights(log)
    assert (flight.armed_s, flight.disarmed_s) == (0.0, log.duration_s)
    assert "arming" in [remark.subject for remark in log.remarks]


def test_the_start_of_a_ulog_is_that_of_gps(tmp_path: Path) -> None:
    assert read_log(write_ulog(tmp_path / "a.ulg", hop())).start_unix_s == pytest.approx(START_US / 1e6, abs=1.0)


def test_a_mission_that_was_not_flown_is_none_of_the_flight(tmp_path: Path) -> None:
    def stabilize(writer: TlogWriter, moment: Moment) -> None:
        writer.heartbeat(moment.time_s, armed=moment.up_m > 0.0, mode=0)

    path = write_tlog(tmp_path / "a.tlog", hop(), mission=False, change=stabilize)
    (flight,) = split_flights(read_log(path))
    assert flight.mission is None
    conversion = convert_flight(flight, "x")
    assert "path" in conversion.scenario["operators"][0]["vehicles"][0]["plan"]


def test_an_upload_without_an_item_is_no_mission(tmp_path: Path) -> None:
    writer = TlogWriter()
    writer.upload(0.0)
    whole = bytes(writer.data)
    last = whole.rindex(b"\xfd") - 8
    path = write_tlog(tmp_path / "a.tlog", hop(), mission=False)
    path.write_bytes(whole[:last] + path.read_bytes())
    log = read_log(path)
    assert not log.missions
    assert "1 items of the last transfer are missing" in log.remarks[0].text


def test_lost_frames_are_counted_by_sequence_numbers(tmp_path: Path) -> None:
    log = read_log(write_tlog(tmp_path / "a.tlog", hop(), mission=False, every_lost=4))
    link = log.tables["link"]
    count = len(hop())
    assert link["lost"].sum() == 2 * math.ceil(count / 4)
    assert link["received"].sum() == 3 * count - link["lost"].sum()
    (flight,) = split_flights(log)
    conversion = convert_flight(flight, "x")
    assert conversion.scenario["links"][0]["loss"] == pytest.approx(1 / 6, abs=0.02)


def test_a_clock_that_is_set_is_a_remark_and_no_gap(tmp_path: Path) -> None:
    def step(writer: TlogWriter, moment: Moment) -> None:
        writer.shift_us = -7_200_000_000 if moment.time_s >= 20.0 else 0

    log = read_log(write_tlog(tmp_path / "a.tlog", hop(), change=step))
    assert log.duration_s == pytest.approx(49.75, abs=0.5)
    assert any(remark.subject == "clock" and "-7,199.8 s at 19.8 s" in remark.text for remark in log.remarks)
    assert len(split_flights(log)) == 1


def test_of_several_vehicles_one_is_read_and_the_others_are_named(tmp_path: Path) -> None:
    def second(writer: TlogWriter, moment: Moment) -> None:
        if moment.time_s < 10.0:
            writer.heartbeat(moment.time_s, armed=False, system=7)
            writer.moment(moment._replace(up_m=0.0), system=7)

    path = write_tlog(tmp_path / "a.tlog", hop(), change=second)
    log = read_log(path)
    assert "7 (120 frames)" in log.remarks[0].text
    assert len(split_flights(log)) == 1
    assert not split_flights(read_log(path, 7))
    with pytest.raises(InputError, match=r"system: 9 — expected one of 1, 7"):
        read_log(path, 9)


def test_a_log_of_two_flights_has_two(tmp_path: Path) -> None:
    later = [moment._replace(time_s=moment.time_s + 60.0) for moment in hop()]
    path = write_tlog(tmp_path / "a.tlog", hop())
    with path.open("ab") as file:
        file.write(write_tlog(tmp_path / "b.tlog", later, mission=False).read_bytes())
    first, second = split_flights(read_log(path))
    assert (first.number, second.number) == (1, 2)
    assert second.take_off_s - first.take_off_s == pytest.approx(60.0, abs=0.3)


def test_an_aeroplane_is_refused(tmp_path: Path) -> None:
    (flight,) = split_flights(read_log(write_tlog(tmp_path / "a.tlog", hop(), kind=dialect.MAV_TYPE_FIXED_WING)))
    with pytest.raises(InputError, match="FIXED_WING — expected a multirotor"):
        convert_flight(flight, "x")


def test_a_wrong_suffix_is_told(tmp_path: Path) -> None:
    log = read_log(write_ulog(tmp_path / "a.tlog", hop()))
    assert log.format == "ulog"
    assert "read as what it is, a ulog" in log.remarks[0].text


@pytest.mark.parametrize("data", [b"", b"SYSID_SW_TYPE,10\n", b"\x00" * 5000, b"FMT, 128, 89, FMT"])
def test_what_is_no_log_is_refused(data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "a.tlog"
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"expected a log of MAVLink frames"):
        read_log(path)


def test_a_log_without_an_autopilot_is_refused(tmp_path: Path) -> None:
    writer = TlogWriter()
    writer.upload(0.0)
    path = tmp_path / "a.tlog"
    path.write_bytes(writer.data)
    with pytest.raises(InputError, match="HEARTBEAT"):
        read_log(path)


@pytest.mark.parametrize("kind", WRITERS)
def test_a_truncated_log_has_what_was_written(kind: str, tmp_path: Path) -> None:
    path = WRITERS[kind](tmp_path / f"a{SUFFIX[kind]}", hop())
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2 + 3])
    (flight,) = split_flights(read_log(path))
    assert 15.0 < flight.landing_s < 35.0


def test_a_flown_path_is_near_its_points(tmp_path: Path) -> None:
    (flight,) = split_flights(read_log(write_tlog(tmp_path / "a.tlog", hop(), mission=False)))
    points, speed_mps, off_m = simplify_path(flight)
    assert 3 <= len(points) <= 60
    assert off_m <= 1.0
    assert max(point[0] for point in points) == pytest.approx(60.0, abs=1.5)
    assert 1.0 < speed_mps < 5.0


def test_parameters_of_the_airframe_are_ignored_and_named(tmp_path: Path) -> None:
    (flight,) = split_flights(read_log(write_dataflash(tmp_path / "a.BIN", hop())))
    conversion = convert_flight(flight, "x")
    assert conversion.scenario["operators"][0]["vehicles"][0]["params"] == {"WPNAV_SPEED": 700.0}
    ignored = [fact.value for fact in conversion.facts if fact.kind == "ignored" and fact.subject == "parameters"]
    assert ignored == ["1: ATC_RAT_RLL_P"]


def test_a_log_of_early_firmware_has_messages_of_three_bytes_and_no_pos(tmp_path: Path) -> None:
    """As ArduCopter 3.3 wrote them: STRT is its header alone, and only the receiver says where the vehicle was."""
    path = write_dataflash(tmp_path / "a.BIN", hop(), without=("POS",))
    strt = b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", 250, 3, b"STRT", b"", b"")
    path.write_bytes(path.read_bytes() + strt + b"\xa3\x95\xfa")
    log = read_log(path)
    (flight,) = split_flights(log)
    (whole,) = split_flights(read_log(write_dataflash(tmp_path / "b.BIN", hop())))
    assert flight.take_off_s == pytest.approx(whole.take_off_s, abs=0.3)
    assert len(flight.rows("position")) == pytest.approx(len(whole.rows("position")), abs=2)
    assert [remark.subject for remark in log.remarks] == ["position"]
