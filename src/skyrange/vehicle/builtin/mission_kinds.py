"""Which mission items are there? The MAV_CMDs that are flown, by what kind of item they are."""

from __future__ import annotations

from typing import Final

from skyrange.codec.mavlink import dialect

WAYPOINT: Final = dialect.MAV_CMD_NAV_WAYPOINT
SPLINE: Final = dialect.MAV_CMD_NAV_SPLINE_WAYPOINT
UNLIM: Final = dialect.MAV_CMD_NAV_LOITER_UNLIM
TURNS: Final = dialect.MAV_CMD_NAV_LOITER_TURNS
TIME: Final = dialect.MAV_CMD_NAV_LOITER_TIME
TO_ALT: Final = dialect.MAV_CMD_NAV_LOITER_TO_ALT
DELAY: Final = dialect.MAV_CMD_NAV_DELAY
RTL: Final = dialect.MAV_CMD_NAV_RETURN_TO_LAUNCH
LAND: Final = dialect.MAV_CMD_NAV_LAND
TAKEOFF: Final = dialect.MAV_CMD_NAV_TAKEOFF
NAVIGATION: Final = frozenset((WAYPOINT, SPLINE, UNLIM, TURNS, TIME, TO_ALT, DELAY, RTL, LAND, TAKEOFF))
"""Items that take time and are flown one after another."""

JUMP: Final = dialect.MAV_CMD_DO_JUMP
SPEED: Final = dialect.MAV_CMD_DO_CHANGE_SPEED
SET_HOME: Final = dialect.MAV_CMD_DO_SET_HOME
LAND_START: Final = dialect.MAV_CMD_DO_LAND_START
ROI: Final = dialect.MAV_CMD_DO_SET_ROI
ROI_LOCATION: Final = dialect.MAV_CMD_DO_SET_ROI_LOCATION
ROI_NONE: Final = dialect.MAV_CMD_DO_SET_ROI_NONE
WAIT: Final = dialect.MAV_CMD_CONDITION_DELAY
NEAR: Final = dialect.MAV_CMD_CONDITION_DISTANCE
YAW: Final = dialect.MAV_CMD_CONDITION_YAW
CONDITIONS: Final = frozenset((WAIT, NEAR, YAW))
"""Items that those behind them wait for."""

LOCATED: Final = frozenset(
    (WAYPOINT, SPLINE, UNLIM, TURNS, TIME, TO_ALT, LAND, TAKEOFF, SET_HOME, LAND_START, ROI, ROI_LOCATION, ROI_NONE)
)
"""Items that are stored with a place (AP_Mission::stored_in_location)."""
SUPPORTED: Final = LOCATED | CONDITIONS | {DELAY, RTL, JUMP, SPEED}
