"""Schema of a run's record: the columns of each table with type, unit and meaning, and the tables of each level.

The writer, the reader and the documentation use the same definitions. Every Parquet file contains the unit and
meaning of each column as Arrow field metadata.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from skyrange.core.errors import InputError

FORMAT = "skyrange.run/1"
"""The format of a run's folder; the number is raised when older readers can no longer read it."""

PAYLOAD_WINDOW = 1 << 16
"""Payloads are de-duplicated within windows: `payload_id // PAYLOAD_WINDOW` is a payload's window, windows are
consecutive, and a frame's payload lies in the newest window that had begun when the frame was recorded."""

NAME = pa.string()
"""The type of names: dictionary-encoded in the files, plain strings in memory."""

TEXT = pa.large_string()
"""Placeholder type that distinguishes free text from names; `arrow_schema` makes both plain strings."""

_TEXTS = pa.list_(pa.string())


@dataclass(frozen=True, slots=True)
class Column:
    """One column: `unit` is "" for names and counts; a `nullable` column may have rows without a value."""

    name: str
    type: pa.DataType
    unit: str
    meaning: str
    nullable: bool = False


def _nullable(name: str, kind: pa.DataType, unit: str, meaning: str) -> Column:
    """A column that may have rows without a value."""
    return Column(name, kind, unit, meaning, nullable=True)


_F64 = pa.float64()
_F32 = pa.float32()
_I64 = pa.int64()
_I32 = pa.int32()
_TIME = "ns since the scenario's start"

_NOTES = (
    Column("time_ns", _I64, "ns", f"time of the note, {_TIME}"),
    Column("kind", NAME, "", "kind of the decision or event, a dotted name"),
    Column("about", NAME, "", "the vehicle, operator or endpoint that it concerns"),
    Column("source", NAME, "", "the agent, engine or other part that noted it"),
    Column("data", TEXT, "", "details: a JSON object of scalars; not-a-number and infinities as strings"),
    Column("causes", _TEXTS, "", "ids of the frames that caused it, link|direction|sender|serial"),
)

_READINGS = (
    Column("gyro_x_radps", _F32, "rad/s", "body rate about forward"),
    Column("gyro_y_radps", _F32, "rad/s", "body rate about left"),
    Column("gyro_z_radps", _F32, "rad/s", "body rate about up"),
    Column("accel_x_mps2", _F32, "m/s²", "specific force forward"),
    Column("accel_y_mps2", _F32, "m/s²", "specific force left"),
    Column("accel_z_mps2", _F32, "m/s²", "specific force up; +9.8 at rest and level"),
    Column("attitude_w", _F32, "", "attitude quaternion, body (FLU) to local (ENU), scalar part"),
    Column("attitude_x", _F32, "", "attitude quaternion, x"),
    Column("attitude_y", _F32, "", "attitude quaternion, y"),
    Column("attitude_z", _F32, "", "attitude quaternion, z"),
    Column("gnss_east_m", _F32, "m", "GNSS position east of the origin"),
    Column("gnss_north_m", _F32, "m", "GNSS position north of the origin"),
    Column("gnss_up_m", _F32, "m", "GNSS position above the origin"),
    Column("gnss_vel_east_mps", _F32, "m/s", "GNSS velocity east"),
    Column("gnss_vel_north_mps", _F32, "m/s", "GNSS velocity north"),
    Column("gnss_vel_up_mps", _F32, "m/s", "GNSS velocity up"),
    Column("baro_up_m", _F32, "m", "barometric height above the origin"),
    Column("rangefinder_m", _F32, "m", "height above the ground below"),
    Column("compass_x_gauss", _F32, "gauss", "magnetic field forward"),
    Column("compass_y_gauss", _F32, "gauss", "magnetic field left"),
    Column("compass_z_gauss", _F32, "gauss", "magnetic field up"),
    Column("gnss_acc_horizontal_m", _F32, "m", "horizontal accuracy that the receiver claims"),
    Column("gnss_acc_vertical_m", _F32, "m", "vertical accuracy that the receiver claims"),
    Column("gnss_acc_speed_mps", _F32, "m/s", "speed accuracy that the receiver claims"),
    Column("gnss_fix", _F32, "", "MAVLink GPS_FIX_TYPE: 1 no fix, 3 3D, 6 RTK fixed"),
    Column("gnss_satellites", _F32, "", "satellites used"),
    Column("gnss_time_s", _F32, "s", "simulated time at which the position was measured"),
    Column("gnss_utc_error_s", _F32, "s", "how far the receiver's UTC is ahead of the true one"),
    Column("battery_v", _F32, "V", "voltage at the battery's terminals"),
    Column("battery_a", _F32, "A", "current drawn"),
)
"""The readings of an aircraft's sensors at one tick."""


def _sensors(stage: str) -> tuple[Column, ...]:
    """The columns of a table of readings; `stage` says where they were taken."""
    return (
        Column("time_ns", _I64, "ns", f"the tick, {_TIME}"),
        Column("vehicle", NAME, "", "operator/vehicle"),
        *(replace(column, meaning=f"{column.meaning}; {stage}") for column in _READINGS),
    )


TABLES: dict[str, tuple[Column, ...]] = {
    "truth": (
        Column("time_ns", _I64, "ns", f"the tick, {_TIME}"),
        Column("vehicle", NAME, "", "operator/vehicle"),
        Column(
            "source",
            NAME,
            "",
            "what moves the body: dynamic (the world), kinematic (its engine), external (its own reports) or simulator "
            "(a physics simulator, under the world's forces)",
        ),
        Column("east_m", _F64, "m", "position east of the origin"),
        Column("north_m", _F64, "m", "position north of the origin"),
        Column("up_m", _F64, "m", "height of its landing gear above the ground"),
        Column("vel_east_mps", _F64, "m/s", "velocity east"),
        Column("vel_north_mps", _F64, "m/s", "velocity north"),
        Column("vel_up_mps", _F64, "m/s", "velocity up"),
        Column("qw", _F64, "", "attitude quaternion, body (FLU) to local (ENU), scalar part"),
        Column("qx", _F64, "", "attitude quaternion, x"),
        Column("qy", _F64, "", "attitude quaternion, y"),
        Column("qz", _F64, "", "attitude quaternion, z"),
        Column("rate_x_radps", _F64, "rad/s", "body rate about forward"),
        Column("rate_y_radps", _F64, "rad/s", "body rate about left"),
        Column("rate_z_radps", _F64, "rad/s", "body rate about up"),
        Column("throttle", _F64, "", "mean motor command, 0 to 1; if not dynamic, as reported or 0"),
        Column("on_ground", _F64, "", "1 while it is on the ground, else 0"),
        Column("crashed", _F64, "", "1 after it has crashed, or has collided while not dynamic, else 0"),
        Column("battery_v", _F64, "V", "voltage at the battery's terminals"),
        Column("battery_a", _F64, "A", "current drawn"),
        Column("charge", _F64, "", "remaining charge of the battery, 0 to 1"),
        Column("wind_east_mps", _F64, "m/s", "the air's velocity at the aircraft, east"),
        Column("wind_north_mps", _F64, "m/s", "the air's velocity at the aircraft, north"),
        Column("wind_up_mps", _F64, "m/s", "the air's velocity at the aircraft, up"),
    ),
    "sensors": _sensors("as sensed, before attacks, faults and defences"),
    "received_sensors": _sensors("as received by the autopilot, after attacks, faults and defences"),
    "receptions": (
        Column("time_ns", _I64, "ns", f"end of the reception, {_TIME}"),
        Column("link", NAME, "", "the rid_up link of the sender's radio"),
        Column("direction", NAME, "", "its direction: fwd"),
        Column("sender", NAME, "", "the endpoint (or tap) that truly sent the frame there"),
        Column("serial", _I64, "", "that sender's serial number of the frame"),
        Column("receiver", NAME, "", "the receiving radio: a vehicle, a ground receiver or an attack's radio"),
        Column("east_m", _F32, "m", "position of the receiving radio, east of the origin"),
        Column("north_m", _F32, "m", "the same, north of the origin"),
        Column("up_m", _F32, "m", "the same, above the ground"),
        Column("transport", NAME, "", "bt4, bt5, wifi_beacon or wifi_nan"),
        Column("channel", _I64, "", "Wi-Fi channel or Bluetooth channel index"),
        Column("rssi_dbm", _F32, "dBm", "signal strength"),
        Column("snir_db", _F32, "dB", "signal to noise and interference ratio of the frame's worst part"),
        Column("outcome", NAME, "", "decoded, or why it was not: weak, collided, busy, sending, elsewhere"),
    ),
    "frames": (
        Column("link", NAME, "", "link instance"),
        Column("direction", NAME, "", "fwd from the link's first end to its second, else rev"),
        Column("sender", NAME, "", "the endpoint (or tap) that truly sent it"),
        Column("serial", _I64, "", "the sender's count of its frames on this link and direction, from 0"),
        Column("src", NAME, "", "the source that the frame claims"),
        Column("dst", NAME, "", "the destination that the frame claims"),
        Column("sent_ns", _I64, "ns", f"time of sending, {_TIME}"),
        _nullable("arrived_ns", _I64, "ns", f"time of delivery, {_TIME}; null if it was not delivered"),
        Column("fate", NAME, "", "delivered, lost, overflow, dropped, replaced or in_flight"),
        Column("payload_id", _I64, "", "its payload, a key of the payloads table"),
        Column("size", pa.int32(), "byte", "the payload's length"),
        _nullable("parent", TEXT, "", "id of the frame it forwards, alters or duplicates"),
        Column("causes", _TEXTS, "", "ids of the frames that commanded it"),
    ),
    "payloads": (
        Column("payload_id", _I64, "", "ascending; the same bytes may recur in another window of 65536 ids"),
        Column("payload", pa.binary(), "", "the bytes that crossed the link"),
    ),
    "decisions": _NOTES,
    "events": _NOTES,
    "labels": (
        Column("at_ns", _I64, "ns", f"when the act took place, {_TIME}"),
        Column("attack", NAME, "", "the id of the attack, or of the fault where `fault` is true"),
        Column("actor", NAME, "", "the tap, agent, sensor fault or body fault that acted"),
        Column("action", NAME, "", "drop, delay, replace, inject, send, sensor or body"),
        Column("frame", TEXT, "", "id of the frame acted on or put on the link, or of an act on a sensor or a body"),
        _nullable("child", TEXT, "", "id of the frame that a replacement put in its place"),
        _nullable("until_ns", _I64, "ns", f"time until which a delay holds the frame, {_TIME}"),
        Column(
            "benign",
            pa.bool_(),
            "",
            "whether the act is of a sham or of an honest aircraft, which harm nobody",
        ),
        Column("fault", pa.bool_(), "", "whether the act is that of a benign fault, which has no adversary"),
        Column(
            "harmless_intrusion",
            pa.bool_(),
            "",
            "whether it is a benign act that puts a frame of somebody unauthorised on a link or in the air",
        ),
    ),
    "alerts": (
        Column("time_ns", _I64, "ns", f"time at which the detector raised it, {_TIME}"),
        Column("detector", NAME, "", "the detector's id"),
        Column("kind", NAME, "", "kind of the finding, a dotted name"),
        Column("subject", NAME, "", "the vehicle, operator, endpoint or link that it concerns"),
        Column("score", _F64, "", "strength of the evidence; the detector defines the meaning of 1"),
        Column("at_ns", _I64, "ns", f"time of the observation, {_TIME}"),
        Column("data", TEXT, "", "details: a JSON object of scalars; not-a-number and infinities as strings"),
    ),
    "observations": (
        Column("time_ns", _I64, "ns", f"end of the reception, {_TIME}"),
        Column("receiver", NAME, "", "the receiving radio: a vehicle, a ground receiver or an attack's radio"),
        Column("receiver_east_m", _F32, "m", "position of the receiving radio, east of the origin"),
        Column("receiver_north_m", _F32, "m", "the same, north of the origin"),
        Column("receiver_up_m", _F32, "m", "the same, above the ground"),
        Column("transport", NAME, "", "bt4, bt5, wifi_beacon or wifi_nan"),
        Column("channel", _I64, "", "Wi-Fi channel or Bluetooth channel index"),
        Column("rssi_dbm", _F32, "dBm", "signal strength"),
        Column("frame", NAME, "", "id of the frame on rid_up that was transmitted; no receiver knows it"),
        Column("radio", NAME, "", "the radio that truly sent it, a vehicle or an attack's; no receiver knows it"),
        _nullable("mac", NAME, "", "address of the sender as claimed; null if the record lacks the frame"),
        _nullable("counter", _I32, "", "the sender's message counter, 0 to 255"),
        _nullable("valid", pa.bool_(), "", "whether the body is a message or a pack of F3411"),
        _nullable("messages", NAME, "", "types of the messages in the body, in order; a number if reserved"),
        _nullable("version", _I32, "", "protocol version: 2 is F3411-22a"),
        _nullable("uas_id", NAME, "", "UAS id of the first Basic ID; a UUID or session id as text"),
        _nullable("id_type", _I32, "", "1 serial number, 2 CAA registration, 3 UTM UUID, 4 session id"),
        _nullable("ua_type", _I32, "", "kind of aircraft: 1 aeroplane, 2 helicopter or multirotor … 15 other"),
        _nullable("second_uas_id", NAME, "", "UAS id of the second Basic ID"),
        _nullable("second_id_type", _I32, "", "type of the second UAS id"),
        _nullable("status", _I32, "", "0 undeclared, 1 on the ground, 2 airborne, 3 emergency, 4 failure"),
        _nullable("lat_deg", _F64, "deg", "claimed latitude, WGS 84"),
        _nullable("lon_deg", _F64, "deg", "claimed longitude, WGS 84"),
        _nullable("alt_geo_m", _F64, "m", "claimed height above the WGS 84 ellipsoid"),
        _nullable("alt_baro_m", _F64, "m", "claimed pressure altitude, against 1013.25 hPa"),
        _nullable("height_m", _F64, "m", "claimed height above what height_type says"),
        _nullable("height_type", _I32, "", "0 above the take-off, 1 above the ground"),
        _nullable("east_m", _F64, "m", "claimed position east of the origin, from lat_deg and lon_deg"),
        _nullable("north_m", _F64, "m", "the same, north of the origin"),
        _nullable("up_m", _F64, "m", "claimed height above the ground, from alt_geo_m"),
        _nullable("speed_mps", _F64, "m/s", "claimed speed over ground; 254.25 or faster"),
        _nullable("vertical_mps", _F64, "m/s", "claimed climb rate"),
        _nullable("track_deg", _F64, "deg", "claimed course over ground from true north"),
        _nullable("timestamp_s", _F64, "s", "claimed time of the position, since the full hour of UTC"),
        _nullable("timestamp_age_s", _F64, "s", "time_ns less timestamp_s, modulo 1 h: -1800 to 1800; negative: ahead"),
        _nullable("timestamp_accuracy", _I32, "0.1 s", "accuracy of timestamp_s; 0 unknown"),
        _nullable("horizontal_accuracy", _I32, "", "code of F3411: 9 below 30 m, 10 below 10 m, 11 below 3 m …"),
        _nullable("vertical_accuracy", _I32, "", "code of F3411 for alt_geo_m: 4 below 10 m, 5 below 3 m …"),
        _nullable("baro_accuracy", _I32, "", "the same for alt_baro_m"),
        _nullable("speed_accuracy", _I32, "", "code of F3411: 2 below 3 m/s, 3 below 1 m/s, 4 below 0.3 m/s"),
        _nullable("operator_lat_deg", _F64, "deg", "claimed latitude of the operator"),
        _nullable("operator_lon_deg", _F64, "deg", "claimed longitude of the operator"),
        _nullable("operator_alt_geo_m", _F64, "m", "claimed height of the operator above the ellipsoid"),
        _nullable("operator_location_type", _I32, "", "0 take-off, 1 live GNSS, 2 fixed"),
        _nullable("area_count", _I32, "", "aircraft in the area"),
        _nullable("area_radius_m", _F64, "m", "radius of the area"),
        _nullable("area_ceiling_m", _F64, "m", "ceiling of the area above the ellipsoid"),
        _nullable("area_floor_m", _F64, "m", "floor of the area above the ellipsoid"),
        _nullable("classification", _I32, "", "0 undeclared, 1 EU"),
        _nullable("category", _I32, "", "EU: 1 open, 2 specific, 3 certified"),
        _nullable("ua_class", _I32, "", "EU: 1 to 7 are C0 to C6"),
        _nullable("system_timestamp_s", _I64, "s", "claimed time of the System message, since 2019-01-01 UTC"),
        _nullable("operator_id", NAME, "", "operator id"),
        _nullable("operator_id_type", _I32, "", "0 is the operator id"),
        _nullable("self_id", NAME, "", "the Self-ID's text"),
        _nullable("description_type", _I32, "", "type of the Self-ID: 0 text, 1 emergency, 2 extended status"),
        _nullable("auth_type", _I32, "", "type of the Authentication, such as 1 signature of the UAS id"),
        _nullable("auth_page", _I32, "", "the first Authentication page in the body"),
        _nullable("auth_last_page", _I32, "", "number of the last page, told by page 0"),
        _nullable("auth_length", _I32, "byte", "length of the data on all pages, told by page 0"),
        _nullable("auth_timestamp_s", _I64, "s", "claimed time of the Authentication, since 2019-01-01 UTC"),
        _nullable("auth_data", pa.binary(), "", "data of the pages in the body"),
    ),
    "features": (
        Column("time_ns", _I64, "ns", f"start of the interval, a multiple of 1 / features_hz, {_TIME}"),
        Column("link", NAME, "", "link instance"),
        Column("direction", NAME, "", "fwd from the link's first end to its second, else rev"),
        Column("sent", _I32, "", "frames sent in the interval; the other columns are about these"),
        Column("delivered", _I32, "", "of these, delivered, then or later"),
        Column("lost", _I32, "", "lost by the channel"),
        Column("overflow", _I32, "", "refused by a full queue"),
        Column("dropped", _I32, "", "dropped by a tap"),
        Column("replaced", _I32, "", "replaced by a tap; what it sent instead is counted as well"),
        Column("in_flight", _I32, "", "on their way when the run ended"),
        Column("size_bytes", _I64, "byte", "payloads of all frames sent"),
        Column("latency_sum_ns", _I64, "ns", "latencies of the delivered frames; divide by delivered for the mean"),
        _nullable("latency_max_ns", _I64, "ns", "the longest of these; null if none was delivered"),
        Column("heartbeats", _I32, "", "frames sent that are a MAVLink HEARTBEAT"),
        Column("commands", _I32, "", "frames sent that are COMMAND_LONG, COMMAND_INT, COMMAND_ACK or SET_MODE"),
        Column("missions", _I32, "", "frames sent that are a message MISSION_… of MAVLink's mission protocol"),
        Column("parameters", _I32, "", "frames sent that are a message PARAM_… of MAVLink's parameter protocol"),
    ),
}
"""The columns of every table. Truth may have more, as the world defines."""

TELEMETRY = (
    Column("time_ns", _I64, "ns", f"time of reception by the ground station, {_TIME}"),
    Column("operator", NAME, "", "the operator of the ground station"),
    Column("vehicle", NAME, "", "the aircraft at the other end of the gcs link"),
    _nullable("system_id", _I32, "", "MAVLink system id of the sender; null for undecodable bytes"),
    _nullable("component_id", _I32, "", "MAVLink component id of the sender; null for undecodable bytes"),
)
"""The columns with which the telemetry of every MAVLink message begins, a table for each; its fields follow."""

OPTIONAL = frozenset({"alerts", "observations", "features", "received_sensors"})
"""Tables that only some runs have: `alerts`, only runs with detectors; `observations`, only runs in which a radio
decoded something; `features`, only runs at level `study`; `received_sensors`, only runs in which an autopilot received
other readings than its sensors gave. In other runs all but `features` are read as empty."""

DERIVED = frozenset({"observations", "features"})
"""Tables that follow from frames and receptions: computed from these where they are recorded, as telemetry is, or else
during the run."""

BAD_DATA = "BAD_DATA"
"""pymavlink's name for bytes that are not a message."""

_SUFFIXES = (
    ("_radps", "rad/s"),
    ("_mps2", "m/s²"),
    ("_mps", "m/s"),
    ("_rad", "rad"),
    ("_deg", "deg"),
    ("_ns", "ns"),
    ("_kg", "kg"),
    ("_n", "N"),
    ("_w", "W"),
    ("_v", "V"),
    ("_a", "A"),
    ("_s", "s"),
    ("_m", "m"),
)


def unit_of(name: str) -> str:
    """The unit by the suffix of a column's name, or ""; an index may follow the suffix (`motor_radps_2`)."""
    stem = re.sub(r"_?\d+$", "", name)
    return next((unit for suffix, unit in _SUFFIXES if stem.endswith(suffix)), "")


def columns_of(table: str) -> tuple[Column, ...]:
    """The declared columns of a table in `TABLES`, or of "telemetry"; none of any other one."""
    return TELEMETRY if table == "telemetry" else TABLES.get(table, ())


def arrow_schema(table: str, columns: Sequence[Column] | None = None) -> pa.Schema:
    """The Arrow schema of `table`, a name in `TABLES` or "telemetry", for readers; `columns` replaces the declared
    columns if a run has others.
    """
    fields = [
        pa.field(
            column.name,
            pa.string() if column.type == TEXT else column.type,
            nullable=column.nullable,
            metadata={"unit": column.unit, "meaning": column.meaning},
        )
        for column in (columns_of(table) if columns is None else columns)
    ]
    return pa.schema(fields, metadata={"skyrange.table": table, "skyrange.format": FORMAT})


def truth_columns(names: Iterable[str]) -> tuple[Column, ...]:
    """The columns of truth for a world whose state variables have these names, in the world's order."""
    declared = {column.name: column for column in TABLES["truth"]}
    return TABLES["truth"][:3] + tuple(
        declared.get(name, Column(name, _F64, unit_of(name), "a state variable of the world")) for name in names
    )


def telemetry_columns(fields: Iterable[Column]) -> tuple[Column, ...]:
    """The columns of the telemetry of a MAVLink message with these fields; a name already in use gets a `_`."""
    taken = {column.name for column in TELEMETRY}
    return TELEMETRY + tuple(
        replace(field, name=field.name + "_") if field.name in taken else field for field in fields
    )


FULL: Final = "full"
STUDY: Final = "study"
SUMMARY: Final = "summary"

LEVELS: Final = (FULL, STUDY, SUMMARY)
"""From most to least."""

ALL_MESSAGES: Final = "telemetry"
"""Stands for the tables of all MAVLink messages."""

_STUDY: Final = frozenset(
    {"truth", "sensors", "received_sensors", "decisions", "events", "labels", "alerts", "observations", "features"}
)
_SUMMARY: Final = frozenset({"decisions", "events", "alerts"})
_KEPT: Final = {FULL: frozenset({*TABLES, ALL_MESSAGES}), STUDY: _STUDY, SUMMARY: _SUMMARY}

RECORDED: Final = {FULL: frozenset(TABLES) - DERIVED, STUDY: _STUDY, SUMMARY: _SUMMARY}
"""The tables whose rows a recorder writes; what a run at level `full` has besides is derived from them."""


def level_of(manifest: Mapping[str, Any]) -> str:
    """The level at which a run was recorded, by its manifest; those of older versions do not say it."""
    record = manifest.get("record")
    level = record.get("level") if isinstance(record, Mapping) else None
    return str(level) if level in LEVELS else FULL


def keeps(manifest: Mapping[str, Any], table: str) -> bool:
    """Whether a run with this manifest has a table of `schema.TABLES`, or "telemetry", perhaps without rows."""
    return table in _KEPT[level_of(manifest)]


def require_table(folder: Path | str, level: str, table: str) -> None:
    """Raise `InputError` if a run that was recorded at `level` into `folder` does not keep a table."""
    if table in _KEPT[level]:
        return
    enough = " or ".join(f'"{one}"' for one in reversed(LEVELS) if table in _KEPT[one])
    hint = f"It has no {table}. Run it again with --set record.level=full: the fingerprint is the same."
    raise InputError.one(str(folder), "record.level", level, f"a run recorded with [record] level = {enough}", hint)
