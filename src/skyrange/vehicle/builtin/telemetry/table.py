"""MessageTable of messages: the builder of each, in the order of sending, and when there is nothing to send."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink.frames import LAYOUTS
from skyrange.codec.mavlink.message_columns import MessageTable, payload_dtype
from skyrange.contracts.frames import Ints
from skyrange.vehicle.builtin.fleet import Fleet, Vehicle
from skyrange.vehicle.builtin.telemetry import (
    motion,
    sensors,
    status,
)
from skyrange.vehicle.builtin.telemetry.columns import Available, Builder

BUILDERS: Final[dict[int, Builder]] = {
    mav.MAVLINK_MSG_ID_HEARTBEAT: status.heartbeat,
    mav.MAVLINK_MSG_ID_HOME_POSITION: motion.home_position,
    mav.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: motion.gps_global_origin,
    mav.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: status.extended_sys_state,
    mav.MAVLINK_MSG_ID_RAW_IMU: sensors.raw_imu,
    mav.MAVLINK_MSG_ID_SCALED_IMU: sensors.scaled_imu,
    mav.MAVLINK_MSG_ID_SCALED_IMU2: sensors.scaled_imu,
    mav.MAVLINK_MSG_ID_SCALED_IMU3: sensors.scaled_imu3,
    mav.MAVLINK_MSG_ID_SCALED_PRESSURE: sensors.scaled_pressure,
    mav.MAVLINK_MSG_ID_SCALED_PRESSURE2: sensors.scaled_pressure,
    mav.MAVLINK_MSG_ID_SYS_STATUS: status.sys_status,
    mav.MAVLINK_MSG_ID_POWER_STATUS: status.power_status,
    mav.MAVLINK_MSG_ID_MCU_STATUS: status.mcu_status,
    mav.MAVLINK_MSG_ID_MEMINFO: status.meminfo,
    mav.MAVLINK_MSG_ID_MISSION_CURRENT: status.mission_current,
    mav.MAVLINK_MSG_ID_GPS_RAW_INT: sensors.gps_raw_int,
    mav.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT: motion.nav_controller_output,
    mav.MAVLINK_MSG_ID_FENCE_STATUS: status.fence_status,
    mav.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: motion.position_target_global_int,
    mav.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: motion.position_target_local_ned,
    mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: motion.global_position_int,
    mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED: motion.local_position_ned,
    mav.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: sensors.servo_output_raw,
    mav.MAVLINK_MSG_ID_RC_CHANNELS: sensors.rc_channels,
    mav.MAVLINK_MSG_ID_ATTITUDE: motion.attitude,
    mav.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: motion.attitude_quaternion,
    mav.MAVLINK_MSG_ID_AHRS2: motion.ahrs2,
    mav.MAVLINK_MSG_ID_ESC_TELEMETRY_1_TO_4: sensors.esc_telemetry,
    mav.MAVLINK_MSG_ID_VFR_HUD: motion.vfr_hud,
    mav.MAVLINK_MSG_ID_AHRS: sensors.ahrs,
    mav.MAVLINK_MSG_ID_RANGEFINDER: sensors.rangefinder,
    mav.MAVLINK_MSG_ID_DISTANCE_SENSOR: sensors.distance_sensor,
    mav.MAVLINK_MSG_ID_SYSTEM_TIME: status.system_time,
    mav.MAVLINK_MSG_ID_TERRAIN_REPORT: motion.terrain_report,
    mav.MAVLINK_MSG_ID_BATTERY_STATUS: status.battery_status,
    mav.MAVLINK_MSG_ID_EKF_STATUS_REPORT: status.ekf_status_report,
    mav.MAVLINK_MSG_ID_VIBRATION: status.vibration,
    mav.MAVLINK_MSG_ID_HWSTATUS: status.hwstatus,
    mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION: status.autopilot_version,
    mav.MAVLINK_MSG_ID_OPEN_DRONE_ID_LOCATION: motion.open_drone_id_location,
}
"""Messages that can be streamed or requested, by id; an aircraft's messages of one moment are sent in this order."""

AVAILABLE: Final[dict[int, Available]] = {
    mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED: motion.has_position,
    mav.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: motion.has_destination,
    mav.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: motion.has_local_target,
    mav.MAVLINK_MSG_ID_FENCE_STATUS: status.has_fence,
    mav.MAVLINK_MSG_ID_BATTERY_STATUS: status.has_battery_monitor,
    mav.MAVLINK_MSG_ID_AHRS2: sensors.has_fix,
    mav.MAVLINK_MSG_ID_OPEN_DRONE_ID_LOCATION: motion.has_position,
}
"""Messages that ArduPilot does not send while they have no contents."""

UNSOLICITED: Final = frozenset((mav.MAVLINK_MSG_ID_OPEN_DRONE_ID_LOCATION,))
"""Messages that are sent unrequested and cannot be requested (GCS_MAVLINK::mavlink_id_to_ap_message_id)."""

NEVER_SENT: Final = frozenset(
    (
        mav.MAVLINK_MSG_ID_ADSB_VEHICLE,
        mav.MAVLINK_MSG_ID_AIRSPEED,
        mav.MAVLINK_MSG_ID_ATTITUDE_TARGET,
        mav.MAVLINK_MSG_ID_CAMERA_CAPTURE_STATUS,
        mav.MAVLINK_MSG_ID_CAMERA_FEEDBACK,
        mav.MAVLINK_MSG_ID_CAMERA_INFORMATION,
        mav.MAVLINK_MSG_ID_CAMERA_SETTINGS,
        mav.MAVLINK_MSG_ID_EFI_STATUS,
        mav.MAVLINK_MSG_ID_GENERATOR_STATUS,
        mav.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS,
        mav.MAVLINK_MSG_ID_GIMBAL_MANAGER_INFORMATION,
        mav.MAVLINK_MSG_ID_GIMBAL_MANAGER_STATUS,
        mav.MAVLINK_MSG_ID_GPS2_RAW,
        mav.MAVLINK_MSG_ID_GPS2_RTK,
        mav.MAVLINK_MSG_ID_GPS_RTK,
        mav.MAVLINK_MSG_ID_HIGH_LATENCY2,
        mav.MAVLINK_MSG_ID_MAG_CAL_PROGRESS,
        mav.MAVLINK_MSG_ID_MAG_CAL_REPORT,
        mav.MAVLINK_MSG_ID_MISSION_ITEM_REACHED,
        mav.MAVLINK_MSG_ID_OPTICAL_FLOW,
        mav.MAVLINK_MSG_ID_PARAM_VALUE,
        mav.MAVLINK_MSG_ID_PID_TUNING,
        mav.MAVLINK_MSG_ID_RC_CHANNELS_RAW,
        mav.MAVLINK_MSG_ID_RPM,
        mav.MAVLINK_MSG_ID_SCALED_PRESSURE3,
        mav.MAVLINK_MSG_ID_TERRAIN_REQUEST,
        mav.MAVLINK_MSG_ID_WIND,
        mav.MAVLINK_MSG_ID_WINCH_STATUS,
    )
)
"""Messages that ArduCopter knows and accepts an interval for, though no device fills them."""


def build_table(fleet: Fleet, message_id: int, rows: Ints) -> MessageTable:
    """Build the messages of some aircraft."""
    table = np.zeros(len(rows), dtype=payload_dtype(message_id))
    BUILDERS[message_id](fleet, rows, table)
    return table


def build_message(fleet: Fleet, vehicle: Vehicle, message_id: int) -> Any | None:
    """Return one aircraft's message as an object; `None` where it has no contents."""
    rows = np.array([vehicle.row], dtype=np.int64)
    if message_id in AVAILABLE and not AVAILABLE[message_id](fleet, rows)[0]:
        return None
    values = build_table(fleet, message_id, rows)[0]
    layout = LAYOUTS[message_id]
    parts = (values[name] for name in layout.cls.fieldnames)
    return layout.cls(*(part.tolist() if isinstance(part, np.ndarray) else part.item() for part in parts))
