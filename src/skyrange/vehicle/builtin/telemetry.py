"""What does the aircraft report, and how often? Messages, intervals, streams, and the schedule.

Which messages a stream asks for is ArduCopter's table (ArduCopter/GCS_MAVLink_Copter.cpp, `STREAM_…_msgs`) as far as
these messages go. Without a request only HEARTBEAT is sent, at 1 Hz, as ArduCopter does with SR0_… at their
defaults of 0.
Each aircraft's reports start at a moment of its own within the interval, as if the aircraft had been switched on apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.agent.payloads import Payloads
from skyrange.codec.mavlink import dialect
from skyrange.core.time import NEVER, NS_PER_MS, NS_PER_S, NS_PER_US, Time
from skyrange.vehicle.builtin.fleet import Craft, Fleet
from skyrange.vehicle.builtin.layout import Control
from skyrange.vehicle.builtin.mission_protocol import current_message
from skyrange.vehicle.builtin.modes import Mode

SERVICE_NS: Final = 10 * NS_PER_MS
FIRMWARE: Final = 4 << 24 | 6 << 16 | 0 << 8 | 0
"""AUTOPILOT_VERSION.flight_sw_version: ArduCopter 4.6.0-dev, whose names and behaviour this follows."""

_SENSORS = (
    dialect.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | dialect.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | dialect.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | dialect.MAV_SYS_STATUS_SENSOR_GPS
    | dialect.MAV_SYS_STATUS_SENSOR_LASER_POSITION
    | dialect.MAV_SYS_STATUS_SENSOR_ANGULAR_RATE_CONTROL
    | dialect.MAV_SYS_STATUS_SENSOR_ATTITUDE_STABILIZATION
    | dialect.MAV_SYS_STATUS_SENSOR_YAW_POSITION
    | dialect.MAV_SYS_STATUS_SENSOR_Z_ALTITUDE_CONTROL
    | dialect.MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL
    | dialect.MAV_SYS_STATUS_AHRS
    | dialect.MAV_SYS_STATUS_PREARM_CHECK
)
_CAPABILITIES = (
    dialect.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | dialect.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | dialect.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    | dialect.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | dialect.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
    | dialect.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)
_I16 = 32_767
_U16 = 65_535
_NO_ATTITUDE = (math.nan, math.nan, math.nan, math.nan)


def _boot_ms(fleet: Fleet) -> int:
    return max(fleet.now, 0) // NS_PER_MS & 0xFFFFFFFF


def _boot_us(fleet: Fleet) -> int:
    """`time_usec` as ArduPilot fills it: since boot, never UTC, which is SYSTEM_TIME's to say."""
    return max(fleet.now, 0) // NS_PER_US


def _int(value: float, most: int = _I16) -> int:
    """A number as a signed field that holds ±`most`; what is beyond stays at the end."""
    return int(min(max(value, -most), most))


def _vector(fleet: Fleet, craft: Craft, name: str) -> tuple[float, float, float]:
    a, b, c = fleet.estimate[name][craft.row].tolist()
    return a, b, c


def _heading_cdeg(fleet: Fleet, craft: Craft) -> int:
    return int(math.degrees(0.5 * math.pi - float(fleet.estimate["yaw"][craft.row])) % 360.0 * 100.0) % 36_000


def heartbeat(fleet: Fleet, craft: Craft) -> Any:
    """HEARTBEAT, base mode as GCS_MAVLINK_Copter::base_mode makes it: manual input always, guided with a position."""
    mode = (
        dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        | dialect.MAV_MODE_FLAG_STABILIZE_ENABLED
        | dialect.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
    )
    if craft.mode in (Mode.AUTO, Mode.RTL, Mode.GUIDED, Mode.LAND, Mode.BRAKE):
        mode |= dialect.MAV_MODE_FLAG_GUIDED_ENABLED
    armed = fleet.armed(craft)
    if armed:
        mode |= dialect.MAV_MODE_FLAG_SAFETY_ARMED
    status = dialect.MAV_STATE_STANDBY if fleet.landed(craft) else dialect.MAV_STATE_ACTIVE
    return dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_QUADROTOR, dialect.MAV_AUTOPILOT_ARDUPILOTMEGA, mode, craft.mode, status, 3
    )


def _sys_status(fleet: Fleet, craft: Craft) -> Any:
    motors = dialect.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS if fleet.armed(craft) else 0
    enabled = _SENSORS | motors
    # no battery is modelled: voltage and current unknown, as the message's definition says
    return dialect.MAVLink_sys_status_message(
        enabled, enabled, enabled, 0, _U16, -1, -1, 0, 0, 0, 0, 0, 0
    )  # fmt: skip


def _system_time(fleet: Fleet, craft: Craft) -> Any:
    return dialect.MAVLink_system_time_message(fleet.epoch.utc_us(fleet.now), _boot_ms(fleet))


def _gps_raw_int(fleet: Fleet, craft: Craft) -> Any:
    lat, lon = fleet.lat_lon_e7(craft)
    east, north, _ = _vector(fleet, craft, "vel")
    up = _vector(fleet, craft, "pos")[2]
    alt = fleet.origin.alt_msl_m + up
    course = int(math.degrees(math.atan2(east, north)) % 360.0 * 100.0) % 36_000
    return dialect.MAVLink_gps_raw_int_message(
        _boot_us(fleet), dialect.GPS_FIX_TYPE_RTK_FIXED, lat, lon, _int(alt * 1e3, 2**31 - 1),
        121, 80, _int(math.hypot(east, north) * 100.0), course, 10,
        _int((alt + fleet.origin.geoid_m) * 1e3, 2**31 - 1), 300, 300, 40, 0,
    )  # fmt: skip


def _attitude(fleet: Fleet, craft: Craft) -> Any:
    row, estimate = craft.row, fleet.estimate
    forward, left, up = _vector(fleet, craft, "rate")
    yaw = (1.5 * math.pi - float(estimate["yaw"][row])) % (2.0 * math.pi) - math.pi
    return dialect.MAVLink_attitude_message(
        _boot_ms(fleet), float(estimate["roll"][row]), -float(estimate["pitch"][row]), yaw, forward, -left, -up
    )


def _local_position_ned(fleet: Fleet, craft: Craft) -> Any:
    east, north, up = _vector(fleet, craft, "pos")
    v_east, v_north, v_up = _vector(fleet, craft, "vel")
    return dialect.MAVLink_local_position_ned_message(_boot_ms(fleet), north, east, -up, v_north, v_east, -v_up)


def _global_position_int(fleet: Fleet, craft: Craft) -> Any:
    lat, lon = fleet.lat_lon_e7(craft)
    up = _vector(fleet, craft, "pos")[2]
    east, north, v_up = _vector(fleet, craft, "vel")
    return dialect.MAVLink_global_position_int_message(
        _boot_ms(fleet), lat, lon, _int((fleet.origin.alt_msl_m + up) * 1e3, 2**31 - 1),
        _int((up - craft.home[2]) * 1e3, 2**31 - 1), _int(north * 100.0), _int(east * 100.0), _int(-v_up * 100.0),
        _heading_cdeg(fleet, craft),
    )  # fmt: skip


def _nav_controller_output(fleet: Fleet, craft: Craft) -> Any:
    row, flight = craft.row, fleet.flight
    distance, bearing, alt_error = 0, 0, 0.0
    if flight["control"][row] in (Control.LEG, Control.POSITION):
        here = _vector(fleet, craft, "pos")
        to = flight["target_pos"][row].tolist()
        east, north = to[0] - here[0], to[1] - here[1]
        distance = _int(math.hypot(east, north), _U16)
        bearing = int((math.degrees(math.atan2(east, north)) + 180.0) % 360.0 - 180.0)
        alt_error = to[2] - here[2]
    return dialect.MAVLink_nav_controller_output_message(
        math.degrees(float(fleet.estimate["roll"][row])), -math.degrees(float(fleet.estimate["pitch"][row])),
        bearing, bearing, distance, alt_error, 0.0, 0.0,
    )  # fmt: skip


def _vfr_hud(fleet: Fleet, craft: Craft) -> Any:
    east, north, v_up = _vector(fleet, craft, "vel")
    speed = math.hypot(east, north)
    throttle = _int(float(fleet.flight["throttle"][craft.row]) * 100.0, 100) if fleet.armed(craft) else 0
    alt = fleet.origin.alt_msl_m + _vector(fleet, craft, "pos")[2]
    return dialect.MAVLink_vfr_hud_message(speed, speed, _heading_cdeg(fleet, craft) // 100, throttle, alt, v_up)


def _extended_sys_state(fleet: Fleet, craft: Craft) -> Any:
    if fleet.landed(craft):
        state = dialect.MAV_LANDED_STATE_ON_GROUND
    elif fleet.control(craft) == Control.LAND:
        state = dialect.MAV_LANDED_STATE_LANDING
    elif fleet.control(craft) == Control.TAKEOFF:
        state = dialect.MAV_LANDED_STATE_TAKEOFF
    else:
        state = dialect.MAV_LANDED_STATE_IN_AIR
    return dialect.MAVLink_extended_sys_state_message(dialect.MAV_VTOL_STATE_UNDEFINED, state)


def _home_position(fleet: Fleet, craft: Craft) -> Any:
    east, north, up = craft.home
    lat, lon = fleet.origin.geodetic_of(east, north)
    alt = _int((fleet.origin.alt_msl_m + up) * 1e3, 2**31 - 1)
    return dialect.MAVLink_home_position_message(
        round(lat * 1e7), round(lon * 1e7), alt, north, east, -up, _NO_ATTITUDE, 0.0, 0.0, 0.0, _boot_us(fleet),
    )  # fmt: skip


def _autopilot_version(fleet: Fleet, craft: Craft) -> Any:
    return dialect.MAVLink_autopilot_version_message(
        _CAPABILITIES, FIRMWARE, 0, 0, 0, b"skyrange", bytes(8), bytes(8), 0, 0, craft.system_id, bytes(18)
    )


def _mission_current(fleet: Fleet, craft: Craft) -> Any:
    return current_message(craft)


_ID = dialect
BUILDERS: Final[dict[int, Callable[[Fleet, Craft], Any]]] = {
    _ID.MAVLINK_MSG_ID_HEARTBEAT: heartbeat,
    _ID.MAVLINK_MSG_ID_SYS_STATUS: _sys_status,
    _ID.MAVLINK_MSG_ID_SYSTEM_TIME: _system_time,
    _ID.MAVLINK_MSG_ID_GPS_RAW_INT: _gps_raw_int,
    _ID.MAVLINK_MSG_ID_ATTITUDE: _attitude,
    _ID.MAVLINK_MSG_ID_LOCAL_POSITION_NED: _local_position_ned,
    _ID.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: _global_position_int,
    _ID.MAVLINK_MSG_ID_MISSION_CURRENT: _mission_current,
    _ID.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT: _nav_controller_output,
    _ID.MAVLINK_MSG_ID_VFR_HUD: _vfr_hud,
    _ID.MAVLINK_MSG_ID_AUTOPILOT_VERSION: _autopilot_version,
    _ID.MAVLINK_MSG_ID_HOME_POSITION: _home_position,
    _ID.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: _extended_sys_state,
}
"""What can be streamed or asked for, by message id."""
COLUMN: Final = {message: column for column, message in enumerate(BUILDERS)}

STREAMS: Final[dict[int, tuple[str, tuple[int, ...]]]] = {
    _ID.MAV_DATA_STREAM_EXTENDED_STATUS: (
        "SR0_EXT_STAT",
        (
            _ID.MAVLINK_MSG_ID_SYS_STATUS,
            _ID.MAVLINK_MSG_ID_MISSION_CURRENT,
            _ID.MAVLINK_MSG_ID_GPS_RAW_INT,
            _ID.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT,
        ),
    ),
    _ID.MAV_DATA_STREAM_POSITION: (
        "SR0_POSITION",
        (_ID.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, _ID.MAVLINK_MSG_ID_LOCAL_POSITION_NED),
    ),
    _ID.MAV_DATA_STREAM_EXTRA1: ("SR0_EXTRA1", (_ID.MAVLINK_MSG_ID_ATTITUDE,)),
    _ID.MAV_DATA_STREAM_EXTRA2: ("SR0_EXTRA2", (_ID.MAVLINK_MSG_ID_VFR_HUD,)),
    _ID.MAV_DATA_STREAM_EXTRA3: ("SR0_EXTRA3", (_ID.MAVLINK_MSG_ID_SYSTEM_TIME,)),
}
"""MAV_DATA_STREAM → the parameter with its rate at boot, and its messages."""


class Schedule:
    """When which message of which aircraft falls due: two (aircraft, message) arrays of nanoseconds."""

    __slots__ = ("due", "offset", "period")

    def __init__(self, offsets_ns: NDArray[np.int64]) -> None:
        """`offsets_ns` (aircraft,): where in its interval each aircraft starts, below one second."""
        self.offset = offsets_ns
        self.period = np.zeros((offsets_ns.shape[0], len(BUILDERS)), dtype=np.int64)
        self.due = np.full(self.period.shape, NEVER, dtype=np.int64)

    def set(self, row: int, message: int, period_ns: Time, now: Time) -> None:
        """Send `message` every `period_ns`, rounded up to the service time, from now on; 0 stops it."""
        column = COLUMN[message]
        period = -(-period_ns // SERVICE_NS) * SERVICE_NS
        self.period[row, column] = period
        if period == 0:
            self.due[row, column] = NEVER
        else:
            offset = int(self.offset[row]) % period // SERVICE_NS * SERVICE_NS
            self.due[row, column] = now + offset

    def send_due(self, fleet: Fleet) -> None:
        """Send everything that is due now and set the next times."""
        now = fleet.now
        due = self.due <= now
        if not due.any():
            return
        rows, columns = np.nonzero(due)
        self.due[due] += self.period[due]
        fleet.locate(np.flatnonzero(due[:, _LOCATED].any(axis=1)))
        crafts = fleet.crafts
        payloads = [
            crafts[row].packer.pack(_IN_ORDER[column](fleet, crafts[row]))
            for row, column in zip(rows.tolist(), columns.tolist(), strict=True)
        ]
        fleet.outbox.send_block(rows, Payloads.of(payloads))


_IN_ORDER: Final = tuple(BUILDERS.values())
_LOCATED: Final = [COLUMN[_ID.MAVLINK_MSG_ID_GLOBAL_POSITION_INT], COLUMN[_ID.MAVLINK_MSG_ID_GPS_RAW_INT]]


def boot_rates(schedule: Schedule, fleet: Fleet, craft: Craft) -> None:
    """Start what is sent unasked: HEARTBEAT at 1 Hz, and streams at their SR0_… rates."""
    schedule.set(craft.row, _ID.MAVLINK_MSG_ID_HEARTBEAT, NS_PER_S, 0)
    for name, messages in STREAMS.values():
        rate = int(fleet.param(craft, name))
        for message in messages:
            schedule.set(craft.row, message, NS_PER_S // rate if rate else 0, 0)


def boot_period_ns(fleet: Fleet, craft: Craft, message: int) -> Time:
    """How often a message is sent by default; 0 is never."""
    if message == _ID.MAVLINK_MSG_ID_HEARTBEAT:
        return NS_PER_S
    for name, messages in STREAMS.values():
        if message in messages:
            rate = int(fleet.param(craft, name))
            return NS_PER_S // rate if rate else 0
    return 0
