"""How is the aircraft? The reports of mode, health, estimator, battery, fence and mission.

After libraries/GCS_MAVLink (GCS_Common.cpp, GCS.cpp `update_sensor_status_flags`, GCS_Fence.cpp),
ArduCopter/GCS_Copter.cpp and GCS_MAVLink_Copter.cpp.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.agent.payloads import Ints
from skyrange.codec.columns import Table
from skyrange.codec.mavlink import dialect
from skyrange.core.time import NS_PER_MS
from skyrange.vehicle.builtin.fleet import Fleet, MissionState
from skyrange.vehicle.builtin.layout import Control
from skyrange.vehicle.builtin.modes import Mode
from skyrange.vehicle.builtin.parameters import INDEX
from skyrange.vehicle.builtin.telemetry import columns
from skyrange.vehicle.builtin.telemetry.columns import I16, I32, U16, held, of_crafts

FIRMWARE: Final = 4 << 24 | 6 << 16 | 0 << 8 | 0
"""AUTOPILOT_VERSION.flight_sw_version: ArduCopter 4.6.0-dev, whose names and behaviour this follows."""
_LAST_MANUAL: Final = 2
"""STABILIZE 0, ACRO 1 and ALT_HOLD 2 do not hold a horizontal position; of the modes here all others do."""
_LAST_BY_HAND: Final = 1
"""STABILIZE and ACRO do not hold a height either."""
_AUTO: Final = int(Mode.AUTO)
_BOARD_MV: Final = 5000
_MCU_MV, _MCU_CDEG = 3300, 4500
_MEMORY: Final = 131_072
"""Bytes free, as ArduPilot's simulation says."""
_FRESH_S: Final = 1.5
"""A receiver that has said nothing for longer is unhealthy (AP_GPS::is_healthy: 1.5 s beyond its own interval)."""

_ALWAYS: Final = (
    dialect.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | dialect.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | dialect.MAV_SYS_STATUS_SENSOR_3D_MAG
    | dialect.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | dialect.MAV_SYS_STATUS_SENSOR_LASER_POSITION
    | dialect.MAV_SYS_STATUS_SENSOR_ANGULAR_RATE_CONTROL
    | dialect.MAV_SYS_STATUS_SENSOR_ATTITUDE_STABILIZATION
    | dialect.MAV_SYS_STATUS_SENSOR_YAW_POSITION
    | dialect.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
    | dialect.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
    | dialect.MAV_SYS_STATUS_TERRAIN
    | dialect.MAV_SYS_STATUS_SENSOR_PROPULSION
)
_GNSS: Final = dialect.MAV_SYS_STATUS_SENSOR_GPS
_AHRS: Final = dialect.MAV_SYS_STATUS_AHRS
_PLACE: Final = dialect.MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL
_HEIGHT: Final = dialect.MAV_SYS_STATUS_SENSOR_Z_ALTITUDE_CONTROL
_BATTERY: Final = dialect.MAV_SYS_STATUS_SENSOR_BATTERY
_FENCE: Final = dialect.MAV_SYS_STATUS_GEOFENCE
_PREARM: Final = dialect.MAV_SYS_STATUS_PREARM_CHECK
_CAPABILITIES: Final = (
    dialect.MAV_PROTOCOL_CAPABILITY_MISSION_FLOAT
    | dialect.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    | dialect.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | dialect.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | dialect.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | dialect.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
    | dialect.MAV_PROTOCOL_CAPABILITY_TERRAIN
    | dialect.MAV_PROTOCOL_CAPABILITY_FLIGHT_TERMINATION
    | dialect.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    | dialect.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
    | dialect.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
)


def heartbeat(fleet: Fleet, rows: Ints, out: Table) -> None:
    """HEARTBEAT, base mode as GCS_MAVLINK_Copter::base_mode makes it: manual input always, guided with a position."""
    modes = fleet.modes[rows]
    base = (
        dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        | dialect.MAV_MODE_FLAG_STABILIZE_ENABLED
        | dialect.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
    )
    guided = np.where(modes <= _LAST_MANUAL, 0, dialect.MAV_MODE_FLAG_GUIDED_ENABLED)
    armed = fleet.flight["armed"][rows] * dialect.MAV_MODE_FLAG_SAFETY_ARMED
    watch = fleet.watch
    failsafe = (
        (watch["station_lost"][rows] != 0)
        | (watch["ekf_lost"][rows] != 0)
        | (watch["reckoning_lost"][rows] != 0)
        | (fleet.power["tripped"][rows] != 0)
    )
    ground = fleet.flight["landed"][rows] == 1
    out["custom_mode"] = modes
    out["type"] = dialect.MAV_TYPE_QUADROTOR
    out["autopilot"] = dialect.MAV_AUTOPILOT_ARDUPILOTMEGA
    out["base_mode"] = base | guided | armed
    out["system_status"] = np.where(
        failsafe,
        dialect.MAV_STATE_CRITICAL,
        np.where(ground, dialect.MAV_STATE_STANDBY, dialect.MAV_STATE_ACTIVE),
    )
    out["mavlink_version"] = 3


def sys_status(fleet: Fleet, rows: Ints, out: Table) -> None:
    """SYS_STATUS: what is fitted, in use and well, and the battery."""
    e, power, fence = fleet.estimate, fleet.power, fleet.boundary
    modes = fleet.modes[rows]
    fix, has_battery = e["gnss_fix"][rows], has_battery_monitor(fleet, rows)
    received = (fix >= dialect.GPS_FIX_TYPE_3D_FIX) & (e["gnss_age_s"][rows] < _FRESH_S)
    fitting = ~((e["vel_ratio"][rows] > 1.0) & (e["pos_ratio"][rows] > 1.0) & (e["hgt_ratio"][rows] > 1.0))
    place, height = modes > _LAST_MANUAL, modes > _LAST_BY_HAND
    fenced = fence["enabled"][rows] != 0
    checked = fleet.stored[rows, INDEX["ARMING_CHECK"]] != 0
    ready = (fleet.flight["armed"][rows] == 1) | (fleet.watch["prearm_ok"][rows] != 0)
    present = _ALWAYS | _AHRS | _PLACE | _HEIGHT | _BATTERY | _PREARM | np.where(fix > 0, _GNSS, 0)
    present |= np.where(fenced, _FENCE, 0)
    enabled = (present & ~(_PLACE | _HEIGHT | _BATTERY | _PREARM)) | np.where(place, _PLACE, 0)
    enabled |= np.where(height, _HEIGHT, 0) | np.where(has_battery, _BATTERY, 0) | np.where(checked, _PREARM, 0)
    healthy = (enabled & ~(_GNSS | _AHRS | _BATTERY | _FENCE | _PREARM)) | np.where(received, _GNSS, 0)
    healthy |= np.where(fitting & (e["status"][rows] & dialect.EKF_UNINITIALIZED == 0), _AHRS, 0)
    charged = has_battery & (power["voltage"][rows] > 0.0) & (power["tripped"][rows] == 0)
    healthy |= np.where(charged, _BATTERY, 0) | np.where(fenced & (fence["breached"][rows] == 0), _FENCE, 0)
    healthy |= np.where(checked & ready, _PREARM, 0)
    out["onboard_control_sensors_present"] = present
    out["onboard_control_sensors_enabled"] = enabled
    out["onboard_control_sensors_health"] = healthy
    out["load"] = 250  # ‰: a flight controller's main loop is a quarter busy
    out["voltage_battery"] = np.where(has_battery, held(power["voltage"][rows] * 1e3, U16, 0), 0)
    out["current_battery"] = np.where(has_battery, held(power["current"][rows] * 100.0, I16), -1)
    out["battery_remaining"] = np.where(has_battery, np.minimum(power["remaining_pct"][rows], 100), -1)


def has_battery_monitor(fleet: Fleet, rows: Ints) -> NDArray[np.bool_]:
    """Whether a battery monitor is set up (BATT_MONITOR)."""
    fitted: NDArray[np.bool_] = fleet.stored[rows, INDEX["BATT_MONITOR"]] != 0
    return fitted


def battery_status(fleet: Fleet, rows: Ints, out: Table) -> None:
    """BATTERY_STATUS: the pack's voltage stands in the first cell, as of a monitor that sees no cells."""
    power = fleet.power
    volts = held(power["voltage"][rows] * 1e3, U16 - 1, 0)
    out["voltages"] = U16
    out["voltages"][:, 0] = np.where(volts > 0, volts, U16)
    out["temperature"] = I16
    out["current_battery"] = held(power["current"][rows] * 100.0, I16)
    out["current_consumed"] = held(power["consumed_mah"][rows], I32)
    out["energy_consumed"] = held(power["consumed_wh"][rows] * 36.0, I32)
    out["battery_remaining"] = np.minimum(power["remaining_pct"][rows], 100)
    out["charge_state"] = _CHARGE[power["level"][rows]]


_CHARGE: Final = np.array(
    [
        dialect.MAV_BATTERY_CHARGE_STATE_OK,
        dialect.MAV_BATTERY_CHARGE_STATE_UNHEALTHY,
        dialect.MAV_BATTERY_CHARGE_STATE_LOW,
        dialect.MAV_BATTERY_CHARGE_STATE_CRITICAL,
    ]
)


def power_status(fleet: Fleet, rows: Ints, out: Table) -> None:
    """POWER_STATUS: the board's supply, always as it should be."""
    out["Vcc"] = _BOARD_MV


def mcu_status(fleet: Fleet, rows: Ints, out: Table) -> None:
    """MCU_STATUS: the processor, always as warm and as well supplied."""
    out["MCU_temperature"] = _MCU_CDEG
    for name in ("MCU_voltage", "MCU_voltage_min", "MCU_voltage_max"):
        out[name] = _MCU_MV


def hwstatus(fleet: Fleet, rows: Ints, out: Table) -> None:
    """HWSTATUS: the same in its older message."""
    out["Vcc"] = _BOARD_MV


def meminfo(fleet: Fleet, rows: Ints, out: Table) -> None:
    """MEMINFO."""
    out["freemem"] = min(_MEMORY, U16)
    out["freemem32"] = _MEMORY


def system_time(fleet: Fleet, rows: Ints, out: Table) -> None:
    """SYSTEM_TIME: the scenario's UTC."""
    out["time_unix_usec"] = fleet.epoch.utc_us(fleet.now)
    out["time_boot_ms"] = columns.boot_ms(fleet, rows)


def ekf_status_report(fleet: Fleet, rows: Ints, out: Table) -> None:
    """EKF_STATUS_REPORT."""
    e = fleet.estimate
    out["flags"] = e["status"][rows]
    out["velocity_variance"] = e["vel_ratio"][rows]
    out["pos_horiz_variance"] = e["pos_ratio"][rows]
    out["pos_vert_variance"] = e["hgt_ratio"][rows]
    out["compass_variance"] = e["mag_ratio"][rows]


def vibration(fleet: Fleet, rows: Ints, out: Table) -> None:
    """VIBRATION: none is modelled."""
    out["time_usec"] = columns.boot_us(fleet, rows)


def fence_status(fleet: Fleet, rows: Ints, out: Table) -> None:
    """FENCE_STATUS: of several kinds breached, the boundary counts most (`send_fence_status`)."""
    fence = fleet.boundary
    breached = fence["breached"][rows]
    out["breach_status"] = breached != 0
    out["breach_count"] = np.minimum(fence["count"][rows], U16)
    kind = np.where(breached & 8, dialect.FENCE_BREACH_MINALT, dialect.FENCE_BREACH_NONE)
    kind = np.where(breached & 1, dialect.FENCE_BREACH_MAXALT, kind)
    out["breach_type"] = np.where(breached & 6, dialect.FENCE_BREACH_BOUNDARY, kind)
    out["breach_mitigation"] = dialect.FENCE_MITIGATE_NONE
    since = np.maximum(fence["breach_ns"][rows] - fleet.boot_ns[rows], 0)
    out["breach_time"] = np.where(fence["breach_ns"][rows] > 0, since // NS_PER_MS & 0xFFFFFFFF, 0)


def has_fence(fleet: Fleet, rows: Ints) -> NDArray[np.bool_]:
    """Whether any fence is in force."""
    fenced: NDArray[np.bool_] = fleet.boundary["enabled"][rows] != 0
    return fenced


def extended_sys_state(fleet: Fleet, rows: Ints, out: Table) -> None:
    """EXTENDED_SYS_STATE."""
    control = fleet.flight["control"][rows]
    state = _LANDED_STATE[control]
    out["landed_state"] = np.where(fleet.flight["landed"][rows] == 1, dialect.MAV_LANDED_STATE_ON_GROUND, state)


_LANDED_STATE: Final = np.array(
    [
        {
            Control.LAND: dialect.MAV_LANDED_STATE_LANDING,
            Control.TAKEOFF: dialect.MAV_LANDED_STATE_TAKEOFF,
        }.get(control, dialect.MAV_LANDED_STATE_IN_AIR)
        for control in Control
    ]
)
"""By `Control`, in flight."""


def autopilot_version(fleet: Fleet, rows: Ints, out: Table) -> None:
    """AUTOPILOT_VERSION."""
    out["capabilities"] = _CAPABILITIES
    out["flight_sw_version"] = FIRMWARE
    out["flight_custom_version"] = np.frombuffer(b"skyrange", dtype=np.uint8)
    out["uid"] = fleet.systems[rows]


def mission_current(fleet: Fleet, rows: Ints, out: Table) -> None:
    """MISSION_CURRENT; the total leaves home out."""
    told = of_crafts(fleet, rows, _mission).reshape(len(rows), 4)
    out["seq"], out["total"] = told[:, 0], told[:, 1]
    out["mission_state"] = told[:, 2]
    out["mission_mode"] = told[:, 3] == _AUTO


def _mission(craft: Any) -> tuple[int, int, int, int]:
    state = craft.mission_state if craft.sees_mission else MissionState.NONE
    if craft.sees_mission and state == MissionState.NONE:
        state = MissionState.NOT_STARTED
    if craft.paused and craft.mode == Mode.AUTO:  # GCS_MAVLINK_Copter::mission_state
        state = MissionState.PAUSED
    return craft.current, max(len(craft.mission) - 1, 0), state, craft.mode
