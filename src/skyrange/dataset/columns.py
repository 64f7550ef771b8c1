"""Columns of all views (type, unit, meaning, observable or not), and the MAVLink field behind each of `aircraft`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

import pyarrow as pa
import pyarrow.compute as pc

from skyrange.core.errors import ComponentError
from skyrange.record.schema import NAME, TABLES, TEXT


class TelemetryField(NamedTuple):
    """One column: `field` of `message` times `factor`."""

    column: str
    message: str
    field: str
    unit: str = ""
    factor: float = 1.0


FIELDS: Final = (
    TelemetryField("mode", "HEARTBEAT", "custom_mode"),
    TelemetryField("base_mode", "HEARTBEAT", "base_mode"),
    TelemetryField("system_status", "HEARTBEAT", "system_status"),
    TelemetryField("lat_deg", "GLOBAL_POSITION_INT", "lat", "deg", 1e-7),
    TelemetryField("lon_deg", "GLOBAL_POSITION_INT", "lon", "deg", 1e-7),
    TelemetryField("alt_msl_m", "GLOBAL_POSITION_INT", "alt", "m", 1e-3),
    TelemetryField("alt_relative_m", "GLOBAL_POSITION_INT", "relative_alt", "m", 1e-3),
    TelemetryField("vel_north_mps", "GLOBAL_POSITION_INT", "vx", "m/s", 1e-2),
    TelemetryField("vel_east_mps", "GLOBAL_POSITION_INT", "vy", "m/s", 1e-2),
    TelemetryField("vel_down_mps", "GLOBAL_POSITION_INT", "vz", "m/s", 1e-2),
    TelemetryField("heading_deg", "GLOBAL_POSITION_INT", "hdg", "deg", 1e-2),
    TelemetryField("roll_rad", "ATTITUDE", "roll", "rad"),
    TelemetryField("pitch_rad", "ATTITUDE", "pitch", "rad"),
    TelemetryField("yaw_rad", "ATTITUDE", "yaw", "rad"),
    TelemetryField("groundspeed_mps", "VFR_HUD", "groundspeed", "m/s"),
    TelemetryField("climb_mps", "VFR_HUD", "climb", "m/s"),
    TelemetryField("throttle", "VFR_HUD", "throttle", "%"),
    TelemetryField("gnss_fix", "GPS_RAW_INT", "fix_type"),
    TelemetryField("gnss_satellites", "GPS_RAW_INT", "satellites_visible"),
    TelemetryField("gnss_eph", "GPS_RAW_INT", "eph", "", 1e-2),
    TelemetryField("gnss_lat_deg", "GPS_RAW_INT", "lat", "deg", 1e-7),
    TelemetryField("gnss_lon_deg", "GPS_RAW_INT", "lon", "deg", 1e-7),
    TelemetryField("gnss_alt_m", "GPS_RAW_INT", "alt", "m", 1e-3),
    TelemetryField("gnss_speed_mps", "GPS_RAW_INT", "vel", "m/s", 1e-2),
    TelemetryField("ekf_velocity_ratio", "EKF_STATUS_REPORT", "velocity_variance"),
    TelemetryField("ekf_horizontal_ratio", "EKF_STATUS_REPORT", "pos_horiz_variance"),
    TelemetryField("ekf_vertical_ratio", "EKF_STATUS_REPORT", "pos_vert_variance"),
    TelemetryField("ekf_compass_ratio", "EKF_STATUS_REPORT", "compass_variance"),
    TelemetryField("ekf_flags", "EKF_STATUS_REPORT", "flags"),
    TelemetryField("battery_v", "SYS_STATUS", "voltage_battery", "V", 1e-3),
    TelemetryField("battery_a", "SYS_STATUS", "current_battery", "A", 1e-2),
    TelemetryField("battery_percent", "SYS_STATUS", "battery_remaining", "%"),
    TelemetryField("pressure_hpa", "SCALED_PRESSURE", "press_abs", "hPa"),
    TelemetryField("mission_item", "MISSION_CURRENT", "seq"),
    TelemetryField("cross_track_m", "NAV_CONTROLLER_OUTPUT", "xtrack_error", "m"),
)
"""EKF_STATUS_REPORT holds the estimator's innovations as test ratios: 1 is the limit of the gate."""

AGED: Final = ("HEARTBEAT", "GLOBAL_POSITION_INT", "ATTITUDE", "GPS_RAW_INT", "EKF_STATUS_REPORT")
"""Messages whose age is a column."""

ESTIMATES: Final = frozenset(
    {
        "AHRS", "AHRS2", "ATTITUDE", "ATTITUDE_QUATERNION", "EKF_STATUS_REPORT", "GLOBAL_POSITION_INT", "GPS_RAW_INT",
        "GPS2_RAW", "LOCAL_POSITION_NED", "NAV_CONTROLLER_OUTPUT", "RAW_IMU", "SCALED_IMU", "SCALED_IMU2",
        "SCALED_IMU3", "SCALED_PRESSURE", "SCALED_PRESSURE2", "VFR_HUD", "VIBRATION",
    }
)  # fmt: skip
"""Messages that tell sensor readings or what the estimator makes of them."""


Role = Literal["observable", "bookkeeping", "label"]
"""observable: known at the sensor's place. bookkeeping: ids and positions in the data set. label: what is to be
found. A detector may use observable columns only."""


@dataclass(frozen=True, slots=True)
class ViewColumn:
    """One column of a view; `unit` is "" for names and counts."""

    name: str
    type: pa.DataType
    unit: str
    meaning: str
    role: Role
    nullable: bool = False


_S, _B, _F, _I64 = pa.string(), pa.bool_(), pa.float64(), pa.int64()
_I32, _I16 = pa.int32(), pa.int16()
_START = "ns since the run's start"


def _seen(name: str, type_: pa.DataType, unit: str, meaning: str, *, nullable: bool = False) -> ViewColumn:
    return ViewColumn(name, type_, unit, meaning, "observable", nullable=nullable)


def _kept(name: str, type_: pa.DataType, unit: str, meaning: str, *, nullable: bool = False) -> ViewColumn:
    return ViewColumn(name, type_, unit, meaning, "bookkeeping", nullable=nullable)


def _label(name: str, type_: pa.DataType, unit: str, meaning: str, *, nullable: bool = False) -> ViewColumn:
    return ViewColumn(name, type_, unit, meaning, "label", nullable=nullable)


RUN_COLUMNS: Final = (
    _kept("run", _S, "", "the run: its block and arm"),
    _kept("block", _S, "", "all arms of one draw of a scenario; lies in one split"),
    _kept("arm", _S, "", "nominal, attacked, sham or another arm of the block"),
)
"""Begin every view."""

WINDOW_COLUMNS: Final = (
    _kept("window", _I64, "", "number of the interval since the run's start"),
    _kept("content_hash", _S, "", "hash of the observable columns of all rows of the same place and window"),
    _kept(
        "duplicate_of",
        _S,
        "",
        "the first run of the block, or one of another split, with an identical window",
        nullable=True,
    ),
)
"""End every view of a sensor, before its labels."""

_AUTHOR = (
    _label("author", _S, "", "id of the attack or fault; null if there is none", nullable=True),
    _label("kind", _S, "", "kind of the attack or fault", nullable=True),
    _label("family", _S, "", "mechanism family of the attack; null for a fault", nullable=True),
)

FRAME_LABELS: Final = (
    _label("hostile", _B, "", "an attack formed or delayed this frame"),
    _label("derived", _B, "", "it leads back to a hostile act by parents and causes, or tells a falsified estimate"),
    _label("way", _S, "", "of derived: `ids` or `estimate`", nullable=True),
    _label("harmless_intrusion", _B, "", "somebody unauthorised formed it and harms nobody, or it leads back to that"),
    _label("sham", _B, "", "another sham formed it, or it leads back to one"),
    _label("fault", _B, "", "a benign fault formed it, or it leads back to one"),
    _label("steps", _I32, "", "number of steps from the act", nullable=True),
    *_AUTHOR,
)
"""Labels of views with a row for each frame."""

WINDOW_LABELS: Final = (
    _label("active", _B, "", "an attack acts on this aircraft or operator in the window, or on nobody in particular"),
    _label("observable", _B, "", "a hostile or derived frame is seen here, or a frame is missing by an attack"),
    _label(
        "effect",
        _B,
        "",
        "the aircraft has departed from the nominal twin; null if the caller did not say",
        nullable=True,
    ),
    _label("after_onset", _B, "", "the first act of any attack of the run was before the window's end"),
    _label("harmless_intrusion_active", _B, "", "somebody unauthorised acts and harms nobody"),
    _label("sham_active", _B, "", "another sham acts"),
    _label("fault_active", _B, "", "a benign fault acts"),
    *_AUTHOR,
)
"""Labels of views with a row for each window."""

_MAVLINK = (
    _kept("place", _S, "", "the endpoint at which the sensor listens"),
    _kept("link", _S, "", "the link of which that is an end"),
    _seen("time_ns", _I64, "ns", f"when it arrived or was sent, {_START}"),
    _seen("received", _B, "", "whether it arrived here; else it was sent from here"),
    _seen("src", _S, "", "the source that the frame claims"),
    _seen("dst", _S, "", "the destination that the frame claims"),
    _seen("size", _I32, "byte", "length of the raw bytes"),
    _seen("version", _I16, "", "MAVLink version 1 or 2 by the first byte; 0 for other bytes"),
    _seen("valid", _B, "", "whether it is a whole message with a correct checksum"),
    _seen("signed", _B, "", "whether the header says that it is signed; the signature is not verified"),
    _seen("sequence", _I16, "", "sequence number of the header", nullable=True),
    _seen("system", _I16, "", "claimed system id", nullable=True),
    _seen("component", _I16, "", "claimed component id", nullable=True),
    _seen("message_id", _I32, "", "message id of the header", nullable=True),
    _seen("message", _S, "", "name of the message; null if the dialect has none", nullable=True),
    _seen("raw", pa.binary(), "", "the bytes"),
)

_FLOWS = (
    _kept("place", _S, "", "the endpoint at which the sensor listens"),
    _kept("link", _S, "", "the link of which that is an end"),
    _seen("time_ns", _I64, "ns", f"start of the window, {_START}"),
    _seen("received", _B, "", "frames that arrive here; else frames sent from here"),
    _seen("frames", _I32, "", "number of frames"),
    _seen("bytes", _I64, "byte", "sum of their lengths"),
    _seen("size_mean", _F, "byte", "mean length", nullable=True),
    _seen("size_std", _F, "byte", "standard deviation of the length", nullable=True),
    _seen("size_min", _F, "byte", "shortest", nullable=True),
    _seen("size_max", _F, "byte", "longest", nullable=True),
    _seen("iat_mean_ms", _F, "ms", "mean time between successive frames of the window", nullable=True),
    _seen("iat_std_ms", _F, "ms", "its standard deviation", nullable=True),
    _seen("iat_min_ms", _F, "ms", "the shortest", nullable=True),
    _seen("iat_max_ms", _F, "ms", "the longest", nullable=True),
    _seen("heartbeats", _F, "", "share of HEARTBEAT", nullable=True),
    _seen("commands", _F, "", "share of commands, their acknowledgements and SET_MODE", nullable=True),
    _seen("missions", _F, "", "share of MISSION_ messages", nullable=True),
    _seen("parameters", _F, "", "share of PARAM_ messages", nullable=True),
    _seen("invalid", _F, "", "share of bytes that are no valid message", nullable=True),
    _seen("signed", _F, "", "share of frames that say that they are signed", nullable=True),
    _seen("message_kinds", _I32, "", "number of different message ids"),
    _seen("senders", _I32, "", "number of different claimed (system, component)"),
    _seen("sequence_gaps", _I32, "", "frames whose sequence number does not follow their sender's previous one"),
)

_AIRCRAFT = (
    _kept("vehicle", _S, "", "the aircraft, operator/vehicle"),
    _seen("time_ns", _I64, "ns", f"end of the interval, {_START}"),
    *(
        _seen(field.column, _F, field.unit, f"last {field.message}.{field.field} received", nullable=True)
        for field in FIELDS
    ),
    *(
        _seen(f"{name.lower()}_age_s", _F, "s", f"time since the last {name} was received", nullable=True)
        for name in AGED
    ),
)

_HIDDEN: Final = frozenset({"receiver", "frame", "radio"})
_REMOTE_ID = tuple(
    ViewColumn(
        one.name,
        _S if one.type in (NAME, TEXT) else one.type,
        one.unit,
        one.meaning,
        "bookkeeping" if one.name in _HIDDEN else "observable",
        one.nullable,
    )
    for one in TABLES["observations"]
)

_APPROVAL = (
    _kept("place", _S, "", "the ground station at which the sensor listens"),
    _kept("link", _S, "", "its approval link"),
    _seen("time_ns", _I64, "ns", f"when it arrived or was sent, {_START}"),
    _seen("received", _B, "", "whether it arrived here; else it was sent from here"),
    _seen("src", _S, "", "the source that the message claims"),
    _seen("dst", _S, "", "the destination that the message claims"),
    _seen("size", _I32, "byte", "length of the message"),
    _seen("valid", _B, "", "whether it is a JSON object"),
    _seen("method", _S, "", "method of a request", nullable=True),
    _seen("status", _I32, "", "status of a response", nullable=True),
    _seen("path", _S, "", "path of the request or response", nullable=True),
    _seen("state", _S, "", "state of the intent in the body", nullable=True),
    _seen("reason", _S, "", "reason in the body", nullable=True),
    _seen("volumes", _I32, "", "number of volumes in the body", nullable=True),
    _seen("raw", pa.binary(), "", "the bytes"),
)

_EPISODES = (
    _kept("vehicle", _S, "", "the aircraft acted on; null for an act on nobody in particular", nullable=True),
    _label("author", _S, "", "id of the attack or fault"),
    _label("kind", _S, "", "kind of the attack or fault"),
    _label("family", _S, "", "mechanism family of the attack; null for a fault", nullable=True),
    _label("role", _S, "", "attack, harmless_intrusion, sham or fault"),
    _label("onset_ns", _I64, "ns", f"first act, {_START}"),
    _label("end_ns", _I64, "ns", f"end of the last act, {_START}"),
    _label("acts", _I32, "", "number of acts"),
    _label("observable_ns", _I64, "ns", "first frame at the station's end of the aircraft's link that is hostile, "
           "derived, or missing by the attack", nullable=True),
    _label("effect_ns", _I64, "ns", "when the aircraft departed from the nominal twin", nullable=True),
)  # fmt: skip

VIEWS: Final[dict[str, tuple[ViewColumn, ...]]] = {
    "mavlink": (*RUN_COLUMNS, *_MAVLINK, *WINDOW_COLUMNS, *FRAME_LABELS),
    "flows": (*RUN_COLUMNS, *_FLOWS, *WINDOW_COLUMNS, *WINDOW_LABELS,
              _label("hostile_frames", _I32, "", "hostile frames in the window"),
              _label("derived_frames", _I32, "", "derived frames in the window")),
    "aircraft": (*RUN_COLUMNS, *_AIRCRAFT, *WINDOW_COLUMNS, *WINDOW_LABELS),
    "remote_id": (*RUN_COLUMNS, *_REMOTE_ID, *WINDOW_COLUMNS, *FRAME_LABELS),
    "approval": (*RUN_COLUMNS, *_APPROVAL, *WINDOW_COLUMNS, *FRAME_LABELS),
    "episodes": (*RUN_COLUMNS, *_EPISODES),
}  # fmt: skip
"""By view, its columns in order."""

WINDOW_KEYS: Final[dict[str, tuple[str, ...]]] = {
    "mavlink": ("link", "place"),
    "flows": ("link", "place", "received"),
    "aircraft": ("vehicle",),
    "remote_id": ("receiver",),
    "approval": ("link", "place"),
}
"""By view of a sensor, the columns that tell its places; windows of one place are compared between runs."""


def view_schema(view: str) -> pa.Schema:
    """The Arrow schema of a view, with unit, meaning and role as metadata of each field."""
    return pa.schema(
        [
            pa.field(one.name, one.type, one.nullable, {"unit": one.unit, "meaning": one.meaning, "role": one.role})
            for one in VIEWS[view]
        ]
    )


def observable_columns(view: str) -> list[str]:
    """The columns of a view that a sensor at the place knows; only these are inputs of a detector."""
    return [one.name for one in VIEWS[view] if one.role == "observable"]


def check_table(view: str, table: pa.Table) -> pa.Table:
    """The table with the declared order and types.

    Raises `ComponentError` for a column that is missing or not declared, of another type, or null where it must not be.
    """
    declared = {one.name: one for one in VIEWS[view]}
    wrong = set(declared) ^ set(table.column_names)
    if wrong:
        raise ComponentError(f"view {view}", f"columns {sorted(wrong)} are declared or written, but not both")
    for one in declared.values():
        column = table.column(one.name)
        if column.type != one.type:
            raise ComponentError(f"view {view}", f"column {one.name} is {column.type}; {one.type} is declared")
        if column.null_count and not one.nullable:
            raise ComponentError(f"view {view}", f"column {one.name} has null in {pc.sum(column.is_null())} rows")
    return table.select(list(declared)).cast(view_schema(view))
