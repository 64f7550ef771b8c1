"""AUTO_RTL: AUTO is reported under this mode while it flies a landing sequence, and after its end.

After the end of ModeAuto::run (ArduCopter/mode_auto.cpp), which checks it in every pass of the loop.
"""

from __future__ import annotations

from skyrange.vehicle.builtin.fleet import Craft, Fleet, MissionState
from skyrange.vehicle.builtin.modes import Mode


def begin(fleet: Fleet, craft: Craft, reason: str) -> None:
    """Start to report AUTO as AUTO_RTL; `reason` is ArduCopter's ModeReason in lower case."""
    craft.mode_reason = reason
    fleet.show_auto_rtl(craft, True)
    _note_mode(fleet, craft)


def look(fleet: Fleet, craft: Craft) -> None:
    """Report AUTO again once the mission has left its landing sequence."""
    if craft.auto_rtl and not craft.in_landing and craft.mission_state != MissionState.COMPLETE:
        craft.mode_reason = "auto_rtl_exit"
        fleet.show_auto_rtl(craft, False)
        _note_mode(fleet, craft)


def _note_mode(fleet: Fleet, craft: Craft) -> None:
    mode = Mode(craft.shown_mode)
    fleet.note(
        "event.mode",
        craft,
        {"mode": mode.name, "number": int(mode), "reason": str(craft.mode_reason)},
        craft.mode_causes,
    )
