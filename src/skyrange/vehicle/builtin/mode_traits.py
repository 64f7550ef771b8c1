"""Properties of flight modes: ArduCopter's `requires_GPS`, `has_manual_throttle`, `is_autopilot`, `is_landing`.

After ArduCopter/mode.h; by number, which includes modes that do not exist here.
"""

from __future__ import annotations

from typing import Final

from skyrange.vehicle.builtin.fleet import Craft, Fleet
from skyrange.vehicle.builtin.layout import Control
from skyrange.vehicle.builtin.modes import Mode

NEEDS_POSITION: Final = frozenset((3, 4, 5, 6, 7, 16, 17, 27))
"""AUTO, GUIDED, LOITER, RTL, CIRCLE, POSHOLD, BRAKE, AUTO_RTL: neither entered nor armed in without a position."""
MANUAL_THROTTLE: Final = frozenset((0, 1))
"""STABILIZE, ACRO."""
AUTOPILOT: Final = frozenset((3, 4, 6, 7, 9))
"""AUTO, GUIDED, RTL, CIRCLE, LAND: modes that fly without a pilot."""


def landing(fleet: Fleet, craft: Craft) -> bool:
    """Whether it descends to land: in LAND, or at the end of RTL or of a mission."""
    return craft.mode == Mode.LAND or (craft.mode in (Mode.RTL, Mode.AUTO) and fleet.control(craft) == Control.LAND)
