"""What does the array side remember, to notice trouble? Record layouts: the battery, the fence, and the watch.

One record per aircraft, like those of `layout`. Moments are nanoseconds of simulated time, 0 where there was none yet.
Telemetry reads `POWER` and `BOUNDARY`; `WATCH.prearm_ok` is SYS_STATUS's MAV_SYS_STATUS_PREARM_CHECK.
"""

from __future__ import annotations

from typing import Final

import numpy as np

NO_PRIORITY: Final = 127
"""`POWER.priority` before any battery failsafe: below every action (AP_BattMonitor's INT8_MAX)."""

POWER: Final = np.dtype(
    [
        ("voltage", "f8"),  # V
        ("current", "f8"),  # A
        ("resting_v", "f8"),  # V, the sag taken out; never below the voltage
        ("consumed_mah", "f8"),
        ("consumed_wh", "f8"),
        ("remaining_pct", "i8"),  # of BATT_CAPACITY; -1 unknown
        ("level", "i8"),  # 0 none, 1 unhealthy, 2 low, 3 critical (AP_BattMonitor::Failsafe)
        ("noticed", "i8"),  # the level that the check has seen, which `level` follows when it is acted upon
        ("low_ns", "i8"),  # since when the voltage is low
        ("critical_ns", "i8"),
        ("priority", "i8"),  # the highest that a failsafe's action had; smaller is higher
        ("tripped", "i8"),  # 1 once a battery failsafe was raised
        # the estimate of the inner resistance
        ("resistance", "f8"),  # ohm
        ("most_a", "f8"),
        ("slow_v", "f8"),
        ("slow_a", "f8"),
        ("reference_v", "f8"),
        ("reference_a", "f8"),
    ]
)
"""After AP_BattMonitor.h `BattMonitor_State` and AP_BattMonitor_Backend.h."""

BOUNDARY: Final = np.dtype(
    [
        ("enabled", "i8"),  # kinds in force: 1 highest altitude, 2 circle around home, 4 polygons, 8 lowest altitude
        ("breached", "i8"),  # kinds breached now
        ("fresh", "i8"),  # kinds breached newly at this check
        ("closed", "i8"),  # kinds switched off at this check for landing
        ("opened", "i8"),  # 1: the lowest altitude was switched on at this check
        ("count", "i8"),  # breaches so far
        ("breach_ns", "i8"),
        ("told_ns", "i8"),  # when FENCE_STATUS was last sent for a breach
        ("recovery_ns", "i8"),  # when a mode was last chosen during a breach
        ("floor", "i8"),  # 0 as parameters say, 1 enabled by hand, 2 disabled by hand
        ("enable_was", "i8"),  # parameters at the last check
        ("auto_was", "i8"),
        # where a breach becomes a new one; 0 none
        ("backup_max_m", "f8"),
        ("backup_min_m", "f8"),
        ("backup_circle_m", "f8"),
        # how far outside, negative inside
        ("over_m", "f8"),
        ("under_m", "f8"),
        ("circle_m", "f8"),
        ("polygon_m", "f8"),
    ]
)
"""After AC_Fence.h."""

WATCH: Final = np.dtype(
    [
        ("alarms", "i8"),  # Alarms raised by the last check
        ("home", "f8", (3,)),  # m
        ("located", "i8"),  # 1 once there was a position: home is set
        # ground station
        ("station_ns", "i8"),  # its last heartbeat
        ("station_lost", "i8"),
        # estimator
        ("ekf_count", "i8"),
        ("ekf_passed", "i8"),  # its checks have ever passed
        ("ekf_bad", "i8"),
        ("ekf_lost", "i8"),  # the failsafe is on
        ("ekf_told", "i8"),  # ... and was raised while armed, so that its end is told
        ("ekf_warned_ns", "i8"),
        ("vel_slow", "f8"),  # filtered ratios
        ("pos_slow", "f8"),
        ("glitching", "i8"),
        # dead reckoning
        ("reckoning", "i8"),
        ("reckoning_ns", "i8"),
        ("reckoning_over", "i8"),  # for longer than FS_DR_TIMEOUT
        ("reckoning_lost", "i8"),  # the failsafe is on
        ("thrust_ns", "i8"),  # since when full thrust has not stopped a descent
        # pre-arm checks
        ("prearm_ok", "i8"),
        ("prearm_urgent", "i8"),  # tell soon: they have just begun to fail
        ("prearm_told_ns", "i8"),
        # Remote ID's transmitter
        ("rid_ns", "i8"),  # its last OPEN_DRONE_ID_ARM_STATUS; 0 never
        ("rid_status", "i8"),  # MAV_ODID_ARM_STATUS
        ("rid_id_type", "i8"),  # of the last OPEN_DRONE_ID_BASIC_ID; 0 none
        ("rid_operator", "i8"),  # 1: it was told where the operator is
        ("rid_system_ns", "i8"),  # its last OPEN_DRONE_ID_SYSTEM, or _SYSTEM_UPDATE after one; 0 never
        ("armed_up_m", "f8"),  # the height at which it was armed last
        ("crashed", "i8"),  # it was disarmed for a crash, and not armed again
    ]
)
