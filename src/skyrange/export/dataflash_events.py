"""Messages of DataFlash logs from events: parameters, modes, arming, failsafes, homes; and labels of hostile acts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

import numpy as np
import pyarrow as pa

from skyrange.core.geodesy import Origin
from skyrange.export.dataflash_reports import AHRS_HOME
from skyrange.export.dataflash_rows import I32_LIMITS, Rows, make_rows, scaled
from skyrange.metrics.time_series import read_label_rows
from skyrange.record.notes import parse_details
from skyrange.vehicle.builtin.memory_card import EV_ARMED, EV_DISARMED, REASONS
from skyrange.vehicle.builtin.parameters.table import INDEX, PARAMETERS

_LAND_COMPLETE, _SET_HOME, _NOT_LANDED = 18, 25, 28
"""LogEvent (AP_Logger.h)."""
_BATT, _GCS, _FENCE, _GPS, _CRASH, _EKFCHECK, _EKFINAV, _DEADRECKON = 6, 8, 9, 11, 12, 16, 17, 31
"""LogErrorSubsystem (AP_Logger.h)."""
_RESOLVED, _OCCURRED, _GLITCH, _BAD_VARIANCE = 0, 1, 2, 2
"""LogErrorCode (AP_Logger.h)."""
_FENCES: Final = {"Max Alt": 1, "Circle": 2, "Polygon": 4, "Min Alt": 8}
"""Bits of a fence breach, which are the code of its ERR (ArduCopter/fence.cpp), by the names that events have."""
_FAILSAFES: Final = {"gcs_failsafe": _GCS, "deadreckon_failsafe": _DEADRECKON}
"""Failsafes whose own event is a change of mode or a disarming with this reason."""
_METHODS: Final = {
    "command": 1, "forced": 1, "aux_switch": 2, "termination": 5, "battery_failsafe": 7, "crash": 12, "landed": 13,
    "mission_exit": 14, "fence_breach": 15, "disarm_delay": 17, "gcs_failsafe": 18, "failsafe_action_terminate": 20,
    "deadreckon_failsafe": 33,
}  # fmt: skip
_UNKNOWN_METHOD: Final = 100
"""AP_Arming::Method (AP_Arming.h), by the reason of a disarming. No event has that of an arming."""
_KINDS: Final = ("attack", "fault", "harmless")
"""Of acts, numbered as in LABL."""

REBOOT: Final = "skyrange: reboot. A real log would end here"


class EventRows:
    """Rows of the events of some aircraft, and the parameters that each has at the time."""

    def __init__(self, vehicles: list[str], params: Mapping[int, Mapping[str, float]], origin: Origin) -> None:
        self._numbers = {name: number for number, name in enumerate(vehicles)}
        self.params = {number: dict(values) for number, values in params.items()}
        self._origin = origin
        self.systems: dict[int, set[int]] = {
            number: {int(values.get("SYSID_THISMAV", 1))} for number, values in self.params.items()
        }
        """MAVLink system ids that each autopilot has had."""

    def rows(self, table: pa.Table, stored: Callable[[int, int, int], Rows | None]) -> Iterator[Rows]:
        """The messages of events in order of time. `stored` gives those of a mission that an aircraft has stored at a
        time, by its number of items.
        """
        for row in table.to_pylist():
            vehicle = self._numbers.get(row["about"])
            if vehicle is None:
                continue
            data, time_ns = parse_details(row["data"]), int(row["time_ns"])
            if row["kind"] == "event.mission":
                found = stored(vehicle, time_ns, int(_number(data, "items", -1.0)))
                if found is not None:
                    yield found
            elif row["kind"] in _EVENTS:
                for name, fields in _EVENTS[row["kind"]](self, vehicle, data):
                    yield make_rows(name, np.array([vehicle]), np.array([time_ns]), **fields)

    def _arming(self, vehicle: int, data: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
        yield "ARM", {
            "ArmState": 1, "ArmChecks": self._checks(vehicle), "Forced": bool(data.get("forced")),
            "Method": _UNKNOWN_METHOD,
        }  # fmt: skip
        yield "EV", {"Id": EV_ARMED}

    def _disarming(self, vehicle: int, data: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
        reason = str(data.get("reason"))
        if reason == "crash":
            yield "ERR", {"Subsys": _CRASH, "ECode": _OCCURRED}
        yield from self._failsafe(reason)
        yield "ARM", {
            "ArmState": 0, "ArmChecks": self._checks(vehicle), "Forced": reason == "forced",
            "Method": _METHODS.get(reason, _UNKNOWN_METHOD),
        }  # fmt: skip
        yield "EV", {"Id": EV_DISARMED}

    def _checks(self, vehicle: int) -> int:
        """ARMING_CHECK as the bits that it is."""
        return int(_number(self.params[vehicle], "ARMING_CHECK", 0.0)) & 0xFFFF_FFFF

    @staticmethod
    def _failsafe(reason: str) -> Iterator[tuple[str, dict[str, Any]]]:
        if reason in _FAILSAFES:
            yield "ERR", {"Subsys": _FAILSAFES[reason], "ECode": _OCCURRED}

    def _mode(self, _vehicle: int, data: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
        reason, number = str(data.get("reason")), int(_number(data, "number", -1.0))
        yield from self._failsafe(reason)
        if number >= 0:
            yield "MODE", {"Mode": number & 0xFF, "ModeNum": number & 0xFF, "Rsn": REASONS.get(reason, 0)}

    def _parameter(self, vehicle: int, data: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
        name, value = str(data.get("name")), _number(data, "value", np.nan)
        self.params[vehicle][name] = value
        yield "PARM", {"Name": name.encode(errors="replace"), "Value": value, "Default": default_of(name)}

    def _home(self, _vehicle: int, data: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
        place = [_number(data, name, np.nan) for name in ("east_m", "north_m", "up_m")]
        yield "EV", {"Id": _SET_HOME}
        if np.isfinite(place).all():
            lat, lon = self._origin.geodetic_of(place[0], place[1])
            yield "ORGN", {
                "Type": AHRS_HOME, "Lat": scaled(lat, 1e7, I32_LIMITS), "Lng": scaled(lon, 1e7, I32_LIMITS),
                "Alt": scaled(self._origin.alt_msl_m + place[2], 100.0, I32_LIMITS),
            }  # fmt: skip

    def _estimate(self, _vehicle: int, data: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
        on = bool(data.get("on"))
        yield "ERR", {"Subsys": _EKFCHECK, "ECode": _BAD_VARIANCE if on else _RESOLVED}
        yield "ERR", {"Subsys": _EKFINAV, "ECode": _OCCURRED if on else _RESOLVED}

    def _fence(self, _vehicle: int, data: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
        names = str(data.get("fence"))
        yield "ERR", {"Subsys": _FENCE, "ECode": sum(bit for name, bit in _FENCES.items() if name in names)}

    def _glitch(self, _vehicle: int, data: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
        yield "ERR", {"Subsys": _GPS, "ECode": _GLITCH if data.get("on") else _RESOLVED}

    def _reboot(self, vehicle: int, data: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
        self.systems[vehicle].add(int(_number(data, "system_id", 1.0)))
        yield "MSG", {"Message": REBOOT}


_Noted = Callable[[EventRows, int, Mapping[str, Any]], Iterator[tuple[str, dict[str, Any]]]]


def _number(data: Mapping[str, Any], name: str, otherwise: float) -> float:
    """A finite number among details; `otherwise` for anything else, which a damaged record may have."""
    try:
        found = float(data.get(name, otherwise))
    except (TypeError, ValueError):
        return otherwise
    return found if np.isfinite(found) else otherwise


def _always(name: str, **fields: int) -> _Noted:
    """The same message for every event of a kind."""
    return lambda _rows, _vehicle, _data: iter([(name, dict(fields))])


_EVENTS: Final[Mapping[str, _Noted]] = {
    "event.armed": EventRows._arming,
    "event.disarmed": EventRows._disarming,
    "event.mode": EventRows._mode,
    "event.parameter": EventRows._parameter,
    "event.home": EventRows._home,
    "event.takeoff": _always("EV", Id=_NOT_LANDED),
    "event.landed": _always("EV", Id=_LAND_COMPLETE),
    "event.battery": _always("ERR", Subsys=_BATT, ECode=_OCCURRED),
    "event.ekf_failsafe": EventRows._estimate,
    "event.fence_breach": EventRows._fence,
    "event.fence_cleared": _always("ERR", Subsys=_FENCE, ECode=_RESOLVED),
    "event.glitch": EventRows._glitch,
    "event.reboot": EventRows._reboot,
}
"""By the kind of an event, the messages that ArduCopter logs when it happens."""


def default_of(name: str) -> float:
    """The default value of a parameter of the builtin autopilot; not a number for any other name."""
    return PARAMETERS[INDEX[name]].default if name in INDEX else np.nan


def label_rows(table: pa.Table, vehicles: list[str]) -> Iterator[Rows]:
    """LABL for each act on a link, a sensor or the body of an aircraft; `table` has rows of `labels`."""
    numbers = {name: number for number, name in enumerate(vehicles)}
    for note in read_label_rows(table.to_pylist()):
        if note.about in numbers:
            author, _, action = note.kind.partition(".")
            name = next(iter(note.data.values()))
            yield make_rows(
                "LABL", np.array([numbers[note.about]]), np.array([note.time_ns]), Attack=name.encode(errors="replace"),
                Action=action.encode(errors="replace"), Kind=_KINDS.index(author),
            )  # fmt: skip
