"""Reports of status: mode, health, estimator, battery, fence and mission.

After libraries/GCS_MAVLink (GCS_Common.cpp, GCS.cpp `update_sensor_status_flags`, GCS_Fence.cpp),
ArduCopter/GCS_Copter.cpp and GCS_MAVLink_Copter.cpp.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import dialect
from skyrange.codec.mavlink.message_columns import MessageTable
from skyrange.contracts.frames import Ints
from skyrange.core.compiled import compiled
from skyrange.core.time import NS_PER_MS
from skyrange.vehicle.builtin.fleet import Fleet, MissionState
from skyrange.vehicle.builtin.layout import ControlMode, FlightEvent
from skyrange.vehicle.builtin.modes import Mode
from skyrange.vehicle.builtin.parameters.table import INDEX
from skyrange.vehicle.builtin.telemetry import columns
from skyrange.vehicle.builtin.telemetry.columns import (
    I16,
    I32,
    U16,
    Floats,
    clip_to_field,
    gather_from_vehicles,
    to_whole,
)

FIRMWARE: Final = 4 << 24 | 6 << 16 | 0 << 8 | 0
"""AUTOPILOT_VERSION.flight_sw_version: ArduCopter 4.6.0-dev, whose names and behaviour this follows."""
_LAST_WITHOUT_POSITION: Final = 2
"""STABILIZE 0, ACRO 1 and ALT_HOLD 2 hold no horizontal position; all other modes here do."""
_LAST_MANUAL_THROTTLE: Final = 1
"""STABILIZE and ACRO hold no height either."""
_AUTO: Final = int(Mode.AUTO)
_BOARD_MV: Final = 5000
_MCU_MV, _MCU_CDEG = 3300, 4500
_MEMORY: Final = 131_072
"""Free bytes, as reported by ArduPilot's simulation."""
_MAX_FIX_AGE_S: Final = 1.5
"""A receiver without data for longer is unhealthy (AP_GPS::is_healthy: 1.5 s beyond its own interval)."""

_ALWAYS_PRESENT: Final = (
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
_XY_CONTROL: Final = dialect.MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL
_Z_CONTROL: Final = dialect.MAV_SYS_STATUS_SENSOR_Z_ALTITUDE_CONTROL
_BATTERY: Final = dialect.MAV_SYS_STATUS_SENSOR_BATTERY
_FENCE: Final = dialect.MAV_SYS_STATUS_GEOFENCE
_PREARM: Final = dialect.MAV_SYS_STATUS_PREARM_CHECK
_BASE: Final = (
    dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    | dialect.MAV_MODE_FLAG_STABILIZE_ENABLED
    | dialect.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
)
_GUIDED: Final = dialect.MAV_MODE_FLAG_GUIDED_ENABLED
_ARMED: Final = dialect.MAV_MODE_FLAG_SAFETY_ARMED
_QUADROTOR: Final = dialect.MAV_TYPE_QUADROTOR
_ARDUPILOT: Final = dialect.MAV_AUTOPILOT_ARDUPILOTMEGA
_CRITICAL: Final = dialect.MAV_STATE_CRITICAL
_STANDBY: Final = dialect.MAV_STATE_STANDBY
_ACTIVE: Final = dialect.MAV_STATE_ACTIVE
_FIX_3D: Final = dialect.GPS_FIX_TYPE_3D_FIX
_UNINITIALIZED: Final = dialect.EKF_UNINITIALIZED
_ARMING_CHECK: Final = INDEX["ARMING_CHECK"]
_FENCE_TYPE: Final = INDEX["FENCE_TYPE"]
_FENCE_ACTION: Final = INDEX["FENCE_ACTION"]
_NO_POLYGON: Final = 1 | 2 | 8
"""Bits of FENCE_TYPE: these fences are present without an upload (AC_Fence::present)."""
_BATT_MONITOR: Final = INDEX["BATT_MONITOR"]
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


def heartbeat(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """HEARTBEAT, base mode as in GCS_MAVLINK_Copter::base_mode: manual input always, guided with a position."""
    _fill_heartbeat(rows, fleet.modes, fleet.flight, fleet.checks, fleet.battery, out)


@compiled
def _fill_heartbeat(rows: Ints, modes: Ints, flight: Any, watch: Any, power: Any, out: Any) -> None:
    for place in range(rows.shape[0]):
        row = rows[place]
        f: Any = flight[row]
        w: Any = watch[row]
        o: Any = out[place]
        o.custom_mode = modes[row]
        o.type = _QUADROTOR
        o.autopilot = _ARDUPILOT
        o.base_mode = _BASE | (_GUIDED if modes[row] > _LAST_WITHOUT_POSITION else 0) | (_ARMED if f.armed != 0 else 0)
        if w.gcs_lost != 0 or w.ekf_failsafe != 0 or w.dr_failsafe != 0 or power[row].failsafe_triggered != 0:
            o.system_status = _CRITICAL
        else:
            o.system_status = _STANDBY if f.landed == 1 else _ACTIVE
        o.mavlink_version = 3


def sys_status(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """SYS_STATUS: which devices are present, enabled and healthy, and the battery."""
    _fill_sys_status(
        rows,
        fleet.modes,
        fleet.stored_params,
        fleet.estimate,
        fleet.flight,
        fleet.checks,
        fleet.battery,
        fleet.fence,
        out,
    )


@compiled
def current_ca(current_a: float) -> int:
    """Return a current in hundredths of an ampere, in compiled code; -1, which would mean unknown, becomes 0."""
    found = to_whole(current_a * 100.0, -I16, I16)
    return 0 if found == -1 else found


@compiled
def _fill_sys_status(  # noqa: PLR0917
    rows: Ints, modes: Ints, stored: Floats,
    estimate: Any, flight: Any, watch: Any, power: Any, boundary: Any, out: Any,
) -> None:  # fmt: skip
    for place in range(rows.shape[0]):
        row = rows[place]
        e: Any = estimate[row]
        b: Any = power[row]
        fence: Any = boundary[row]
        o: Any = out[place]
        has_battery = stored[row, _BATT_MONITOR] != 0.0
        checked = stored[row, _ARMING_CHECK] != 0.0
        received = e.gnss_fix >= _FIX_3D and e.gnss_age_s < _MAX_FIX_AGE_S
        fitting = not (e.vel_ratio > 1.0 and e.pos_ratio > 1.0 and e.hgt_ratio > 1.0)
        fenced = fence.enabled != 0
        ready = flight[row].armed == 1 or watch[row].prearm_ok != 0
        present = _ALWAYS_PRESENT | _AHRS | _XY_CONTROL | _Z_CONTROL | _BATTERY | _PREARM
        if e.gnss_fix > 0:
            present |= _GNSS
        has_fence = fenced or int(stored[row, _FENCE_TYPE]) & _NO_POLYGON != 0
        if has_fence:
            present |= _FENCE
        enabled = present & ~(_XY_CONTROL | _Z_CONTROL | _BATTERY | _FENCE | _PREARM)
        if fenced and stored[row, _FENCE_ACTION] != 0.0:
            enabled |= _FENCE
        if modes[row] > _LAST_WITHOUT_POSITION:
            enabled |= _XY_CONTROL
        if modes[row] > _LAST_MANUAL_THROTTLE:
            enabled |= _Z_CONTROL
        if has_battery:
            enabled |= _BATTERY
        if checked:
            enabled |= _PREARM
        healthy = enabled & ~(_GNSS | _AHRS | _BATTERY | _FENCE | _PREARM)
        if received:
            healthy |= _GNSS
        if fitting and e.status & _UNINITIALIZED == 0:
            healthy |= _AHRS
        if has_battery and b.voltage > 0.0 and b.failsafe_triggered == 0:
            healthy |= _BATTERY
        if not has_fence or fence.breached == 0:  # "not failed if not present" (AC_Fence::sys_status_failed)
            healthy |= _FENCE
        if checked and ready:
            healthy |= _PREARM
        o.onboard_control_sensors_present = present
        o.onboard_control_sensors_enabled = enabled
        o.onboard_control_sensors_health = healthy
        o.load = 250  # ‰: the main loop of a flight controller is a quarter busy
        o.voltage_battery = to_whole(b.voltage * 1e3, 0, U16 - 1) if has_battery else 0  # 65535 would mean unknown
        o.current_battery = current_ca(b.current) if has_battery else -1
        o.battery_remaining = min(b.remaining_pct, 100) if has_battery else -1


def has_battery_monitor(fleet: Fleet, rows: Ints) -> NDArray[np.bool_]:
    """Whether a battery monitor is configured (BATT_MONITOR)."""
    fitted: NDArray[np.bool_] = fleet.stored_params[rows, INDEX["BATT_MONITOR"]] != 0
    return fitted


def battery_status(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """BATTERY_STATUS: the pack's voltage is in the first cell, as from a monitor without cell voltages."""
    power = fleet.battery
    volts = clip_to_field(power["voltage"][rows] * 1e3, U16 - 1, 0)
    out["voltages"] = U16
    out["voltages"][:, 0] = np.where(volts > 0, volts, U16)
    out["temperature"] = I16
    current = np.trunc(clip_to_field(power["current"][rows] * 100.0, I16))
    out["current_battery"] = np.where(current == -1.0, 0.0, current)
    out["current_consumed"] = clip_to_field(power["consumed_mah"][rows], I32, 0)
    out["energy_consumed"] = clip_to_field(power["consumed_wh"][rows] * 36.0, I32, 0)
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


def power_status(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """POWER_STATUS: the board's supply, always nominal."""
    out["Vcc"] = _BOARD_MV


def mcu_status(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """MCU_STATUS: the processor, with constant temperature and supply."""
    out["MCU_temperature"] = _MCU_CDEG
    for name in ("MCU_voltage", "MCU_voltage_min", "MCU_voltage_max"):
        out[name] = _MCU_MV


def hwstatus(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """HWSTATUS: the board's supply in a deprecated message."""
    out["Vcc"] = _BOARD_MV


def meminfo(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """MEMINFO."""
    out["freemem"] = min(_MEMORY, U16)
    out["freemem32"] = _MEMORY


def system_time(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """SYSTEM_TIME: UTC by the autopilot's clock."""
    out["time_unix_usec"] = fleet.clocks.utc_us(rows, fleet.now)
    out["time_boot_ms"] = columns.boot_ms(fleet, rows)


def ekf_status_report(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """EKF_STATUS_REPORT."""
    e = fleet.estimate
    out["flags"] = e["status"][rows]
    out["velocity_variance"] = e["vel_ratio"][rows]
    out["pos_horiz_variance"] = e["pos_ratio"][rows]
    out["pos_vert_variance"] = e["hgt_ratio"][rows]
    out["compass_variance"] = e["mag_ratio"][rows]


def vibration(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """VIBRATION: not modelled, zero."""
    out["time_usec"] = columns.boot_us(fleet, rows)


def fence_status(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """FENCE_STATUS: of several types breached, the boundary has priority (`send_fence_status`)."""
    fence = fleet.fence
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
    fenced: NDArray[np.bool_] = fleet.fence["enabled"][rows] != 0
    return fenced


def extended_sys_state(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """EXTENDED_SYS_STATE."""
    control = fleet.flight["control"][rows]
    climbed = (control == ControlMode.TAKEOFF) & (
        fleet.flight["flags"][rows] & FlightEvent.TAKEOFF_COMPLETE != 0
    )  # is_taking_off
    state = np.where(climbed, dialect.MAV_LANDED_STATE_IN_AIR, _LANDED_STATE[control])
    out["landed_state"] = np.where(fleet.flight["landed"][rows] == 1, dialect.MAV_LANDED_STATE_ON_GROUND, state)


_LANDED_STATE: Final = np.array(
    [
        {
            ControlMode.LAND: dialect.MAV_LANDED_STATE_LANDING,
            ControlMode.TAKEOFF: dialect.MAV_LANDED_STATE_TAKEOFF,
        }.get(control, dialect.MAV_LANDED_STATE_IN_AIR)
        for control in ControlMode
    ]
)
"""By `ControlMode`, in flight."""


def autopilot_version(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """AUTOPILOT_VERSION."""
    out["capabilities"] = _CAPABILITIES
    out["flight_sw_version"] = FIRMWARE
    out["flight_custom_version"] = np.frombuffer(b"skyrange", dtype=np.uint8)
    out["uid"] = fleet.system_ids[rows]


def mission_current(fleet: Fleet, rows: Ints, out: MessageTable) -> None:
    """MISSION_CURRENT; the total excludes home."""
    progress = gather_from_vehicles(fleet, rows, _mission_progress).reshape(len(rows), 4)
    out["seq"], out["total"] = progress[:, 0], progress[:, 1]
    out["mission_state"] = progress[:, 2]
    out["mission_mode"] = progress[:, 3] == _AUTO


def _mission_progress(vehicle: Any) -> tuple[int, int, int, int]:
    state = vehicle.mission_state if vehicle.has_mission else MissionState.NONE
    if vehicle.has_mission and state == MissionState.NONE:
        state = MissionState.NOT_STARTED
    if vehicle.paused and vehicle.mode == Mode.AUTO:  # GCS_MAVLINK_Copter::mission_state
        state = MissionState.PAUSED
    return vehicle.current, max(len(vehicle.mission) - 1, 0), state, vehicle.mode
