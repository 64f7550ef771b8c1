"""Landing sequence of a mission: the nearest DO_LAND_START, and the jump to it.

After libraries/AP_Mission/AP_Mission.cpp (`get_landing_sequence_start`, `jump_to_landing_sequence`,
`jump_to_closest_mission_leg` for missions without DO_RETURN_PATH_START).
"""

from __future__ import annotations

import math

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin.fleet import Causes, Fleet, MissionItem, MissionState, Vehicle
from skyrange.vehicle.builtin.guidance import wpnav
from skyrange.vehicle.builtin.locations import location
from skyrange.vehicle.builtin.mission import execution
from skyrange.vehicle.builtin.mission.command_ids import DO_LAND_START
from skyrange.vehicle.builtin.mission.sequence import next_nav_command
from skyrange.vehicle.builtin.modes import Mode


def nearest_start(fleet: Fleet, vehicle: Vehicle) -> int | None:
    """Return the DO_LAND_START nearest to the point of rest of the aircraft, in three dimensions; `None` without one.

    One without a place is at the navigation command behind it.
    """
    here = wpnav.stopping_point_of(fleet.estimate, fleet.flight, fleet.settings, vehicle.row)
    found, least = None, math.inf
    for seq, item in enumerate(vehicle.mission):
        if seq == 0 or item.command != DO_LAND_START:
            continue
        placed: MissionItem | None = item
        if item.x == 0 and item.y == 0 and item.z == 0.0:
            behind = next_nav_command(vehicle, seq)
            placed = None if behind is None else vehicle.mission[behind]
        if placed is None:
            continue
        place = location.to_enu(fleet, vehicle, placed.frame, placed.x, placed.y, placed.z)
        away = math.inf if place is None else math.dist(place, here)
        if found is None or away < least:
            found, least = seq, away
    return found


def jump_to_start(fleet: Fleet, vehicle: Vehicle, causes: Causes) -> bool:
    """Make the nearest DO_LAND_START current; `False` and a text where there is none."""
    seq = nearest_start(fleet, vehicle)
    if seq is None or not execution.set_current_cmd(fleet, vehicle, seq):
        fleet.send_text(vehicle, dialect.MAV_SEVERITY_WARNING, "Unable to start landing sequence", causes)
        return False
    if vehicle.mode == Mode.AUTO and vehicle.mission_state != MissionState.ACTIVE:  # the mission had ended
        vehicle.resume_mission = True
        execution.start_or_resume(fleet, vehicle)
    fleet.send_text(vehicle, dialect.MAV_SEVERITY_INFO, "Landing sequence start", causes)
    return True


def jump_unless_active(fleet: Fleet, vehicle: Vehicle, causes: Causes) -> bool:
    """Make the nearest DO_LAND_START current, unless the mission already flies its landing sequence."""
    if vehicle.mission_state == MissionState.ACTIVE and vehicle.in_landing_sequence:
        fleet.send_text(vehicle, dialect.MAV_SEVERITY_INFO, "Landing sequence active", causes)
        return True
    return jump_to_start(fleet, vehicle, causes)
