"""Landing sequence of a mission: the nearest DO_LAND_START, and the jump to it.

After libraries/AP_Mission/AP_Mission.cpp (`get_landing_sequence_start`, `jump_to_landing_sequence`,
`jump_to_closest_mission_leg` for missions without DO_RETURN_PATH_START).
"""

from __future__ import annotations

import math

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin import navigator, places, wpnav
from skyrange.vehicle.builtin.fleet import Causes, Craft, Fleet, MissionState, Slot
from skyrange.vehicle.builtin.mission_kinds import LAND_START
from skyrange.vehicle.builtin.modes import Mode
from skyrange.vehicle.builtin.sequence import next_navigation


def nearest(fleet: Fleet, craft: Craft) -> int | None:
    """Return the DO_LAND_START nearest to the point of rest of the aircraft, in three dimensions; `None` without one.

    One without a place is at the navigation command behind it.
    """
    here = wpnav.rest_at(fleet.estimate, fleet.flight, fleet.settings, craft.row)
    found, least = None, math.inf
    for seq, slot in enumerate(craft.mission):
        if seq == 0 or slot.command != LAND_START:
            continue
        placed: Slot | None = slot
        if slot.x == 0 and slot.y == 0 and slot.z == 0.0:
            behind = next_navigation(craft, seq)
            placed = None if behind is None else craft.mission[behind]
        if placed is None:
            continue
        place = places.enu(fleet, craft, placed.frame, placed.x, placed.y, placed.z)
        away = math.inf if place is None else math.dist(place, here)
        if found is None or away < least:
            found, least = seq, away
    return found


def jump(fleet: Fleet, craft: Craft, causes: Causes) -> bool:
    """Make the nearest DO_LAND_START current; `False` and a text where there is none."""
    seq = nearest(fleet, craft)
    if seq is None or not navigator.set_current(fleet, craft, seq):
        fleet.text(craft, dialect.MAV_SEVERITY_WARNING, "Unable to start landing sequence", causes)
        return False
    if craft.mode == Mode.AUTO and craft.mission_state != MissionState.ACTIVE:  # the mission had ended
        craft.resumes = True
        navigator.start_or_resume(fleet, craft)
    fleet.text(craft, dialect.MAV_SEVERITY_INFO, "Landing sequence start", causes)
    return True


def join(fleet: Fleet, craft: Craft, causes: Causes) -> bool:
    """Make the nearest DO_LAND_START current, unless the mission already flies its landing sequence."""
    if craft.mission_state == MissionState.ACTIVE and craft.in_landing:
        fleet.text(craft, dialect.MAV_SEVERITY_INFO, "Landing sequence active", causes)
        return True
    return jump(fleet, craft, causes)
