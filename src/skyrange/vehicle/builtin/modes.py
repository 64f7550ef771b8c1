"""Which flight modes are there? ArduCopter's numbers and names (ArduCopter/mode.h), and what holds of each."""

from __future__ import annotations

from enum import IntEnum
from typing import Final

from skyrange.vehicle.builtin.layout import Control


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
    """No mode of its own: AUTO, while it flies a landing sequence that was asked for."""


PILOTED: Final = {
    int(Mode.STABILIZE): Control.STABILIZE,
    int(Mode.ALT_HOLD): Control.ALT_HOLD,
    int(Mode.LOITER): Control.LOITER,
}
"""Modes that a pilot's sticks fly, and how."""


def known(number: int) -> Mode | None:
    """The mode of that number, `None` where the autopilot has no such mode."""
    return Mode(number) if number in Mode._value2member_map_ else None


def armable(mode: int, auto_options: int) -> bool:
    """Whether the ground station may arm in a mode; in AUTO where bit 0 of AUTO_OPTIONS is set.

    After `allows_arming` of each mode (mode.h, mode_auto.cpp).
    """
    return mode in PILOTED or mode == Mode.GUIDED or (mode == Mode.AUTO and bool(auto_options & 1))
