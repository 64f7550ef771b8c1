"""Events of autopilots: one list of kinds, each noted by the builtin and read from what an ArduPilot says."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import pytest

import skyrange
from skyrange.codec.mavlink import Packer, decode
from skyrange.codec.mavlink import dialect as mav
from skyrange.vehicle.autopilot_events import AUTOPILOT_EVENTS
from skyrange.vehicle.event_detection import GLITCH_FLAG, EventDetector
from tests.foreign_vehicle import ORIGIN

SOURCES: Final = Path(skyrange.__file__).parent
PAGE: Final = SOURCES.parents[1] / "docs" / "explanation" / "ardupilot.md"
NORTH, EAST = ORIGIN.geodetic_of(30.0, 40.0)
HOME: Final = (round(NORTH * 1e7), round(EAST * 1e7), 25_000)
Told = tuple[str, dict[str, Any]]


class Aboard:
    """An ArduPilot of which the frames are made here, and a ground station that speaks to it."""

    def __init__(self) -> None:
        self.detector = EventDetector(1, ORIGIN)
        self.told: list[Told] = []
        self._own, self._station, self._other = Packer(1, 1), Packer(255, 190), Packer(254, 190)

    def asks(self, *messages: Any, other: bool = False) -> Aboard:
        for message in messages:
            self.detector.on_upload((self._other if other else self._station).pack(message))
        return self

    def says(self, *messages: Any) -> Aboard:
        for message in messages:
            frame = self._own.pack(message)
            found = [*self.detector.on_report(decode(frame)), *self.detector.on_public_frame(frame)]
            self.told += [(kind, dict(data)) for kind, data in found]
        return self

    def flying(self) -> Aboard:
        self.says(beat(armed=True), landed(mav.MAV_LANDED_STATE_IN_AIR))
        self.told.clear()
        return self


def beat(mode: int = 0, armed: bool = False) -> Any:
    base_mode = mav.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
    return mav.MAVLink_heartbeat_message(2, 3, base_mode, mode, 4, 3)


def landed(state: int) -> Any:
    return mav.MAVLink_extended_sys_state_message(0, state)


def text(said: str) -> Any:
    return mav.MAVLink_statustext_message(4, said.encode())


def status(breached: int, kind: int = mav.FENCE_BREACH_BOUNDARY) -> Any:
    return mav.MAVLink_fence_status_message(breached, 1, kind if breached else 0, 1000)


def ekf(flags: int) -> Any:
    return mav.MAVLink_ekf_status_report_message(flags, 0, 0, 0, 0, 0)


def count(items: int, kind: int, system: int = 1) -> Any:
    return mav.MAVLink_mission_count_message(system, 1, items, kind)


def ack(kind: int, result: int = mav.MAV_MISSION_ACCEPTED, system: int = 255) -> Any:
    return mav.MAVLink_mission_ack_message(system, 190, result, kind)


def set_param(name: str, value: float) -> Any:
    return mav.MAVLink_param_set_message(1, 1, name.encode(), value, 9)


def param(name: str, value: float, kind: int = 9) -> Any:
    return mav.MAVLink_param_value_message(name.encode(), value, kind, 1000, 65_535)


def set_home(result: int = mav.MAV_RESULT_ACCEPTED) -> tuple[Any, Any]:
    command = mav.MAV_CMD_DO_SET_HOME
    asked = mav.MAVLink_command_int_message(1, 1, 0, command, 0, 0, 0, 0, 0, 0, *HOME[:2], 25.0)
    return asked, mav.MAVLink_command_ack_message(command, result)


def home_position(lat: int = HOME[0], lon: int = HOME[1], alt: int = HOME[2]) -> Any:
    return mav.MAVLink_home_position_message(lat, lon, alt, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0)


def reached() -> Aboard:
    item = mav.MAVLink_mission_item_int_message(1, 1, 2, 3, mav.MAV_CMD_NAV_WAYPOINT, 0, 1, 0, 0, 0, 0, 1, 1, 5)
    return Aboard().asks(item).says(mav.MAVLink_mission_item_reached_message(2))


SAID: Final[dict[str, Callable[[], list[Told]]]] = {
    "event.armed": lambda: Aboard().says(beat(), beat(armed=True)).told,
    "event.battery": lambda: Aboard().flying().says(text("Battery 1 is low 10.48V used 1234 mAh")).told,
    "event.disarmed": lambda: Aboard().flying().says(beat()).told,
    "event.ekf_failsafe": lambda: Aboard().says(text("EKF variance")).told,
    "event.estimator": lambda: Aboard().says(text("EKF3 IMU0 stopped aiding")).told,
    "event.fence": lambda: Aboard().asks(count(5, 1)).says(ack(1)).told,
    "event.fence_breach": lambda: Aboard().flying().says(text("Max Alt and Circle fences breached")).told,
    "event.fence_cleared": lambda: Aboard().flying().says(text("Fence breach cleared")).told,
    "event.glitch": lambda: Aboard().says(ekf(GLITCH_FLAG)).told,
    "event.home": lambda: Aboard().asks(set_home()[0]).says(set_home()[1], home_position()).told,
    "event.item_reached": lambda: reached().told,
    "event.landed": lambda: Aboard().flying().says(landed(mav.MAV_LANDED_STATE_ON_GROUND)).told,
    "event.mission": lambda: Aboard().asks(count(7, 0)).says(ack(0)).told,
    "event.mode": lambda: Aboard().says(beat(), beat(mav.COPTER_MODE_RTL)).told,
    "event.parameter": lambda: Aboard().asks(set_param("FS_GCS_ENABLE", 1.0)).says(param("FS_GCS_ENABLE", 1.0, 2)).told,
    "event.rally": lambda: Aboard().asks(mav.MAVLink_mission_clear_all_message(1, 1, 2)).says(ack(2)).told,
    "event.takeoff": lambda: Aboard().says(landed(mav.MAV_LANDED_STATE_TAKEOFF)).told,
}
"""What a real ArduCopter says, by the event that is read from it."""
DATA: Final[dict[str, dict[str, Any]]] = {
    "event.battery": {"level": "low", "voltage_v": 10.48, "used_mah": 1234.0, "battery": 1},
    "event.fence": {"items": 5},
    "event.fence_breach": {"fence": "Max Alt and Circle fences"},
    "event.item_reached": {"seq": 2, "command": 16},
    "event.mission": {"items": 7},
    "event.mode": {"mode": "RTL", "number": 6, "reason": ""},
    "event.parameter": {"name": "FS_GCS_ENABLE", "value": 1.0},
    "event.rally": {"items": 0},
}
BY_ENGINES: Final = ("event.reboot",)
"""Noted by the engines of programs themselves, by their clocks and connections."""


def test_the_list_has_what_the_builtin_notes() -> None:
    sources = [file.read_text(encoding="utf-8") for file in (SOURCES / "vehicle" / "builtin").rglob("*.py")]
    assert set(re.findall(r'"(event\.[a-z_]+)"', "".join(sources))) == set(AUTOPILOT_EVENTS)


@pytest.mark.parametrize("kind", AUTOPILOT_EVENTS)
def test_each_kind_is_read_from_what_an_ardupilot_says_or_it_is_told_why_not(kind: str) -> None:
    reason = AUTOPILOT_EVENTS[kind]
    if reason:
        assert kind not in SAID
        page = " ".join(PAGE.read_text(encoding="utf-8").split())
        assert f"`{kind}`" in page
        assert reason in page
    elif kind in BY_ENGINES:
        engines = [SOURCES / "vehicle" / name for name in ("ardupilot/process_fleet.py", "external/vehicle_session.py")]
        assert all(f'"{kind}"' in engine.read_text(encoding="utf-8") for engine in engines)
    else:
        told = SAID[kind]()
        assert [name for name, _ in told] == [kind]
        assert told[0][1] == DATA.get(kind, told[0][1])


def test_a_home_is_in_the_ranges_frame_and_arming_that_moves_it_is_no_event() -> None:
    (_, told), *_ = SAID["event.home"]()
    assert told["east_m"] == pytest.approx(30.0, abs=0.02)
    assert told["north_m"] == pytest.approx(40.0, abs=0.02)
    assert told["up_m"] == pytest.approx(5.0, abs=0.001)
    asked, refused = set_home(mav.MAV_RESULT_DENIED)
    moved = home_position(HOME[0] + 500)
    assert Aboard().asks(asked).says(refused, home_position(), moved).told == [], "refused, then moved by arming"
    assert [kind for kind, _ in Aboard().says(home_position()).flying().says(moved, moved).told] == ["event.home"]


@pytest.mark.parametrize(
    ("said", "kinds"),
    [
        ([text("Circle fence breached"), text("Fence breach cleared")], ["breach", "cleared"]),
        ([status(1), text("Circle fence breached"), status(1)], ["breach"]),
        (
            [text("Circle fence breached"), status(1), status(1), status(0), text("Fence breach cleared")],
            ["breach", "cleared"],
        ),
        ([text("Circle fence breached"), text("Circle fence breached")], ["breach", "breach"]),  # 20 m farther out
        ([status(1), status(1), status(0)], ["breach", "cleared"]),  # a text was lost
        ([status(1), status(1), text("Circle fence breached")], ["breach"]),  # it was late
        ([text("Polygon fence breached"), status(0), text("Max Alt fence breached")], ["breach", "cleared", "breach"]),
        ([status(0), status(0)], []),
    ],
)
def test_one_breach_is_one_event_in_whichever_order_it_is_said(said: list[Any], kinds: list[str]) -> None:
    told = Aboard().flying().says(*said).told
    assert [kind.removeprefix("event.fence_").removesuffix("ed") for kind, _ in told] == [
        kind.removesuffix("ed") for kind in kinds
    ]


def test_on_the_ground_where_there_is_no_text_the_status_says_it() -> None:
    aboard = Aboard().says(beat(), beat(armed=True))
    aboard.told.clear()
    assert aboard.says(status(1), status(0)).told == [
        ("event.fence_breach", {"fence": "Circle or Polygon fence"}),
        ("event.fence_cleared", {}),
    ]
    assert Aboard().says(beat(), status(1)).told == [], "disarmed"


def test_what_was_not_done_is_no_event() -> None:
    refused = ack(0, mav.MAV_MISSION_ERROR)
    assert Aboard().asks(count(7, 0)).says(refused).told == []
    assert Aboard().asks(count(7, 0, system=251)).says(ack(0)).told == [], "to another system"
    assert Aboard().asks(count(3, 0)).asks(count(7, 0), other=True).says(ack(0)).told == [
        ("event.mission", {"items": 3})
    ]
    assert Aboard().says(param("FS_GCS_ENABLE", 1.0, 2), ack(0), home_position()).told == [], "only read"
    denied = Aboard().asks(set_param("WP_SPD", 20.0)).says(param("WP_SPD", 10.0))
    assert denied.told == []
    assert denied.says(param("WP_SPD", 20.0)).told == [("event.parameter", {"name": "WP_SPD", "value": 20.0})]
    assert denied.says(param("WP_SPD", 20.0)).told[1:] == []
    infinite = float("inf")
    assert Aboard().asks(set_param("WP_SPD", infinite)).says(param("WP_SPD", infinite)).told == [], (
        "ArduPilot ignores it"
    )


@pytest.mark.parametrize(("wanted", "told"), [(1.5, 1.0), (300.0, 127.0), (-300.0, -128.0), (2.995, 3.0)])
def test_an_integer_parameter_is_set_to_what_fits(wanted: float, told: float) -> None:
    aboard = Aboard().asks(set_param("FS_THR_ENABLE", wanted)).says(param("FS_THR_ENABLE", told, 2))
    assert aboard.told == [("event.parameter", {"name": "FS_THR_ENABLE", "value": told})]
