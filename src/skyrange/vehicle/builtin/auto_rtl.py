"""Is AUTO still to be shown as AUTO_RTL? As long as it is in the landing sequence, and after its end.

After the end of ModeAuto::run (ArduCopter/mode_auto.cpp), where it is looked at in every turn of the loop.
"""

from __future__ import annotations

from skyrange.vehicle.builtin.fleet import Craft, Fleet, MissionState
from skyrange.vehicle.builtin.modes import Mode


def begin(fleet: Fleet, craft: Craft, reason: str) -> None:
    """AUTO flies a landing sequence from now on; `reason` is ArduCopter's."""
    craft.mode_reason = reason
    fleet.show_auto_rtl(craft, True)
    _note(fleet, craft)


def look(fleet: Fleet, craft: Craft) -> None:
    """The mission went on: is it still landing?"""
    if craft.auto_rtl and not craft.in_landing and craft.mission_state != MissionState.COMPLETE:
        craft.mode_reason = "auto_rtl_exit"
        fleet.show_auto_rtl(craft, False)
        _note(fleet, craft)


def _note(fleet: Fleet, craft: Craft) -> None:
    mode = Mode(craft.shown_mode)
    fleet.note(
        "event.mode",
        craft,
        {"mode": mode.name, "number": int(mode), "reason": str(craft.mode_reason)},
        craft.mode_causes,
    )
