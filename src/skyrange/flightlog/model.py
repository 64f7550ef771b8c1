"""A log of one vehicle, in one form whatever its file's format: tables by name, missions, parameters and remarks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mission import Mission

Rows = NDArray[Any]
"""Rows of one of `TABLES`."""
_REAL: Final = "f8"

MAX_TIME_S: Final = 30.0 * 86_400.0
"""Later than this after a log's first message is no time of its rows, but damage."""
MAX_ALT_M: Final = 20_000.0
"""No multirotor is higher, or lower below the sea."""

TABLES: Final[Mapping[str, np.dtype[Any]]] = {
    "position": np.dtype(
        [(name, _REAL) for name in (
            "time_s", "lat_deg", "lon_deg", "alt_msl_m", "north_mps", "east_mps", "down_mps",
        )]
    ),
    "attitude": np.dtype([(name, _REAL) for name in ("time_s", "roll_rad", "pitch_rad", "yaw_rad")]),
    "gnss": np.dtype(
        [("time_s", _REAL), ("fix", "i8"), ("satellites", "i8"), *((name, _REAL) for name in (
            "hdop", "lat_deg", "lon_deg", "alt_msl_m",
        ))]
    ),
    "battery": np.dtype([(name, _REAL) for name in ("time_s", "voltage_v", "current_a", "remaining")]),
    "vibration": np.dtype([(name, _REAL) for name in ("time_s", "x_mps2", "y_mps2", "z_mps2")]),
    "estimator": np.dtype([(name, _REAL) for name in ("time_s", "velocity", "horizontal", "vertical", "compass")]),
    "radio": np.dtype(
        [("time_s", _REAL), *((name, "i8") for name in ("rssi", "remote_rssi", "noise", "remote_noise", "errors"))]
    ),
    "link": np.dtype([("time_s", _REAL), ("received", "i8"), ("lost", "i8")]),
    "states": np.dtype([("time_s", _REAL), ("armed", "?"), ("mode", "U16")]),
    "items": np.dtype([("time_s", _REAL), ("number", "i8")]),
    "homes": np.dtype([(name, _REAL) for name in ("time_s", "lat_deg", "lon_deg", "alt_msl_m")]),
}  # fmt: skip
"""Columns by table. Times are seconds since the log's first message; a number that a log does not have is NaN, or -1 in
a column of integers. `estimator` has the test ratios of innovations, 1 at the gate. `radio` has the units of
RADIO_STATUS. `items` has the number of the mission item that is flown, as in MISSION_CURRENT. `link` has a vehicle's
frames of one second each, and those that gaps of sequence numbers tell of; logs that an autopilot wrote have no rows of
it.
"""


@dataclass(frozen=True, slots=True)
class Remark:
    """Something about a log that a user has to know."""

    subject: str
    """What it is about: a message, a parameter, the clock."""
    text: str
    """What was found, and what was done about it."""


@dataclass(frozen=True, slots=True)
class SentMission:
    """A mission that was uploaded or downloaded as a whole."""

    time_s: float
    mission: Mission


@dataclass(frozen=True, slots=True)
class FlightLog:
    """What a log says of one vehicle."""

    path: Path
    format: str
    """tlog, dataflash, ulog, or run."""
    start_unix_s: float | None
    """The time of the first message, in seconds since 1970 UTC; None if the log does not say."""
    duration_s: float
    firmware: str
    """Name and version, as far as the log says them; else empty."""
    vehicle_type: str
    """The name of a MAV_TYPE without its prefix, such as QUADROTOR; empty if the log does not say."""
    tables: Mapping[str, Rows]
    """Rows by table, in order of time; each of `TABLES` is there."""
    params: Mapping[str, float]
    """The last value of each parameter."""
    missions: Sequence[SentMission]
    remarks: Sequence[Remark]


def check_start(unix_s: float | None) -> float | None:
    """A time since 1970 in seconds; None if it is not in the years 2000 to 2100: that of a clock that was never set."""
    return unix_s if unix_s is not None and 946_684_800.0 <= unix_s < 4_102_444_800.0 else None


class TableBuilder:
    """Rows of tables as a reader meets them."""

    def __init__(self) -> None:
        self._rows: dict[str, list[tuple[Any, ...]]] = {name: [] for name in TABLES}

    def add(self, table: str, *values: Any) -> None:
        """Add a row, with the columns of `TABLES` in order."""
        self._rows[table].append(values)

    def build(self) -> tuple[dict[str, Rows], list[Remark]]:
        """The tables, each in order of time, and a remark if rows are left out because their time or place cannot be.

        Latitude and longitude 0 stand for no position.
        """
        tables, left_out = {}, 0
        for name, rows in self._rows.items():
            table = np.array(rows, dtype=TABLES[name])
            good = np.abs(table["time_s"]) <= MAX_TIME_S
            if "lat_deg" in (TABLES[name].names or ()):
                unknown = (table["lat_deg"] == 0.0) & (table["lon_deg"] == 0.0)
                for column in ("lat_deg", "lon_deg", "alt_msl_m"):
                    table[column][unknown] = np.nan
                good &= unknown | (
                    (np.abs(table["lat_deg"]) <= 90.0)
                    & (np.abs(table["lon_deg"]) <= 180.0)
                    & (np.abs(table["alt_msl_m"]) <= MAX_ALT_M)
                )
                if name != "gnss":  # a fix without a position has its number of satellites
                    table, good = table[~unknown], good[~unknown]
            left_out += len(table) - int(good.sum())
            table = table[good]
            tables[name] = table[np.argsort(table["time_s"], kind="stable")]
        text = f"{left_out:,} rows have a time or a place that cannot be, and are left out"
        return tables, [Remark("rows", text)] if left_out else []
