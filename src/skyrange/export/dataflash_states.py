"""Messages of DataFlash logs from readings of sensors and from truth: GPS, IMU, MAG, BAT and SIM.

Readings are those that the autopilot received, after attacks, faults and defences. SIM alone has the truth: it is where
ArduPilot's own simulation logs it (libraries/SITL/SITL.cpp, `Log_Write_SIMSTATE`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from typing import Final

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_MS, NS_PER_S
from skyrange.export.dataflash_rows import (
    I16_LIMITS,
    I32_LIMITS,
    U8_LIMITS,
    Floats,
    HeldValues,
    Ints,
    Rows,
    attitudes_of_truth,
    column,
    make_rows,
    scaled,
    vehicle_numbers,
)

GPS_EPOCH_S: Final = 315_964_800
"""1980-01-06T00:00:00Z in seconds since 1970 (IS-GPS-200, 3.3.4)."""
WEEK_MS: Final = 7 * 86_400_000
_LEAPS: Final = np.array(
    [f"{day}T00:00:00" for day in (
        "1981-07-01", "1982-07-01", "1983-07-01", "1985-07-01", "1988-01-01", "1990-01-01", "1991-01-01", "1992-07-01",
        "1993-07-01", "1994-07-01", "1996-01-01", "1997-07-01", "1999-01-01", "2006-01-01", "2009-01-01", "2012-07-01",
        "2015-07-01", "2017-01-01",
    )],
    dtype="datetime64[s]",
).astype(np.int64)  # fmt: skip
"""From when on GPS time was a second further ahead of UTC, in seconds since 1970 (IERS Bulletin C; leap-seconds.list).
None is announced after 2017."""
_UNKNOWN: Final = 255
"""RemPct of a battery that reports none (AP_BattMonitor_Logging.cpp)."""
_UNKNOWN_DOP: Final = -1
"""GPS_UNKNOWN_DOP, 65535, as HDop's type reads it (AP_GPS.h)."""
MAX_AGE_NS: Final = 2 * NS_PER_S
"""What an autopilot reported longer ago is not taken for what it knows: reports come at least once a second."""


def gps_time(utc_ns: Ints) -> tuple[Ints, Ints]:
    """GPS weeks and milliseconds of the week of moments in ns since 1970 UTC, leap seconds counted; 0 before 1980.

    Readers that take today's 18 leap seconds for those of any time, as pymavlink does, read moments before 2017 as
    earlier than they were.
    """
    leap_s = np.searchsorted(_LEAPS, utc_ns // NS_PER_S, side="right")
    total_ms = np.maximum((utc_ns - (GPS_EPOCH_S - leap_s) * NS_PER_S) // NS_PER_MS, 0)
    return total_ms // WEEK_MS, total_ms % WEEK_MS


def truth_rows(table: pa.Table, vehicles: pa.Array, origin: Origin) -> Rows:
    """SIM: true attitude and position."""
    place = np.stack([column(table, name) for name in ("east_m", "north_m", "up_m")], axis=1)
    turned = np.stack([column(table, name) for name in ("qw", "qx", "qy", "qz")], axis=1)
    vehicle = vehicle_numbers(table.column("vehicle"), vehicles)
    kept = (vehicle >= 0) & np.isfinite(place).all(axis=1) & np.isfinite(turned).all(axis=1)
    place, turned = place[kept], turned[kept]
    lat, lon = origin.to_geodetic(place[:, 0], place[:, 1])
    return make_rows(
        "SIM", vehicle[kept], column(table, "time_ns")[kept], **attitudes_of_truth(*turned.T).fields(),
        Alt=origin.alt_msl_m + place[:, 2], Lat=scaled(lat, 1e7, I32_LIMITS), Lng=scaled(lon, 1e7, I32_LIMITS),
    )  # fmt: skip


class ReadingRows:
    """Rows of readings in order of time, and what is known from the autopilot's reports meanwhile."""

    def __init__(self, vehicles: pa.Array, origin: Origin, start_ns: int) -> None:
        self._vehicles, self._origin, self._start_ns = vehicles, origin, start_ns
        self.hdop = HeldValues(1, MAX_AGE_NS)
        self.remaining = HeldValues(1, MAX_AGE_NS)
        """Percent."""
        self.consumed = HeldValues(2, MAX_AGE_NS)
        """mAh and Wh."""
        self.unknown: Counter[str] = Counter()
        """Messages by field that is unknown in them, such as GPS.HDop."""
        self._last_fix: dict[int, tuple[float, float]] = {}

    def rows(
        self, sensed: pa.Table | None, received: pa.Table | None, has_monitor: NDArray[np.bool_]
    ) -> Iterator[Rows]:
        """The messages of the rows of `sensors` and `received_sensors` of a span of time: of those, where there are
        both, as received. `has_monitor` tells of each aircraft whether it measures its battery.
        """
        tables = [table for table in (received, sensed) if table is not None]
        if not tables:
            return
        table = pa.concat_tables(tables)
        vehicle, time_ns = vehicle_numbers(table.column("vehicle"), self._vehicles), column(table, "time_ns")
        keys = np.stack([vehicle, time_ns], axis=1)
        _, first = np.unique(keys, axis=0, return_index=True)
        first = first[vehicle[first] >= 0]  # in order of aircraft, then of time
        vehicle, time_ns = vehicle[first], time_ns[first]

        def read(*names: str) -> Floats:
            return np.stack([column(table, name)[first] for name in names], axis=1).astype(np.float64)

        yield from _inertial(vehicle, time_ns, read)
        yield _compass(vehicle, time_ns, read)
        yield self._receiver(vehicle, time_ns, read)
        yield self._battery(vehicle, time_ns, read("battery_v", "battery_a"), has_monitor)
        for held in (self.hdop, self.remaining, self.consumed):
            held.forget()

    def _receiver(self, vehicle: Ints, time_ns: Ints, read: Callable[..., Floats]) -> Rows:
        """GPS, once for each new measurement or status, as ArduPilot logs it."""
        measured_s, fix = read("gnss_time_s", "gnss_fix").T
        kept = np.flatnonzero(self._is_new(vehicle, measured_s, fix) & (fix >= 1.0))
        east, north, up = read("gnss_east_m", "gnss_north_m", "gnss_up_m")[kept].T
        vel_east, vel_north, vel_up = read("gnss_vel_east_mps", "gnss_vel_north_mps", "gnss_vel_up_mps")[kept].T
        ahead_s, satellites = read("gnss_utc_error_s", "gnss_satellites")[kept].T
        timed = np.isfinite(measured_s[kept] + ahead_s)
        seconds = np.where(timed, measured_s[kept] + ahead_s, 0.0)
        week, ms = gps_time(self._start_ns + np.rint(seconds * 1e3).astype(np.int64) * NS_PER_MS)
        placed = np.isfinite(east + north + up)
        lat, lon = self._origin.to_geodetic(np.where(placed, east, 0.0), np.where(placed, north, 0.0))
        hdop = self.hdop.find(vehicle[kept], time_ns[kept])[:, 0]
        self.unknown["GPS.HDop"] += int(np.isnan(hdop).sum())
        return make_rows(
            "GPS", vehicle[kept], time_ns[kept],
            Status=scaled(fix[kept], 1.0, U8_LIMITS), GMS=np.where(timed, ms, 0), GWk=np.where(timed, week, 0),
            NSats=scaled(satellites, 1.0, U8_LIMITS),
            HDop=np.where(np.isfinite(hdop), scaled(hdop, 1.0, I16_LIMITS), _UNKNOWN_DOP),
            Lat=np.where(placed, scaled(lat, 1e7, I32_LIMITS), 0.0),
            Lng=np.where(placed, scaled(lon, 1e7, I32_LIMITS), 0.0),
            Alt=np.where(placed, scaled(self._origin.alt_msl_m + up, 100.0, I32_LIMITS), 0.0),
            Spd=np.hypot(vel_east, vel_north), GCrs=np.degrees(np.arctan2(vel_east, vel_north)) % 360.0,
            VZ=-vel_up, U=1,
        )  # fmt: skip

    def _is_new(self, vehicle: Ints, measured_s: Floats, fix: Floats) -> NDArray[np.bool_]:
        """Whether each row, in order of aircraft and time, has another measurement or status than the one before."""
        now = np.stack([np.nan_to_num(measured_s, nan=-np.inf), np.nan_to_num(fix)], axis=1)
        new = np.ones(len(vehicle), dtype=np.bool_)
        new[1:] = (np.diff(vehicle) != 0) | (now[1:] != now[:-1]).any(axis=1)
        firsts = np.flatnonzero(np.diff(vehicle, prepend=-1))
        lasts = [*(firsts[1:] - 1).tolist(), len(vehicle) - 1]
        for first, last in zip(firsts.tolist(), lasts, strict=False):
            number = int(vehicle[first])
            new[first] = self._last_fix.get(number) != tuple(now[first].tolist())
            self._last_fix[number] = tuple(now[last].tolist())
        return new

    def _battery(self, vehicle: Ints, time_ns: Ints, power: Floats, has_monitor: NDArray[np.bool_]) -> Rows:
        """BAT; what the autopilot has not reported within two seconds is unknown."""
        kept = np.flatnonzero(has_monitor[vehicle] & np.isfinite(power[:, 0]))
        vehicle, time_ns = vehicle[kept], time_ns[kept]
        remaining = self.remaining.find(vehicle, time_ns)[:, 0]
        consumed = self.consumed.find(vehicle, time_ns)
        self.unknown["BAT.RemPct"] += int((~(remaining >= 0.0)).sum())
        self.unknown["BAT.CurrTot and EnrgTot"] += int(np.isnan(consumed).any(axis=1).sum())
        return make_rows(
            "BAT", vehicle, time_ns, Volt=power[kept, 0], VoltR=np.nan, Curr=power[kept, 1], CurrTot=consumed[:, 0],
            EnrgTot=consumed[:, 1], Res=np.nan, RemPct=np.where(remaining >= 0.0, np.nan_to_num(remaining), _UNKNOWN),
            H=1,
        )  # fmt: skip


def _inertial(vehicle: Ints, time_ns: Ints, read: Callable[..., Floats]) -> Iterator[Rows]:
    """IMU, forward-right-down. Simulated sensors count no errors and measure no temperature; their rates are not
    measured, which is 0 in ArduPilot too (AP_InertialSensor.h, `_gyro_raw_sample_rates`).
    """
    fields = {}
    for name, kind, unit in (("Gyr", "gyro", "radps"), ("Acc", "accel", "mps2")):
        for axis, sign in (("x", 1.0), ("y", -1.0), ("z", -1.0)):
            fields[f"{name}{axis.upper()}"] = sign * read(f"{kind}_{axis}_{unit}")[:, 0]
    kept = np.isfinite(np.stack(list(fields.values()))).all(axis=0)
    shown: Mapping[str, Floats] = {name: values[kept] for name, values in fields.items()}
    yield make_rows("IMU", vehicle[kept], time_ns[kept], **shown, T=np.nan, GH=1, AH=1)


def _compass(vehicle: Ints, time_ns: Ints, read: Callable[..., Floats]) -> Rows:
    """MAG, forward-right-down. Nothing is subtracted from a simulated field, so all offsets are 0."""
    field = read("compass_x_gauss", "compass_y_gauss", "compass_z_gauss") * (1.0, -1.0, -1.0)
    kept = np.isfinite(field).all(axis=1)
    milligauss = scaled(field[kept], 1e3, I16_LIMITS)
    return make_rows(
        "MAG", vehicle[kept], time_ns[kept],
        MagX=milligauss[:, 0], MagY=milligauss[:, 1], MagZ=milligauss[:, 2],
        Health=1, S=time_ns[kept] // 1_000 & 0xFFFF_FFFF,
    )  # fmt: skip
