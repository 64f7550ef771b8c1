"""Telemetry logs of ground stations: MAVLink frames, each after the time at which it was received or sent."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyrange.core.errors import InputError
from skyrange.flightlog.mission_transfer import MissionTransfer, item_of
from skyrange.flightlog.model import FlightLog, Remark, TableBuilder

_STEP_BACK_S: Final = 1.0
_GAP_S: Final = 3600.0
_NO_AUTOPILOT: Final = dialect.MAV_AUTOPILOT_INVALID
_SIK: Final = (51, 68)
"""System and component of RADIO_STATUS from a SiK radio: '3', 'D'."""


class _Clock:
    """Seconds since the first message by the times in the log, which go on where the writer's clock was set."""

    def __init__(self) -> None:
        self.first_s = self._last_s = math.nan
        self._shift_s = 0.0
        self.steps: list[tuple[float, float]] = []

    @property
    def time_s(self) -> float:
        return self._last_s

    def read(self, unix_s: float) -> float:
        if math.isnan(self.first_s):
            self.first_s, self._last_s = unix_s, 0.0
            return 0.0
        now_s = unix_s - self.first_s + self._shift_s
        step_s = now_s - self._last_s
        if step_s < -_STEP_BACK_S or step_s > _GAP_S:
            self.steps.append((self._last_s, step_s))
            self._shift_s -= step_s
            now_s = self._last_s
        self._last_s = max(now_s, self._last_s)
        return now_s


class _BootTimes:
    """The time of what a vehicle says when by its own clock: the receipt with the least delay since its boot counts."""

    def __init__(self) -> None:
        self._last_s = -math.inf
        self._offsets: list[float] = []
        self.boots = 0

    def add(self, boot_s: float, now_s: float) -> tuple[int, float]:
        """The number of the boot, and the seconds since then."""
        if boot_s < self._last_s - _STEP_BACK_S:
            self.boots += 1
        if self.boots >= len(self._offsets):
            self._offsets.append(math.inf)
        self._last_s = boot_s
        self._offsets[self.boots] = min(self._offsets[self.boots], now_s - boot_s)
        return self.boots, boot_s

    def time_s(self, said: tuple[int, float]) -> float:
        boot, boot_s = said
        return self._offsets[boot] + boot_s


def read_tlog(path: Path, system: int | None = None) -> FlightLog:
    """The log of one vehicle in a telemetry log: `system`, or the one with the most frames.

    Raises `InputError` if no autopilot speaks in the log, or not that one.
    """
    heard, autopilots = _count_systems(path)
    if not heard:
        raise InputError.one(str(path), "HEARTBEAT", "none of an autopilot", "a telemetry log of a vehicle")
    chosen = heard.most_common(1)[0][0] if system is None else system
    if chosen not in heard:
        known = ", ".join(map(str, sorted(heard)))
        raise InputError.one(str(path), "system", str(chosen), f"one of {known}")
    reader = _Reader(path, chosen, has_home=autopilots[chosen] == dialect.MAV_AUTOPILOT_ARDUPILOTMEGA)
    log = reader.read()
    others = [f"{number} ({count} frames)" for number, count in sorted(heard.items()) if number != chosen]
    if not others:
        return log
    text = f"{chosen} is read; other vehicles are left out: {', '.join(others)}. Choose one with --system"
    return replace(log, remarks=(Remark("vehicles", text), *log.remarks))


def _open(path: Path) -> Any:
    return mavutil.mavlogfile(str(path), robust_parsing=True, notimestamps=False)


def _count_systems(path: Path) -> tuple[Counter[int], dict[int, int]]:
    """Frames and MAV_AUTOPILOT by system id, of those with an autopilot."""
    frames: Counter[tuple[int, int]] = Counter()
    pilots: dict[tuple[int, int], int] = {}
    connection = _open(path)
    while (message := connection.recv_msg()) is not None:
        if message.get_type() == "BAD_DATA":
            continue
        source = message.get_srcSystem(), message.get_srcComponent()
        frames[source] += 1
        if message.get_type() == "HEARTBEAT" and message.autopilot != _NO_AUTOPILOT:
            pilots[source] = message.autopilot
    connection.close()
    found: Counter[int] = Counter()
    for source in pilots:
        found[source[0]] += frames[source]
    return found, {system: autopilot for (system, _), autopilot in pilots.items()}


class _Reader:
    def __init__(self, path: Path, system: int, *, has_home: bool) -> None:
        self._path, self._system = path, system
        self._clock, self._boots = _Clock(), _BootTimes()
        self._tables = TableBuilder()
        self._timed: list[tuple[str, tuple[int, float], tuple[Any, ...]]] = []
        self._params: dict[str, float] = {}
        self._mission = MissionTransfer(str(path), has_home=has_home)
        self._sequences: dict[int, int] = {}
        self._seconds: dict[int, list[int]] = {}
        self._bad = 0
        self._type = self._firmware = ""
        self._component: int | None = None
        self._takers: dict[str, Callable[[float, Any], None]] = {
            "MISSION_COUNT": self._take_mission_count,
            "MISSION_CURRENT": self._take_mission_current,
            "MISSION_ITEM": self._take_mission_item,
            "HEARTBEAT": self._take_heartbeat,
            "STATUSTEXT": self._take_statustext,
            "PARAM_VALUE": self._take_param_value,
            "HOME_POSITION": self._take_home_position,
            "GLOBAL_POSITION_INT": self._take_global_position_int,
            "ATTITUDE": self._take_attitude,
            "GPS_RAW_INT": self._take_gps_raw_int,
            "SYS_STATUS": self._take_sys_status,
            "VIBRATION": self._take_vibration,
            "EKF_STATUS_REPORT": self._take_ekf_status_report,
            "MISSION_ITEM_INT": self._take_mission_item,
        }

    def read(self) -> FlightLog:
        connection = _open(self._path)
        while (message := connection.recv_msg()) is not None:
            if message.get_type() == "BAD_DATA":
                self._bad += len(message.data)
                continue
            now_s = self._clock.read(message._timestamp)
            self._take(now_s, message)
        connection.close()
        for second, (received, lost) in self._seconds.items():
            self._tables.add("link", float(second), received, lost)
        for table, said, values in self._timed:
            self._tables.add(table, self._boots.time_s(said), *values)
        tables, left_out = self._tables.build()
        return FlightLog(
            self._path, "tlog", self._clock.first_s, self._clock.time_s, self._firmware, self._type,
            tables, self._params, self._mission.missions, [*self._list_remarks(), *left_out],
        )  # fmt: skip

    def _list_remarks(self) -> list[Remark]:
        remarks = []
        if self._bad:
            remarks.append(Remark("bytes", f"{self._bad:,} bytes belong to no MAVLink frame, and are left out"))
        for at_s, step_s in self._clock.steps:
            text = f"the log's clock steps by {step_s:+,.1f} s at {at_s:.1f} s; what follows is taken as going on"
            remarks.append(Remark("clock", text))
        if self._boots.boots:
            remarks.append(Remark("boot", f"the autopilot has started anew under way: {self._boots.boots} ×"))
        if self._mission.missing:
            text = f"{self._mission.missing} items of the last transfer are missing, and it is left out"
            remarks.append(Remark("mission", text))
        return remarks

    def _take(self, now_s: float, message: Any) -> None:
        source = message.get_srcSystem(), message.get_srcComponent()
        name = message.get_type()
        if name in ("RADIO_STATUS", "RADIO") and source in (_SIK, (self._system, _SIK[1])):
            values = (message.rssi, message.remrssi, message.noise, message.remnoise, message.rxerrors)
            if name == "RADIO_STATUS":
                self._tables.add("radio", now_s, *values)
            return
        if source[0] != self._system:
            self._take_upload(now_s, name, message)
            return
        self._follow_sequence(now_s, source[1], message.get_seq())
        if name == "HEARTBEAT" and message.autopilot != _NO_AUTOPILOT:
            self._component = source[1]
        if source[1] == self._component:
            take = self._takers.get(name)
            if take is not None:
                take(now_s, message)

    def _follow_sequence(self, now_s: float, component: int, sequence: int) -> None:
        before = self._sequences.get(component)
        self._sequences[component] = sequence
        gap = 0 if before is None else (sequence - before) % 256
        if before is not None and gap == 0:
            return  # the log has the frame twice
        second = self._seconds.setdefault(int(now_s), [0, 0])
        second[0] += 1
        if 1 < gap < 128:
            second[1] += gap - 1

    def _take_upload(self, now_s: float, name: str, message: Any) -> None:
        if getattr(message, "target_system", None) != self._system or getattr(message, "mission_type", 0):
            return
        if name == "MISSION_COUNT":
            self._mission.begin(message.count)
        elif name in ("MISSION_ITEM", "MISSION_ITEM_INT"):
            self._mission.add(now_s, message.seq, item_of(message))

    def _take_mission_count(self, _now_s: float, message: Any) -> None:
        if not getattr(message, "mission_type", 0):
            self._mission.begin(message.count)

    def _take_mission_current(self, now_s: float, message: Any) -> None:
        self._tables.add("items", now_s, message.seq)

    def _take_mission_item(self, now_s: float, message: Any) -> None:
        if not getattr(message, "mission_type", 0):
            self._mission.add(now_s, message.seq, item_of(message))

    def _take_heartbeat(self, now_s: float, message: Any) -> None:
        self._type = self._type or _name_type(message.type)
        armed = bool(message.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)
        self._tables.add("states", now_s, armed, mavutil.mode_string_v10(message)[:16])

    def _take_statustext(self, _now_s: float, message: Any) -> None:
        text = message.text
        if not self._firmware and any(word in text for word in ("Copter V", "Plane V", "Rover V", "Sub V")):
            self._firmware = text.partition("(")[0].strip()

    def _take_param_value(self, _now_s: float, message: Any) -> None:
        if math.isfinite(message.param_value):
            self._params[message.param_id] = float(message.param_value)

    def _take_home_position(self, now_s: float, message: Any) -> None:
        self._tables.add("homes", now_s, message.latitude * 1e-7, message.longitude * 1e-7, message.altitude * 1e-3)

    def _take_global_position_int(self, now_s: float, message: Any) -> None:
        said = self._boots.add(message.time_boot_ms * 1e-3, now_s)
        place = (message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3)
        self._timed.append(("position", said, (*place, message.vx * 1e-2, message.vy * 1e-2, message.vz * 1e-2)))

    def _take_attitude(self, now_s: float, message: Any) -> None:
        said = self._boots.add(message.time_boot_ms * 1e-3, now_s)
        self._timed.append(("attitude", said, (message.roll, message.pitch, message.yaw)))

    def _take_gps_raw_int(self, now_s: float, message: Any) -> None:
        hdop = message.eph * 1e-2 if message.eph != 65535 else math.nan
        satellites = message.satellites_visible if message.satellites_visible != 255 else -1
        place = (message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3)
        self._tables.add("gnss", now_s, message.fix_type, satellites, hdop, *place)

    def _take_sys_status(self, now_s: float, message: Any) -> None:
        voltage_v = message.voltage_battery * 1e-3 if message.voltage_battery not in (0, 65535) else math.nan
        current_a = message.current_battery * 1e-2 if message.current_battery >= 0 else math.nan
        remaining = message.battery_remaining * 1e-2 if message.battery_remaining >= 0 else math.nan
        if not math.isnan(voltage_v):
            self._tables.add("battery", now_s, voltage_v, current_a, remaining)

    def _take_vibration(self, now_s: float, message: Any) -> None:
        self._tables.add("vibration", now_s, message.vibration_x, message.vibration_y, message.vibration_z)

    def _take_ekf_status_report(self, now_s: float, message: Any) -> None:
        ratios = (message.velocity_variance, message.pos_horiz_variance, message.pos_vert_variance)
        self._tables.add("estimator", now_s, *ratios, message.compass_variance)


def _name_type(number: int) -> str:
    entry = dialect.enums["MAV_TYPE"].get(number)
    return entry.name.removeprefix("MAV_TYPE_") if entry is not None else str(number)
