"""AUTO_RTL: AUTO is reported under this mode while it flies a landing sequence, and after its end.

After the end of ModeAuto::run (ArduCopter/mode_auto.cpp), which checks it in every pass of the loop.
"""

from __future__ import annotations

from skyrange.vehicle.builtin.fleet import Fleet, MissionState, Vehicle
from skyrange.vehicle.builtin.log_events import log_mode
from skyrange.vehicle.builtin.modes import Mode


def enter(fleet: Fleet, vehicle: Vehicle, reason: str) -> None:
    """Start to report AUTO as AUTO_RTL; `reason` is ArduCopter's ModeReason in lower case."""
    vehicle.mode_reason = reason
    fleet.set_auto_rtl(vehicle, shown=True)
    _note_mode(fleet, vehicle)


def update(fleet: Fleet, vehicle: Vehicle) -> None:
    """Report AUTO again once the mission has left its landing sequence."""
    if vehicle.auto_rtl and not vehicle.in_landing_sequence and vehicle.mission_state != MissionState.COMPLETE:
        vehicle.mode_reason = "auto_rtl_exit"
        fleet.set_auto_rtl(vehicle, shown=False)
        _note_mode(fleet, vehicle)


def _note_mode(fleet: Fleet, vehicle: Vehicle) -> None:
    mode = Mode(vehicle.reported_mode)
    log_mode(fleet, vehicle)
    fleet.note(
        "event.mode",
        vehicle,
        {"mode": mode.name, "number": int(mode), "reason": str(vehicle.mode_reason)},
        vehicle.mode_causes,
    )
