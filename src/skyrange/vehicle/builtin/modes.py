"""Flight modes: ArduCopter's numbers and names (ArduCopter/mode.h) and their properties.

The properties are ArduCopter's `requires_GPS`, `has_manual_throttle` and `is_autopilot`; their sets of numbers include
modes that do not exist here.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin.layout import ControlMode

NAV_GUIDED_ENABLE: Final = dialect.MAV_CMD_NAV_GUIDED_ENABLE
NAV_SCRIPT_TIME: Final = dialect.MAV_CMD_NAV_SCRIPT_TIME
GUIDED_COMMANDS: Final = frozenset((NAV_GUIDED_ENABLE, NAV_SCRIPT_TIME))
"""Mission commands during which AUTO obeys the targets of GUIDED (ModeAuto::in_guided_mode)."""


class Mode(IntEnum):
    """HEARTBEAT.custom_mode."""

    STABILIZE = 0
    ALT_HOLD = 2
    AUTO = 3
    GUIDED = 4
    LOITER = 5
    RTL = 6
    LAND = 9
    BRAKE = 17
    AUTO_RTL = 27
    """Not a mode of its own: AUTO while it flies a requested landing sequence."""


PILOT_CONTROLS: Final = {
    int(Mode.STABILIZE): ControlMode.STABILIZE,
    int(Mode.ALT_HOLD): ControlMode.ALT_HOLD,
    int(Mode.LOITER): ControlMode.LOITER,
}
"""Modes flown with the pilot's sticks, and their control mode."""

REQUIRES_POSITION: Final = frozenset((3, 4, 5, 6, 7, 16, 17, 27))
"""AUTO, GUIDED, LOITER, RTL, CIRCLE, POSHOLD, BRAKE, AUTO_RTL: neither entered nor armed in without a position."""
MANUAL_THROTTLE: Final = frozenset((0, 1))
"""STABILIZE, ACRO."""
AUTOPILOT_MODES: Final = frozenset((3, 4, 6, 7, 9))
"""AUTO, GUIDED, RTL, CIRCLE, LAND: modes that fly without a pilot."""


def mode_of(number: int) -> Mode | None:
    """Return the mode of a number, `None` where the autopilot has no such mode."""
    return Mode(number) if number in Mode._value2member_map_ else None


def allows_arming(mode: int, auto_options: int) -> bool:
    """Whether a ground station may arm in a mode; in AUTO only with bit 0 of AUTO_OPTIONS.

    After `allows_arming` of each mode (mode.h, mode_auto.cpp).
    """
    return mode in PILOT_CONTROLS or mode == Mode.GUIDED or (mode == Mode.AUTO and bool(auto_options & 1))
