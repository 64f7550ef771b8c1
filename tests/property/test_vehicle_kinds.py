"""Every MAV_TYPE with every MAV_AUTOPILOT: flown with its own modes, or refused before anything is commanded."""

from __future__ import annotations

from itertools import product
from typing import Any, Final, cast

import pytest
from pymavlink import mavutil

from skyrange.codec.mavlink import Deframer, Packer, decode
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.flight_modes import find_flight_modes, is_arducopter_multirotor, mode_name
from skyrange.contracts.mailboxes import Arrival
from skyrange.core.errors import InputError
from skyrange.core.ids import FrameId, Port
from skyrange.io.mavlink.connections import MavlinkConnection
from skyrange.vehicle.contract import VehicleSpec
from skyrange.vehicle.event_detection import EventDetector
from skyrange.vehicle.external.vehicle_session import VehicleSession
from tests.foreign_vehicle import ORIGIN


def values_of(enum: str) -> list[int]:
    """The values of an enum of the dialect, its end mark (a value that no enum has) included."""
    return sorted(mav.enums[enum])


ARDUPILOT: Final = mav.MAV_AUTOPILOT_ARDUPILOTMEGA
PAIRS: Final = [*product(values_of("MAV_TYPE"), values_of("MAV_AUTOPILOT"))]
ENUMS: Final = {
    id(mavutil.mode_mapping_acm): "COPTER_MODE",
    id(mavutil.mode_mapping_apm): "PLANE_MODE",
    id(mavutil.mode_mapping_rover): "ROVER_MODE",
    id(mavutil.mode_mapping_tracker): "TRACKER_MODE",
    id(mavutil.mode_mapping_sub): "SUB_MODE",
}
"""The enum of the dialect that belongs to a table of pymavlink. The dialect has none for blimps."""
FLOWN: Final = {
    (getattr(mav, f"MAV_TYPE_{kind}ROTOR" if kind != "TRI" else "MAV_TYPE_TRICOPTER"), ARDUPILOT)
    for kind in ("QUAD", "HEXA", "OCTO", "DECA", "DODECA", "TRI")
}
ARM: Final = mav.MAVLink_command_long_message(1, 1, mav.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0)
ARMED: Final = mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mav.MAV_MODE_FLAG_SAFETY_ARMED


def expected_name(kind: tuple[int, int], number: int) -> str:
    """The name of a mode by pymavlink's own table of that vehicle."""
    table = mavutil.AP_MAV_TYPE_MODE_MAP_DEFAULT.get(kind[0]) if kind[1] == ARDUPILOT else None
    enum = ENUMS.get(id(table), "")
    entry = mav.enums[enum].get(number) if enum else None
    return str(number) if entry is None or "ENUM_END" in entry.name else entry.name.removeprefix(f"{enum}_")


class Vehicle:
    """A vehicle in process: its session, and what was written to it."""

    def __init__(self, kind: tuple[int, int]) -> None:
        self.kind = kind
        self.connected, self.trouble, self.address = True, "", "tcp:127.0.0.1:9"
        self.commanded: list[int] = []
        self.session = VehicleSession(
            VehicleSpec("blue/b1", 1), cast("MavlinkConnection", self), ORIGIN, 10.0, open_=True
        )
        self._packer, self._station = Packer(1, 1), Packer(255, 190)

    def write(self, frame: bytes) -> bool:
        self.commanded.append(decode(frame).command)
        return True

    def beat(self, mode: int = 0, base_mode: int = mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED) -> None:
        self.say(mav.MAVLink_heartbeat_message(*self.kind, base_mode, mode, 3, 3))

    def say(self, message: Any) -> None:
        for piece in Deframer().feed(self._packer.pack(message)):
            self.session.on_frame(piece, 1.0)

    def refusal(self) -> str:
        """Why its heartbeat is refused; "" if it is not."""
        try:
            self.beat()
        except InputError as error:
            return str(error)
        return ""

    def command(self) -> None:
        """What a ground station does before a flight."""
        port = Port("blue/b1.autopilot", "autopilot:blue/b1")
        frame = self._station.pack(ARM)
        self.session.send(Arrival(port, 0, frame, "", FrameId(port.link, "rev", "x", 0)))


def test_each_is_flown_with_its_own_modes_or_refused_before_anything_is_commanded() -> None:
    """With both permissions given. A heartbeat decides, the first and every later one."""
    flown = set()
    for kind in PAIRS:
        vehicle = Vehicle(kind)
        vehicle.command()
        assert not vehicle.commanded, f"{kind}: commanded before its first heartbeat"
        refusal = vehicle.refusal()
        if refusal:
            entries = (mav.enums["MAV_TYPE"][kind[0]].name, mav.enums["MAV_AUTOPILOT"][kind[1]].name)
            words = ["blue/b1", vehicle.address, "MAV_TYPE_QUADROTOR", *(n for n in entries if "ENUM_END" not in n)]
            assert all(word in refusal for word in words), refusal
            vehicle.command()
            assert not vehicle.commanded, f"{kind}: commanded though it was refused"
            continue
        flown.add(kind)
        vehicle.command()
        assert vehicle.commanded == [mav.MAV_CMD_COMPONENT_ARM_DISARM], kind
        vehicle.beat(mav.COPTER_MODE_GUIDED, ARMED)
        notes = [(name, data) for name, data, _ in vehicle.session.take_notes() if name != "event.interlock"]
        modes = {"mode": "GUIDED", "number": 4, "reason": ""}
        assert notes == [("event.mode", modes), ("event.armed", {"forced": False})], kind
    assert flown == FLOWN


def test_one_that_becomes_another_is_refused_and_not_commanded_any_more() -> None:
    """As after a reboot into another firmware, or where another vehicle answers at the address."""
    vehicle = Vehicle((mav.MAV_TYPE_HEXAROTOR, ARDUPILOT))
    vehicle.beat()
    vehicle.kind = (mav.MAV_TYPE_FIXED_WING, ARDUPILOT)
    with pytest.raises(InputError, match="MAV_TYPE_FIXED_WING"):
        vehicle.beat()
    vehicle.command()
    assert not vehicle.commanded


def test_one_that_reboots_is_not_commanded_until_its_next_heartbeat() -> None:
    vehicle = Vehicle((mav.MAV_TYPE_QUADROTOR, ARDUPILOT))
    vehicle.beat()
    for boot_ms in (60_000, 100):
        vehicle.say(mav.MAVLink_global_position_int_message(boot_ms, 407_780_000, -739_550_000, 0, 0, 0, 0, 0, 0))
    vehicle.command()
    assert not vehicle.commanded
    assert "event.reboot" in [kind for kind, *_ in vehicle.session.take_notes()]
    vehicle.beat()
    vehicle.command()
    assert vehicle.commanded


def test_a_mode_is_named_by_the_vehicle_s_own_table() -> None:
    """In notes of engines and of ground stations: 4 is GUIDED on ArduCopter, ACRO on ArduPlane, and 4 on PX4."""
    highest = max(max(mav.enums[enum]) for enum in ENUMS.values()) + 1
    for kind in PAIRS:
        for number in range(highest + 1):
            assert mode_name(*kind, number) == expected_name(kind, number), (kind, number)
        if is_arducopter_multirotor(*kind):
            assert (find_flight_modes(*kind) or {})[mav.COPTER_MODE_GUIDED] == "GUIDED"


def test_modes_and_arming_of_any_autopilot_are_events() -> None:
    """Of all but those that say that they are none, such as a ground station."""
    for kind in PAIRS:
        detector, packer = EventDetector(1, ORIGIN), Packer(1, 1)
        told: list[Any] = []
        for mode, base_mode in ((0, 0), (4, ARMED)):
            frame = packer.pack(mav.MAVLink_heartbeat_message(*kind, base_mode, mode, 3, 3))
            told += detector.on_report(decode(frame))
        named = ("event.mode", {"mode": expected_name(kind, 4), "number": 4, "reason": ""})
        is_none = kind[1] == mav.MAV_AUTOPILOT_INVALID
        assert told == ([] if is_none else [named, ("event.armed", {"forced": False})]), kind
