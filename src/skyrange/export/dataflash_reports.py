"""Messages of DataFlash logs from what autopilots sent: attitude, position, state of the estimator, outputs, texts.

Each is logged at the time at which the autopilot sent it, lost or not, and whatever taps made of it afterwards.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from skyrange.codec.mavlink import dialect
from skyrange.codec.mavlink.message_columns import MessageTable
from skyrange.core.ids import endpoint
from skyrange.core.time import NEVER
from skyrange.export.dataflash_rows import (
    I8_LIMITS,
    I32_LIMITS,
    Floats,
    HeldValues,
    Ints,
    Rows,
    attitudes_of_angles,
    make_rows,
    scaled,
)
from skyrange.export.dataflash_states import ReadingRows
from skyrange.record.read.station_frames import StationFrames
from skyrange.record.read.tables import Tables
from skyrange.record.read.time_order import sort_by_time

EKF3: Final = 3
"""EKFType::THREE (AP_AHRS.h): the estimator of the builtin autopilot follows EKF3."""
EKF_ORIGIN, AHRS_HOME = 0, 1
"""LogOriginType (AP_AHRS.h)."""
_QUALITY_UNKNOWN: Final = -1
"""SIGNAL_QUALITY_UNKNOWN (AP_RangeFinder.h); 0 in DISTANCE_SENSOR."""
_LOW, _HIGH, _GOOD = 2, 3, 4
"""RangeFinder::Status (AP_RangeFinder.h)."""
_UNKNOWN_U16: Final = 65_535
_SENT: Final = ("direction", "sender", "dst", "serial", "sent_ns", "arrived_ns")
_CHANNELS: Final = 14


def frames_of_autopilots(tables: Tables, vehicles: list[str]) -> Iterator[pa.Table]:
    """The frames that the autopilots of some aircraft sent, at their sending, and received, in order of time, with the
    columns `time_ns`, `vehicle`, `received` (by the log: true for those that the autopilot sent), `payload`, `serial`.
    """
    ends = pa.array([endpoint(vehicle, "autopilot") for vehicle in vehicles], pa.string())
    names = pa.array(vehicles, pa.string())

    def read() -> Iterator[pa.Table]:
        for batch in tables.frames_with_payloads(_SENT):
            yield from (_sent(batch, ends, names), _arrived(batch, ends, names))

    return sort_by_time(read, "time_ns", ("vehicle", "received", "serial"))


def _sent(batch: pa.Table, ends: pa.Array, names: pa.Array) -> pa.Table:
    number = pc.index_in(batch.column("sender"), value_set=ends)
    mask = pc.and_(pc.is_valid(number), pc.equal(batch.column("direction"), "rev"))
    return _chosen(batch.append_column("time_ns", batch.column("sent_ns")), mask, names.take(number), sent=True)


def _arrived(batch: pa.Table, ends: pa.Array, names: pa.Array) -> pa.Table:
    number = pc.index_in(batch.column("dst"), value_set=ends)
    mask = pc.and_(pc.is_valid(number), pc.is_valid(batch.column("arrived_ns")))
    times = pc.fill_null(batch.column("arrived_ns"), 0)
    return _chosen(batch.append_column("time_ns", times), mask, names.take(number), sent=False)


def _chosen(batch: pa.Table, mask: pa.ChunkedArray, vehicles: pa.ChunkedArray, *, sent: bool) -> pa.Table:
    rows = batch.append_column("vehicle", vehicles).filter(mask)
    rows = rows.append_column("received", pa.array(np.full(rows.num_rows, sent)))
    return rows.select(["time_ns", "vehicle", "received", "payload", "serial"])


class ReportRows:
    """Rows of what autopilots sent, in order of time."""

    def __init__(self, vehicles: list[str], readings: ReadingRows) -> None:
        self._numbers = {name: number for number, name in enumerate(vehicles)}
        self._readings = readings
        self._origins = HeldValues(1, NEVER)
        """Altitude of the origin of each estimator, metres above mean sea level."""
        self._places: dict[tuple[int, int], tuple[int, ...]] = {}
        self._mode_seen: set[int] = set()

    def rows(self, block: StationFrames) -> Iterator[Rows]:
        """The messages of a span of time."""
        groups = {group.message_id: group for group in block.groups(block.received)}
        for number, take in _TAKERS.items():
            if number in groups:
                group = groups[number]
                yield from take(self, self.owners(block)[group.rows], block.time_ns[group.rows], group.values)
        self._origins.forget()

    def owners(self, block: StationFrames) -> Ints:
        """The number of each row's aircraft."""
        return np.array([self._numbers[name] for name in block.owners], dtype=np.int64)[block.owner]

    def _take_attitude(self, vehicle: Ints, time_ns: Ints, values: MessageTable) -> Iterator[Rows]:
        degrees = {name: np.degrees(values[name].astype(np.float64)) for name in ("roll", "pitch", "yaw")}
        yield make_rows(
            "ATT", vehicle, time_ns, Roll=degrees["roll"], Pitch=degrees["pitch"], Yaw=degrees["yaw"] % 360.0,
            DesRoll=np.nan, DesPitch=np.nan, DesYaw=np.nan, AEKF=EKF3,
        )  # fmt: skip

    def _take_position(self, vehicle: Ints, time_ns: Ints, values: MessageTable) -> Iterator[Rows]:
        velocity = {label: values[name] * 0.01 for label, name in (("VN", "vx"), ("VE", "vy"), ("VD", "vz"))}
        yield make_rows("VNED", vehicle, time_ns, **velocity)
        alt_m = values["alt"] * 1e-3
        yield make_rows(
            "POS", vehicle, time_ns, Lat=values["lat"], Lng=values["lon"], Alt=alt_m,
            RelHomeAlt=values["relative_alt"] * 1e-3,
            RelOriginAlt=alt_m - self._origins.find(vehicle, time_ns)[:, 0],
        )  # fmt: skip

    def _take_ahrs2(self, vehicle: Ints, time_ns: Ints, values: MessageTable) -> Iterator[Rows]:
        roll, pitch, yaw = (values[name].astype(np.float64) for name in ("roll", "pitch", "yaw"))
        yield make_rows(
            "AHR2", vehicle, time_ns, **attitudes_of_angles(roll, pitch, yaw).fields(),
            Alt=values["altitude"], Lat=values["lat"], Lng=values["lng"],
        )  # fmt: skip

    def _take_estimator(self, vehicle: Ints, time_ns: Ints, values: MessageTable) -> Iterator[Rows]:
        names = {"SV": "velocity_variance", "SP": "pos_horiz_variance", "SH": "pos_vert_variance",
                 "SM": "compass_variance", "ST": "terrain_alt_variance", "Flags": "flags"}  # fmt: skip
        yield make_rows("EKSR", vehicle, time_ns, **{label: values[name] for label, name in names.items()})

    def _take_distance(self, vehicle: Ints, time_ns: Ints, values: MessageTable) -> Iterator[Rows]:
        now, low, high = (values[f"{name}_distance"].astype(np.int64) for name in ("current", "min", "max"))
        quality = values["signal_quality"].astype(np.int64)
        yield make_rows(
            "RFND", vehicle, time_ns, Instance=values["id"], Dist=now * 0.01, Orient=values["orientation"],
            Stat=np.where(now > high, _HIGH, np.where(now < low, _LOW, _GOOD)),
            Quality=np.where(quality == 0, _QUALITY_UNKNOWN, scaled(quality, 1.0, I8_LIMITS)),
        )  # fmt: skip

    def _take_outputs(self, vehicle: Ints, time_ns: Ints, values: MessageTable) -> Iterator[Rows]:
        yield make_rows("RCOU", vehicle, time_ns, **_channels(values, "servo{}_raw"))

    def _take_inputs(self, vehicle: Ints, time_ns: Ints, values: MessageTable) -> Iterator[Rows]:
        read = _channels(values, "chan{}_raw")
        used = {name: np.where(pulse == _UNKNOWN_U16, 0, pulse) for name, pulse in read.items()}
        yield make_rows("RCIN", vehicle, time_ns, **used)

    def _take_text(self, vehicle: Ints, time_ns: Ints, values: MessageTable) -> Iterator[Rows]:
        yield make_rows("MSG", vehicle, time_ns, Message=values["text"])

    def _take_heartbeat(self, vehicle: Ints, time_ns: Ints, values: MessageTable) -> Iterator[Rows]:
        """MODE of the first heartbeat: later ones are events."""
        for place, number in enumerate(vehicle.tolist()):
            if number not in self._mode_seen:
                self._mode_seen.add(number)
                mode = values["custom_mode"][place : place + 1]
                yield make_rows("MODE", vehicle[place : place + 1], time_ns[place : place + 1], Mode=mode, ModeNum=mode)

    def _take_origin(self, vehicle: Ints, time_ns: Ints, values: MessageTable) -> Iterator[Rows]:
        return self._take_place(EKF_ORIGIN, vehicle, time_ns, values)

    def _take_home(self, vehicle: Ints, time_ns: Ints, values: MessageTable) -> Iterator[Rows]:
        return self._take_place(AHRS_HOME, vehicle, time_ns, values)

    def _take_place(self, kind: int, vehicle: Ints, time_ns: Ints, values: MessageTable) -> Iterator[Rows]:
        """ORGN, when a place is another one than before."""
        for place, number in enumerate(vehicle.tolist()):
            row = values[place]
            found = tuple(int(row[name]) for name in ("latitude", "longitude", "altitude"))
            if self._places.get((kind, number)) != found:
                self._places[kind, number] = found
                at = slice(place, place + 1)
                if kind == EKF_ORIGIN:
                    self._origins.add(vehicle[at], time_ns[at], np.array([[found[2] * 1e-3]]))
                alt = scaled(found[2], 0.1, I32_LIMITS)
                yield make_rows("ORGN", vehicle[at], time_ns[at], Type=kind, Lat=found[0], Lng=found[1], Alt=alt)

    def _hold_receiver(self, vehicle: Ints, time_ns: Ints, values: MessageTable) -> Iterator[Rows]:
        known = values["eph"] != _UNKNOWN_U16
        self._readings.hdop.add(vehicle[known], time_ns[known], values["eph"][known, None].astype(np.float64))
        return iter(())

    def _hold_status(self, vehicle: Ints, time_ns: Ints, values: MessageTable) -> Iterator[Rows]:
        self._readings.remaining.add(vehicle, time_ns, values["battery_remaining"][:, None].astype(np.float64))
        return iter(())

    def _hold_battery(self, vehicle: Ints, time_ns: Ints, values: MessageTable) -> Iterator[Rows]:
        used: Floats = np.stack([values["current_consumed"], values["energy_consumed"]], axis=1).astype(np.float64)
        used[used < 0.0] = np.nan
        joules_to_wh = 100.0 / 3600.0  # energy_consumed is in hJ
        self._readings.consumed.add(vehicle, time_ns, used * (1.0, joules_to_wh))
        return self._hold_status(vehicle, time_ns, values)


def _channels(values: MessageTable, name: str) -> Mapping[str, Any]:
    return {f"C{channel}": values[name.format(channel)] for channel in range(1, _CHANNELS + 1)}


_Taker = Callable[[ReportRows, Ints, Ints, MessageTable], Iterator[Rows]]
_TAKERS: Final[Mapping[int, _Taker]] = {
    dialect.MAVLINK_MSG_ID_GPS_RAW_INT: ReportRows._hold_receiver,
    dialect.MAVLINK_MSG_ID_SYS_STATUS: ReportRows._hold_status,
    dialect.MAVLINK_MSG_ID_BATTERY_STATUS: ReportRows._hold_battery,
    dialect.MAVLINK_MSG_ID_HEARTBEAT: ReportRows._take_heartbeat,
    dialect.MAVLINK_MSG_ID_STATUSTEXT: ReportRows._take_text,
    dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: ReportRows._take_origin,
    dialect.MAVLINK_MSG_ID_HOME_POSITION: ReportRows._take_home,
    dialect.MAVLINK_MSG_ID_ATTITUDE: ReportRows._take_attitude,
    dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: ReportRows._take_position,
    dialect.MAVLINK_MSG_ID_AHRS2: ReportRows._take_ahrs2,
    dialect.MAVLINK_MSG_ID_EKF_STATUS_REPORT: ReportRows._take_estimator,
    dialect.MAVLINK_MSG_ID_DISTANCE_SENSOR: ReportRows._take_distance,
    dialect.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: ReportRows._take_outputs,
    dialect.MAVLINK_MSG_ID_RC_CHANNELS: ReportRows._take_inputs,
}
"""By message id, in the order in which messages of one time are logged."""
