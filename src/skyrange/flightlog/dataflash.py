"""DataFlash logs (`.BIN`), which ArduPilot writes on board."""

from __future__ import annotations

import contextlib
import io
import math
import re
from collections import Counter
from collections.abc import Callable
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any, Final

from pymavlink import mavutil
from pymavlink.DFReader import DFReader_binary

from skyrange.codec.mission import MissionItem
from skyrange.core.errors import InputError
from skyrange.core.files import open_input
from skyrange.flightlog.mission_transfer import MissionTransfer
from skyrange.flightlog.model import FlightLog, Remark, TableBuilder

_ARMED, _DISARMED = 10, 11  # events of EV, before ARM (LogEvent in AP_Logger.h)
_FIX_3D: Final = 3
_CENTI: Final = 0.01  # CURR of ArduCopter up to 3.3 has whole hundredths of V and A
_WITH_WEEKS: Final = 1e9
"""Seconds: pymavlink gives times since boot until the log has a GPS week, and then times since 1970."""
_VEHICLES: Final = {
    "ArduCopter": ("QUADROTOR", "MAV_TYPE_QUADROTOR"),
    "ArduPlane": ("FIXED_WING", "MAV_TYPE_FIXED_WING"),
    "ArduRover": ("GROUND_ROVER", "MAV_TYPE_GROUND_ROVER"),
    "Rover": ("GROUND_ROVER", "MAV_TYPE_GROUND_ROVER"),
    "ArduSub": ("SUBMARINE", "MAV_TYPE_SUBMARINE"),
}
"""By the first word of the firmware's message: a MAV_TYPE; frames other than quadrotors are told by FRAME_CLASS."""
_FRAME_CLASSES: Final = {
    1: "QUADROTOR", 2: "HEXAROTOR", 3: "OCTOROTOR", 4: "OCTOROTOR", 5: "HEXAROTOR", 6: "HELICOPTER", 7: "TRICOPTER",
}  # fmt: skip
"""ArduCopter's FRAME_CLASS, as a MAV_TYPE (AP_Motors_Class.h)."""


_DEFINITION: Final = re.compile(rb"\xa3\x95\x80(.)(.)([A-Z][A-Z0-9]{0,3})\0{0,3}", re.DOTALL)
"""An FMT message: header, type, length and name of what it defines."""
_HEADER: Final = 3
"""Bytes; some messages have nothing else (STRT of ArduCopter 3.3)."""


class _Silence(io.TextIOBase):
    """What pymavlink prints of damaged bytes, a line for each, is dropped: remarks say what is left out."""

    def write(self, text: str) -> int:
        return len(text)


class _Source(DFReader_binary):  # type: ignore[misc]
    """pymavlink's reader, which for ever reads a message without a length again."""

    def _parse_next(self) -> Any:
        before = self.offset
        message = super()._parse_next()
        if message is not None and self.offset <= before:
            raise ValueError(f"a message at byte {before} has no length")
        return message


def read_dataflash(path: Path) -> FlightLog:
    """The log of a vehicle. Raises `InputError` for a file with no message that can be read."""
    said = _Silence()
    _check_lengths(path)
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            source = _Source(str(path), zero_time_base=False)
    except Exception as error:  # pymavlink has errors of many kinds for damaged files
        reason = str(error) or type(error).__name__
        raise InputError.one(str(path), "DataFlash log", reason, "a log that ArduPilot wrote") from error
    try:
        return _Reader(path, source).read()
    finally:
        source.close()


def _check_lengths(path: Path) -> None:
    """Raise `InputError` if the log defines a message without a length, at which pymavlink's index never ends."""
    who = str(path)
    with open_input(path, who, "file") as file, mmap(file.fileno(), 0, access=ACCESS_READ) as data:
        found = [match for match in _DEFINITION.finditer(data) if match[2][0] < _HEADER]
        short = [f"{match[3].decode()} of {match[2][0]} bytes" for match in found]
    if short:
        raise InputError.one(who, "FMT", ", ".join(short), f"messages of {_HEADER} bytes, their header, or more")


class _Reader:
    def __init__(self, path: Path, source: Any) -> None:
        self._path, self._source = path, source
        self._tables = TableBuilder()
        self._params: dict[str, float] = {}
        self._mission = MissionTransfer(str(path), has_home=True)
        self._firmware = ""
        self._armed: bool | None = None
        """None until the log says it."""
        self._mode = ""
        self._states: list[tuple[float, bool | None, str]] = []
        self._velocity = (math.nan, math.nan, math.nan)
        self._first_s = self._last_s = math.nan
        self._messages = 0
        self._fixes: list[tuple[float, ...]] = []
        self._has_positions = False
        self._said = _Silence()
        self._end = ""
        self._unlike: Counter[str] = Counter()
        self._takers: dict[str, Callable[[float, Any], None]] = {
            "MSG": self._take_msg,
            "PARM": self._take_parm,
            "CMD": self._take_cmd,
            "MISE": self._take_mise,
            "MODE": self._take_mode,
            "ARM": self._take_arm,
            "EV": self._take_ev,
            "ORGN": self._take_orgn,
            "EKF1": self._take_nkf1,
            "XKF1": self._take_xkf1,
            "NKF1": self._take_nkf1,
            "POS": self._take_pos,
            "ATT": self._take_att,
            "GPS": self._take_gps,
            "BAT": self._take_bat,
            "CURR": self._take_curr,
            "VIBE": self._take_vibe,
            "XKF4": self._take_xkf4,
            "RAD": self._take_rad,
            "NKF4": self._take_xkf4,
            "VNED": self._take_nkf1,
            "EKSR": self._take_xkf4,
        }

    def read(self) -> FlightLog:
        while (message := self._receive()) is not None:
            now_s = float(getattr(message, "_timestamp", self._last_s))
            if math.isnan(self._first_s):
                self._first_s = now_s
            self._last_s = max(now_s, self._last_s) if not math.isnan(self._last_s) else now_s
            self._messages += 1
            take = self._takers.get(message.get_type())
            if take is not None:
                try:
                    take(now_s - self._first_s, message)
                except (AttributeError, TypeError, ValueError):  # other fields, or text in place of a number
                    self._unlike[message.get_type()] += 1
        if not self._messages:
            raise InputError.one(str(self._path), "messages", "none", "a DataFlash log with at least one")
        start_s = self._first_s if self._first_s > _WITH_WEEKS else None
        remarks = [Remark("bytes", self._end)] if self._end else []
        if self._unlike:
            shown = ", ".join(f"{count:,} {name}" for name, count in sorted(self._unlike.items()))
            remarks.append(Remark("messages", f"messages with other fields than expected are left out: {shown}"))
        if start_s is None:
            remarks.append(Remark("clock", "the log has no GPS time: times are since boot"))
        if self._mission.missing:
            remarks.append(Remark("mission", f"{self._mission.missing} of its items are missing; it is left out"))
        if self._fixes and not self._has_positions:
            for row in self._fixes:
                self._tables.add("position", *row)
            remarks.append(Remark("position", "the log has no POS: positions are those of the GNSS receiver"))
        remarks += self._add_states()
        tables, left_out = self._tables.build()
        return FlightLog(
            self._path, "dataflash", start_s, self._last_s - self._first_s, self._firmware, self._name_type(),
            tables, self._params, self._mission.missions, [*remarks, *left_out],
        )  # fmt: skip

    def _add_states(self) -> list[Remark]:
        """Add the states. Before the log says whether the vehicle is armed, it is not what the log says first.

        ArduPilot begins a log after it has armed, unless LOG_DISARMED is set: its ARM and EV are not in the log
        (AP_Logger.cpp, `log_while_disarmed`; AP_Arming_Copter.cpp, `arm`).
        """
        known = next((armed for _, armed, _ in self._states if armed is not None), None)
        before = True if known is None else not known
        for time_s, armed, mode in self._states:
            self._tables.add("states", time_s, before if armed is None else armed, mode)
        text = "the log never says whether the vehicle is armed: it is taken as armed all the time"
        return [Remark("arming", text)] if self._states and known is None else []

    def _receive(self) -> Any:
        """The next message; None at the end, or where the rest cannot be read."""
        try:
            with contextlib.redirect_stdout(self._said), contextlib.redirect_stderr(self._said):
                return self._source.recv_msg()
        except Exception as error:
            self._end = f"what follows cannot be read: {error}"
            return None

    def _name_type(self) -> str:
        name = _VEHICLES.get(self._firmware.partition(" ")[0], ("", ""))[0]
        if name == "QUADROTOR":
            return _FRAME_CLASSES.get(int(self._params.get("FRAME_CLASS", 1)), "QUADROTOR")
        return name

    def _take_msg(self, _now_s: float, message: Any) -> None:
        text = message.Message
        for word in ("ArduCopter", "ArduPlane", "ArduRover", "Rover", "ArduSub", "APM:Copter"):
            if not self._firmware and text.startswith((f"{word} V", f"{word} v")):
                self._firmware = text.replace("APM:Copter", "ArduCopter").partition("(")[0].strip()

    def _take_parm(self, _now_s: float, message: Any) -> None:
        if math.isfinite(message.Value):
            self._params[message.Name] = float(message.Value)

    def _take_cmd(self, now_s: float, message: Any) -> None:
        if message.CNum == 0:
            self._mission.begin(0)
            self._mission.begin(message.CTot)
        values = (message.Prm1, message.Prm2, message.Prm3, message.Prm4)
        item = MissionItem(getattr(message, "Frame", 3), message.CId, *values, message.Lat, message.Lng, message.Alt)
        self._mission.add(now_s, message.CNum, item)

    def _take_mise(self, now_s: float, message: Any) -> None:
        self._tables.add("items", now_s, message.CNum)

    def _take_mode(self, now_s: float, message: Any) -> None:
        kind = _VEHICLES.get(self._firmware.partition(" ")[0], ("", "MAV_TYPE_QUADROTOR"))[1]
        number = message.ModeNum if isinstance(message.ModeNum, int) else message.Mode
        names = mavutil.mode_mapping_bynumber(getattr(mavutil.mavlink, kind)) or {}
        self._mode = str(names.get(number, message.Mode))[:16]
        self._states.append((now_s, self._armed, self._mode))

    def _take_arm(self, now_s: float, message: Any) -> None:
        self._armed = bool(message.ArmState)
        self._states.append((now_s, self._armed, self._mode))

    def _take_ev(self, now_s: float, message: Any) -> None:
        if message.Id in (_ARMED, _DISARMED):
            self._armed = message.Id == _ARMED
            self._states.append((now_s, self._armed, self._mode))

    def _take_orgn(self, now_s: float, message: Any) -> None:
        if message.Type == 1:  # home; 0 is the estimator's origin
            self._tables.add("homes", now_s, message.Lat, message.Lng, message.Alt)

    def _take_xkf1(self, _now_s: float, message: Any) -> None:
        if not getattr(message, "C", 0):
            self._velocity = (message.VN, message.VE, message.VD)

    def _take_nkf1(self, _now_s: float, message: Any) -> None:
        self._velocity = (message.VN, message.VE, message.VD)

    def _take_pos(self, now_s: float, message: Any) -> None:
        self._has_positions = True
        self._tables.add("position", now_s, message.Lat, message.Lng, message.Alt, *self._velocity)

    def _take_att(self, now_s: float, message: Any) -> None:
        self._tables.add("attitude", now_s, *map(math.radians, (message.Roll, message.Pitch, message.Yaw)))

    def _take_gps(self, now_s: float, message: Any) -> None:
        if not getattr(message, "I", 0):
            place = (message.Lat, message.Lng, message.Alt)
            self._tables.add("gnss", now_s, message.Status, message.NSats, getattr(message, "HDop", math.nan), *place)
            if message.Status >= _FIX_3D:
                self._fixes.append((now_s, *place, *self._velocity))

    def _take_bat(self, now_s: float, message: Any) -> None:
        if not getattr(message, "I", getattr(message, "Inst", 0)):
            remaining = getattr(message, "RemPct", math.nan)
            self._tables.add("battery", now_s, message.Volt, message.Curr, remaining / 100.0)

    def _take_curr(self, now_s: float, message: Any) -> None:
        unit = _CENTI if isinstance(message.Volt, int) else 1.0
        self._tables.add("battery", now_s, message.Volt * unit, message.Curr * unit, math.nan)

    def _take_vibe(self, now_s: float, message: Any) -> None:
        if not getattr(message, "IMU", 0):
            self._tables.add("vibration", now_s, message.VibeX, message.VibeY, message.VibeZ)

    def _take_xkf4(self, now_s: float, message: Any) -> None:
        if not getattr(message, "C", 0):
            self._tables.add("estimator", now_s, message.SV, message.SP, message.SH, message.SM)

    def _take_rad(self, now_s: float, message: Any) -> None:
        values = (message.RSSI, message.RemRSSI, message.Noise, message.RemNoise, message.RxErrors)
        self._tables.add("radio", now_s, *values)
