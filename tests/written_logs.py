"""Logs of flights that tests write: telemetry logs, DataFlash logs and ULogs of a vehicle that flies as is wanted."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Collection, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as dialect

START_US = 1_700_000_000_000_000
HOME = (47.0, 8.0, 400.0)
METRES = 111_319.49


class Moment(NamedTuple):
    """Where a vehicle is at a time, in metres from `HOME`, and how it moves and leans."""

    time_s: float
    east_m: float = 0.0
    north_m: float = 0.0
    up_m: float = 0.0
    east_mps: float = 0.0
    north_mps: float = 0.0
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    yaw_rad: float = 0.0

    @property
    def place(self) -> tuple[float, float, float]:
        """Latitude, longitude, altitude."""
        lat_deg = HOME[0] + self.north_m / METRES
        return lat_deg, HOME[1] + self.east_m / METRES / math.cos(math.radians(HOME[0])), HOME[2] + self.up_m


def hop(duration_s: float = 40.0, rate_hz: float = 4.0, high_m: float = 20.0) -> list[Moment]:
    """A flight east and back that climbs to `high_m`, after five seconds at the ground and before five more."""
    moments = []
    for k in range(round((duration_s + 10.0) * rate_hz)):
        time_s = k / rate_hz
        share = min(max((time_s - 5.0) / duration_s, 0.0), 1.0)
        up_m = high_m * min(1.0, 8.0 * share, 8.0 * (1.0 - share))
        east_m = 60.0 * math.sin(math.pi * share)
        east_mps = 60.0 * math.pi / duration_s * math.cos(math.pi * share) if 0.0 < share < 1.0 else 0.0
        moments.append(Moment(time_s, east_m, 0.0, up_m, east_mps))
    return moments


MISSION = (
    (0, 16, HOME[0], HOME[1], HOME[2]), (3, 22, 0.0, 0.0, 20.0), (3, 16, 47.0, 8.0007, 20.0), (3, 21, 0.0, 0.0, 0.0),
)  # fmt: skip
"""Frame, command, x, y and z of each item; the first is home."""


class TlogWriter:
    """Frames of one or several systems, each after its time."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.shift_us = 0
        self._links: dict[tuple[int, int], Any] = {}

    def link(self, system: int = 1, component: int = 1) -> Any:
        """The encoder of a system."""
        if (system, component) not in self._links:
            self._links[system, component] = dialect.MAVLink(None, system, component)
        return self._links[system, component]

    def add(self, time_s: float, message: Any, system: int = 1, component: int = 1, *, lost: bool = False) -> None:
        """Add a frame, or count it as lost."""
        link = self.link(system, component)
        frame = message.pack(link)
        link.seq = (link.seq + 1) % 256
        if not lost:
            self.data += struct.pack(">Q", START_US + self.shift_us + round(time_s * 1e6)) + frame

    def heartbeat(
        self,
        time_s: float,
        *,
        armed: bool,
        mode: int = 3,
        system: int = 1,
        kind: int = dialect.MAV_TYPE_QUADROTOR,
        autopilot: int = dialect.MAV_AUTOPILOT_ARDUPILOTMEGA,
    ) -> None:
        """Add a heartbeat of ArduPilot, or of another autopilot."""
        base = dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (dialect.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0)
        message = dialect.MAVLink_heartbeat_message(kind, autopilot, base, mode, 4, 3)
        self.add(time_s, message, system)

    def moment(self, moment: Moment, *, boot_s: float = 0.0, system: int = 1, lost: bool = False) -> None:
        """Add position and attitude."""
        boot_ms = round((moment.time_s + boot_s) * 1e3)
        lat_deg, lon_deg, alt_m = moment.place
        velocity = round(moment.north_mps * 1e2), round(moment.east_mps * 1e2), 0
        position = dialect.MAVLink_global_position_int_message(
            boot_ms,
            round(lat_deg * 1e7),
            round(lon_deg * 1e7),
            round(alt_m * 1e3),
            round(moment.up_m * 1e3),
            *velocity,
            0,
        )
        attitude = dialect.MAVLink_attitude_message(
            boot_ms, moment.roll_rad, moment.pitch_rad, moment.yaw_rad, 0.0, 0.0, 0.0
        )
        self.add(moment.time_s, position, system, lost=lost)
        self.add(moment.time_s, attitude, system, lost=lost)

    def upload(self, time_s: float, items: Sequence[tuple[int, int, float, float, float]] = MISSION) -> None:
        """Add the upload of a mission by a ground station."""
        self.add(time_s, dialect.MAVLink_mission_count_message(1, 1, len(items)), 255, 190)
        for number, (frame, command, x, y, z) in enumerate(items):
            whole = round(x * 1e7), round(y * 1e7)
            item = dialect.MAVLink_mission_item_int_message(1, 1, number, frame, command, 0, 1, 0, 0, 0, 0, *whole, z)
            self.add(time_s, item, 255, 190)


def write_tlog(
    path: Path,
    moments: Iterable[Moment],
    *,
    mission: bool = True,
    change: Callable[[TlogWriter, Moment], None] = lambda _writer, _moment: None,
    kind: int = dialect.MAV_TYPE_QUADROTOR,
    autopilot: int = dialect.MAV_AUTOPILOT_ARDUPILOTMEGA,
    mode: int = 3,
    every_lost: int = 0,
) -> Path:
    """Write a telemetry log of a flight: armed while it is above the ground, and two seconds before and after."""
    moments, writer = list(moments), TlogWriter()
    flying = [moment.time_s for moment in moments if moment.up_m > 0.0]
    if mission:
        writer.upload(0.0)
    for number, moment in enumerate(moments):
        change(writer, moment)
        armed = bool(flying) and flying[0] - 2.0 <= moment.time_s <= flying[-1] + 2.0
        writer.heartbeat(moment.time_s, armed=armed, mode=mode, kind=kind, autopilot=autopilot)
        writer.moment(moment, lost=bool(every_lost) and number % every_lost == 0)
    path.write_bytes(writer.data)
    return path


_FORMATS = {
    "GPS": ("QBBIHBLLee", "TimeUS,I,Status,GMS,GWk,NSats,Lat,Lng,Alt,Spd"),
    "POS": ("QLLfff", "TimeUS,Lat,Lng,Alt,RelHomeAlt,RelOriginAlt"),
    "ATT": ("Qccc", "TimeUS,Roll,Pitch,Yaw"),
    "XKF1": ("QBfff", "TimeUS,C,VN,VE,VD"),
    "MODE": ("QBBB", "TimeUS,Mode,ModeNum,Rsn"),
    "ARM": ("QB", "TimeUS,ArmState"),
    "PARM": ("QNf", "TimeUS,Name,Value"),
    "CMD": ("QHHHffffLLfB", "TimeUS,CTot,CNum,CId,Prm1,Prm2,Prm3,Prm4,Lat,Lng,Alt,Frame"),
    "MSG": ("QZ", "TimeUS,Message"),
    "BAT": ("QBffB", "TimeUS,Inst,Volt,Curr,RemPct"),
}
"""By message: types of its fields (Structure.rst of AP_Logger) and their names."""
_STRUCT = {"Q": "Q", "B": "B", "I": "I", "H": "H", "L": "i", "e": "i", "f": "f", "c": "h", "N": "16s", "Z": "64s"}
_SCALE = {"L": 1e7, "e": 100.0, "c": 100.0}


def write_dataflash(
    path: Path, moments: Iterable[Moment], told: Sequence[bool] = (True, False), without: Collection[str] = ()
) -> Path:
    """Write a DataFlash log of a flight of ArduCopter with `MISSION`, with ARM of arming and disarming as `told`, and
    `without` some messages.
    """
    numbers = {name: 129 + k for k, name in enumerate(_FORMATS)}
    data = bytearray()

    def define(number: int, name: str, types: str, columns: str, size: int) -> None:
        data.extend(b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", number, size, *(
            text.encode() for text in (name, types, columns))))  # fmt: skip

    def add(name: str, *values: Any) -> None:
        if name in without:
            return
        types = _FORMATS[name][0]
        scaled = [
            text.encode()
            if isinstance(text := value, str)
            else round(value * _SCALE[kind])
            if kind in _SCALE
            else value
            for kind, value in zip(types, values, strict=True)
        ]
        layout = "<" + "".join(_STRUCT[kind] for kind in types)
        data.extend(b"\xa3\x95" + bytes([numbers[name]]) + struct.pack(layout, *scaled))

    define(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns", 89)
    for name, (types, columns) in _FORMATS.items():
        define(numbers[name], name, types, columns, 3 + struct.calcsize("<" + "".join(_STRUCT[kind] for kind in types)))
    moments = list(moments)
    flying = [moment.time_s for moment in moments if moment.up_m > 0.0]
    add("MSG", 1, "ArduCopter V4.5.7 (abc)")
    add("PARM", 1, "WPNAV_SPEED", 700.0)
    add("PARM", 1, "ATC_RAT_RLL_P", 0.2)
    for number, (frame, command, x, y, z) in enumerate(MISSION):
        add("CMD", 1, len(MISSION), number, command, 0.0, 0.0, 0.0, 0.0, x, y, z, frame)
    add("MODE", 1, 3, 3, 1)
    armed = False
    for moment in moments:
        at = round(moment.time_s * 1e6) + 1
        lat_deg, lon_deg, alt_m = moment.place
        add("GPS", at, 0, 3, round(moment.time_s * 1e3) + 1000, 2284, 14, lat_deg, lon_deg, alt_m, 0.0)
        now_armed = flying[0] - 2.0 <= moment.time_s <= flying[-1] + 2.0
        if now_armed != armed:
            armed = now_armed
            if armed in told:
                add("ARM", at, int(armed))
        add("XKF1", at, 0, moment.north_mps, moment.east_mps, 0.0)
        add("POS", at, lat_deg, lon_deg, alt_m, moment.up_m, moment.up_m)
        lean = (math.degrees(value) for value in (moment.roll_rad, moment.pitch_rad, moment.yaw_rad))
        add("ATT", at, *lean)
        add("BAT", at, 0, 12.4, 15.0, 80)
    path.write_bytes(data)
    return path


_TOPICS = {
    "vehicle_status": "uint64_t timestamp;uint8_t arming_state;uint8_t nav_state;uint8_t vehicle_type",
    "vehicle_global_position": "uint64_t timestamp;double lat;double lon;float alt;float vel_n;float vel_e;float vel_d",
    "vehicle_attitude": "uint64_t timestamp;float[4] q",
    "sensor_gps": "uint64_t timestamp;uint64_t time_utc_usec;double latitude_deg;double longitude_deg;"
    "double altitude_msl_m;float hdop;uint8_t fix_type;uint8_t satellites_used",
}
_C = {"uint64_t": "Q", "uint8_t": "B", "double": "d", "float": "f", "float[4]": "4f"}


def write_ulog(path: Path, moments: Iterable[Moment]) -> Path:
    """Write a ULog of a flight of PX4 (https://docs.px4.io/main/en/dev_log/ulog_file_format.html)."""
    data = bytearray(b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1_000_000))

    def add(kind: bytes, content: bytes) -> None:
        data.extend(struct.pack("<H", len(content)) + kind + content)

    add(b"B", bytes(40))
    key = b"char[3] sys_name"
    add(b"I", bytes([len(key)]) + key + b"PX4")
    parameter = b"float MPC_XY_CRUISE"
    add(b"P", bytes([len(parameter)]) + parameter + struct.pack("<f", 6.0))
    for name, fields in _TOPICS.items():
        add(b"F", f"{name}:{fields};".encode())
    for number, name in enumerate(_TOPICS):
        add(b"A", struct.pack("<BH", 0, number) + name.encode())

    def row(name: str, *values: Any) -> None:
        layout = "<" + "".join(_C[field.split()[0]] for field in _TOPICS[name].split(";"))
        number = list(_TOPICS).index(name)
        add(b"D", struct.pack("<H", number) + struct.pack(layout, *values))

    moments = list(moments)
    flying = [moment.time_s for moment in moments if moment.up_m > 0.0]
    for moment in moments:
        at = 1_000_000 + round(moment.time_s * 1e6)
        lat_deg, lon_deg, alt_m = moment.place
        armed = flying[0] - 2.0 <= moment.time_s <= flying[-1] + 2.0
        row("vehicle_status", at, 2 if armed else 1, 3, 1)
        row("vehicle_global_position", at, lat_deg, lon_deg, alt_m, moment.north_mps, moment.east_mps, 0.0)
        row("vehicle_attitude", at, *_quaternion(moment.roll_rad, moment.pitch_rad, moment.yaw_rad))
        row("sensor_gps", at, START_US + round(moment.time_s * 1e6), lat_deg, lon_deg, alt_m, 0.7, 3, 12)
    path.write_bytes(data)
    return path


def _quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    (sr, cr), (sp, cp), (sy, cy) = ((math.sin(a / 2.0), math.cos(a / 2.0)) for a in (roll, pitch, yaw))
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
