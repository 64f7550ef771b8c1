"""Record layouts of the checks: battery state, fence state, and the state of failsafes and pre-arm checks.

One record per aircraft, like those of `layout`. Times are nanoseconds of simulated time, 0 for never. Telemetry reads
`BATTERY_STATE` and `FENCE_STATE`; `CHECK_STATE.prearm_ok` is SYS_STATUS's MAV_SYS_STATUS_PREARM_CHECK.
"""

from __future__ import annotations

from typing import Final

import numpy as np

NO_PRIORITY: Final = 127
"""`BATTERY_STATE.priority` before any battery failsafe: lower than every action (AP_BattMonitor's INT8_MAX)."""

BATTERY_STATE: Final = np.dtype(
    [
        ("voltage", "f8"),  # V
        ("current", "f8"),  # A
        ("resting_v", "f8"),  # V, estimated without the sag; never below the voltage
        ("consumed_mah", "f8"),
        ("consumed_wh", "f8"),
        ("remaining_pct", "i8"),  # of BATT_CAPACITY; -1 unknown
        ("level", "i8"),  # 0 none, 1 unhealthy, 2 low, 3 critical (AP_BattMonitor::Failsafe)
        ("pending_level", "i8"),  # the level found by the check; `level` follows when it is acted upon
        ("low_ns", "i8"),  # when the voltage became low
        ("critical_ns", "i8"),
        ("priority", "i8"),  # the highest priority of a failsafe action so far; smaller is higher
        ("failsafe_triggered", "i8"),  # 1 after a battery failsafe
        # estimate of the internal resistance
        ("resistance", "f8"),  # ohm
        ("current_max_a", "f8"),
        ("voltage_filt", "f8"),
        ("current_filt_a", "f8"),
        ("reference_v", "f8"),
        ("reference_a", "f8"),
    ]
)
"""After AP_BattMonitor.h `BattMonitor_State` and AP_BattMonitor_Backend.h."""

FENCE_STATE: Final = np.dtype(
    [
        ("enabled", "i8"),  # types in force: 1 maximum altitude, 2 circle around home, 4 polygons, 8 minimum altitude
        ("breached", "i8"),  # types breached now
        ("new_breaches", "i8"),  # types newly breached at this check
        ("auto_disabled", "i8"),  # types disabled at this check for landing
        ("alt_min_enabled", "i8"),  # 1: the minimum altitude was enabled at this check
        ("count", "i8"),  # number of breaches
        ("breach_ns", "i8"),
        ("status_sent_ns", "i8"),  # when FENCE_STATUS was last sent for a breach
        ("recovery_ns", "i8"),  # when a mode was last chosen during a breach (manual recovery)
        ("alt_min_state", "i8"),  # minimum altitude: 0 by parameters, 1 enabled manually, 2 disabled manually
        ("last_enable", "i8"),  # FENCE_ENABLE and FENCE_AUTOENABLE at the last check
        ("last_auto_enable", "i8"),
        # where a further breach is recorded; 0 none
        ("backup_max_m", "f8"),
        ("backup_min_m", "f8"),
        ("backup_circle_m", "f8"),
        # distance outside, negative inside
        ("alt_max_breach_m", "f8"),
        ("alt_min_breach_m", "f8"),
        ("circle_breach_m", "f8"),
        ("polygon_breach_m", "f8"),
    ]
)
"""After AC_Fence.h; fence types are bits of `fence.FenceType`."""

MAX_FENCE_ITEMS: Final = 70
"""Points of all zones together: (48 + 256 + 256) / 8 bytes (StorageManager.cpp StorageFence, 15 areas; `max_items`)."""

POLYGON_IN: Final = 1
POLYGON_OUT: Final = 2
CIRCLE_IN: Final = 3
CIRCLE_OUT: Final = 4

ZONES: Final = np.dtype(
    [
        ("count", "i8"),  # number of zones
        ("min_circle_radius", "f8"),  # m, radius of the smallest inclusion circle; 0 none
        ("kind", "i8", (MAX_FENCE_ITEMS,)),  # per zone: one of the constants above
        ("first", "i8", (MAX_FENCE_ITEMS,)),  # index of its first point
        ("size", "i8", (MAX_FENCE_ITEMS,)),  # number of its points
        ("radius", "f8", (MAX_FENCE_ITEMS,)),  # m, of circles
        ("point", "f8", (MAX_FENCE_ITEMS, 2)),  # east, north, m
    ]
)
"""Zones of a fence: its polygons and circles, local metres."""

CHECK_STATE: Final = np.dtype(
    [
        ("alarms", "i8"),  # Alarms of the last check
        ("home", "f8", (3,)),  # m
        ("located", "i8"),  # 1 after the first valid position: home is set
        # ground station
        ("gcs_heard_ns", "i8"),  # time of its last heartbeat
        ("gcs_lost", "i8"),
        # estimator
        ("ekf_count", "i8"),
        ("ekf_passed", "i8"),  # 1 after the first passed check
        ("ekf_bad", "i8"),
        ("ekf_failsafe", "i8"),  # 1: the failsafe is active
        ("ekf_reported", "i8"),  # 1: it was raised while armed, so its end is reported
        ("ekf_warned_ns", "i8"),
        ("vel_ratio_filt", "f8"),  # filtered ratios
        ("pos_ratio_filt", "f8"),
        ("glitching", "i8"),
        # dead reckoning
        ("dr_active", "i8"),
        ("dr_started_ns", "i8"),
        ("dr_timed_out", "i8"),  # 1: for longer than FS_DR_TIMEOUT
        ("dr_failsafe", "i8"),  # 1: the failsafe is active
        ("thrust_ns", "i8"),  # since when full thrust does not stop the descent
        # pre-arm checks
        ("prearm_ok", "i8"),
        ("prearm_urgent", "i8"),  # 1: report soon, they have just begun to fail
        ("prearm_reported_ns", "i8"),
        # Remote ID transmitter
        ("rid_ns", "i8"),  # time of its last OPEN_DRONE_ID_ARM_STATUS
        ("rid_status", "i8"),  # MAV_ODID_ARM_STATUS
        ("rid_id_type", "i8"),  # id type of the last OPEN_DRONE_ID_BASIC_ID; 0 none
        ("rid_operator", "i8"),  # 1: it has an operator location
        ("rid_system_ns", "i8"),  # time of its last OPEN_DRONE_ID_SYSTEM, or of a _SYSTEM_UPDATE after one
        ("armed_up_m", "f8"),  # height at the last arming
        ("crashed", "i8"),  # 1: disarmed for a crash and not armed again
    ]
)
