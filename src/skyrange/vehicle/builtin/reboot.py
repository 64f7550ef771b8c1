"""Reboot: an aircraft starts again with its stored parameters and mission, and nothing else.

After ArduPilot's storage (AP_Param, AP_Mission) and `Copter::init_ardupilot`. It takes no time here.
"""

from __future__ import annotations

from skyrange.vehicle.builtin.arming.arming import disarm
from skyrange.vehicle.builtin.failsafes import checks
from skyrange.vehicle.builtin.fleet import Causes, Fleet, MissionState, Slowdown, Timer, Upload, Vehicle
from skyrange.vehicle.builtin.log_events import end_log
from skyrange.vehicle.builtin.modes import Mode
from skyrange.vehicle.builtin.parameters.table import PARAMETERS, apply_stored, stored_value
from skyrange.vehicle.builtin.pilot import rc_channels
from skyrange.vehicle.builtin.telemetry.schedule import Schedule
from skyrange.vehicle.builtin.telemetry.streams import start_boot_streams


def reboot(fleet: Fleet, schedule: Schedule, vehicle: Vehicle, causes: Causes) -> None:
    """Restart: disarmed, in STABILIZE, under the stored system id, with telemetry at the rates of boot."""
    row = vehicle.row
    if fleet.armed(vehicle):
        disarm(fleet, vehicle, "reboot", causes)
    for index, value in vehicle.unsaved_params.items():
        fleet.stored_params[row, index] = value
    vehicle.unsaved_params.clear()
    if vehicle.params_erased:
        fleet.stored_params[row] = [stored_value(parameter, parameter.default) for parameter in PARAMETERS]
        vehicle.params_erased = False
    apply_stored(fleet.settings, row, fleet.stored_params[row])
    vehicle.system_id = int(fleet.param(vehicle, "SYSID_THISMAV"))
    vehicle.packer.system = vehicle.system_id
    vehicle.packer.sequence = 0
    fleet.system_ids[row] = vehicle.system_id
    fleet.boot_ns[row] = fleet.now
    fleet.clocks.restart(row, int(fleet.estimate["gnss_fix"][row]))
    fleet.rebooted.append(vehicle.id)
    fleet.assign_mode(vehicle, Mode.STABILIZE)
    vehicle.paused, vehicle.suspended_targets, vehicle.resume_mission = False, (), False
    rc_channels.update_sticks(fleet, vehicle)
    vehicle.mode_causes = causes
    vehicle.uploads = [Upload() for _ in vehicle.uploads]
    vehicle.legacy_warned.clear()
    vehicle.mission_state = MissionState.NOT_STARTED if vehicle.has_mission else MissionState.NONE
    vehicle.next_param = len(PARAMETERS)
    vehicle.slowdowns = Slowdown.NONE
    fleet.stream_factors.pop(row, None)
    vehicle.file_server = None
    end_log(vehicle)
    fleet.assign_home(vehicle, fleet.position(vehicle))
    vehicle.home_locked = False
    for timer in Timer:
        fleet.set_timer(vehicle, timer)
    checks.reset_state(fleet, vehicle)
    start_boot_streams(schedule, fleet, vehicle)
    fleet.note("event.reboot", vehicle, {"system_id": vehicle.system_id}, causes)
