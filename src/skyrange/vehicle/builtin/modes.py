"""Which flight modes are there? ArduCopter's numbers and names (ArduCopter/mode.h), and whether one arms in them.

STABILIZE is the mode at boot, as in ArduCopter, and only that: flying it takes a pilot's stick, and there is no
radio control here. So it is neither armed in nor entered when armed.
"""

from __future__ import annotations

from enum import IntEnum


class Mode(IntEnum):
    """HEARTBEAT.custom_mode."""

    STABILIZE = 0
    AUTO = 3
    GUIDED = 4
    RTL = 6
    LAND = 9
    BRAKE = 17


def known(number: int) -> Mode | None:
    """The mode of that number, `None` where the autopilot has no such mode."""
    return Mode(number) if number in Mode._value2member_map_ else None


def armable(mode: int, auto_options: int) -> bool:
    """Whether the ground station may arm in a mode: GUIDED, and AUTO where bit 0 of AUTO_OPTIONS is set.

    After `allows_arming` of each mode (mode.h, mode_auto.cpp).
    """
    return mode == Mode.GUIDED or (mode == Mode.AUTO and bool(auto_options & 1))
