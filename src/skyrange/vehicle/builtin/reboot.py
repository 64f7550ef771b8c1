"""Reboot: an aircraft starts again with its stored parameters and mission, and nothing else.

After ArduPilot's storage (AP_Param, AP_Mission) and `Copter::init_ardupilot`. It takes no time here.
"""

from __future__ import annotations

from skyrange.vehicle.builtin import sticks_in
from skyrange.vehicle.builtin.arming import disarm
from skyrange.vehicle.builtin.failsafes import service
from skyrange.vehicle.builtin.fleet import Causes, Craft, Fleet, MissionState, Timer, Upload
from skyrange.vehicle.builtin.modes import Mode
from skyrange.vehicle.builtin.parameters import PARAMETERS, settle, stored
from skyrange.vehicle.builtin.telemetry.schedule import Schedule
from skyrange.vehicle.builtin.telemetry.streams import boot_rates


def reboot(fleet: Fleet, schedule: Schedule, craft: Craft, causes: Causes) -> None:
    """Restart: disarmed, in STABILIZE, under the stored system id, with telemetry at the rates of boot."""
    row = craft.row
    if fleet.armed(craft):
        disarm(fleet, craft, "reboot", causes)
    for index, value in craft.unsaved.items():
        fleet.stored[row, index] = value
    craft.unsaved.clear()
    if craft.erased:
        fleet.stored[row] = [stored(parameter, parameter.default) for parameter in PARAMETERS]
        craft.erased = False
    settle(fleet.settings, row, fleet.stored[row])
    craft.system_id = int(fleet.param(craft, "SYSID_THISMAV"))
    craft.packer.system = craft.system_id
    craft.packer.sequence = 0
    fleet.systems[row] = craft.system_id
    fleet.boot_ns[row] = fleet.now
    fleet.rebooted.append(craft.id)
    fleet.take_mode(craft, Mode.STABILIZE)
    craft.paused, craft.beneath, craft.resumes = False, (), False
    sticks_in.place(fleet, craft)
    craft.mode_causes = causes
    craft.uploads = [Upload() for _ in craft.uploads]
    craft.warned.clear()
    craft.mission_state = MissionState.NOT_STARTED if craft.sees_mission else MissionState.NONE
    craft.params_next = len(PARAMETERS)
    fleet.take_home(craft, fleet.position(craft))
    craft.home_locked = False
    for timer in Timer:
        fleet.timer(craft, timer)
    service.boot(fleet, craft)
    boot_rates(schedule, fleet, craft)
    fleet.note("event.reboot", craft, {"system_id": craft.system_id}, causes)
