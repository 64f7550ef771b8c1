"""Where does the ground station want a GUIDED aircraft? SET_POSITION_TARGET_LOCAL_NED and …_GLOBAL_INT.

After ArduCopter/GCS_MAVLink_Copter.cpp (`handle_message_set_position_target_…`) and mode_guided.cpp: positions,
velocities or both; anything that makes no sense stops the aircraft. Acceleration targets, yaw and yaw rate are not
taken. Velocities are held for GUID_TIMEOUT.
"""

from __future__ import annotations

import math
from typing import Any

from skyrange.codec.mavlink import dialect
from skyrange.core.time import from_seconds
from skyrange.vehicle.builtin import loop
from skyrange.vehicle.builtin.fleet import Causes, Craft, Fleet, Timer
from skyrange.vehicle.builtin.layout import Control
from skyrange.vehicle.builtin.modes import Mode

_POS_IGNORE, _VEL_IGNORE, _ACC_IGNORE, _FORCE = 0b111, 0b111000, 0b111000000, 0b1000000000
_LOCAL_FRAMES = frozenset(
    (
        dialect.MAV_FRAME_LOCAL_NED,
        dialect.MAV_FRAME_LOCAL_OFFSET_NED,
        dialect.MAV_FRAME_BODY_NED,
        dialect.MAV_FRAME_BODY_OFFSET_NED,
    )
)
_BODY_FRAMES = frozenset((dialect.MAV_FRAME_BODY_NED, dialect.MAV_FRAME_BODY_OFFSET_NED))
_RELATIVE = frozenset((dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT, dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT))
_ABSOLUTE = frozenset((dialect.MAV_FRAME_GLOBAL, dialect.MAV_FRAME_GLOBAL_INT))
_FAR_M = 1e6
"""Farther than any local frame means: such a target is taken as senseless."""
_FAST_MPS = 1e3

Vector = tuple[float, float, float]


def on_local(fleet: Fleet, craft: Craft, message: Any, partner: tuple[int, int], causes: Causes) -> None:
    """SET_POSITION_TARGET_LOCAL_NED: north, east, down of the origin, of the craft, or of its nose."""
    if craft.mode != Mode.GUIDED:
        return
    frame = message.coordinate_frame
    if frame not in _LOCAL_FRAMES:
        _act(fleet, craft, None, None, causes)
        return
    position = velocity = None
    if message.type_mask & _POS_IGNORE == 0:
        position = _enu(fleet, craft, frame, message.x, message.y, message.z)
        if position and frame != dialect.MAV_FRAME_LOCAL_NED:
            here = fleet.position(craft)
            position = (position[0] + here[0], position[1] + here[1], position[2] + here[2])
    if message.type_mask & _VEL_IGNORE == 0:
        velocity = _enu(fleet, craft, frame, message.vx, message.vy, message.vz)
    _act(fleet, craft, position, velocity, causes, message.type_mask)


def on_global(fleet: Fleet, craft: Craft, message: Any, partner: tuple[int, int], causes: Causes) -> None:
    """SET_POSITION_TARGET_GLOBAL_INT: latitude, longitude, and altitude above the sea or above home."""
    if craft.mode != Mode.GUIDED:
        return
    position = velocity = None
    if message.type_mask & _POS_IGNORE == 0:
        frame = message.coordinate_frame
        lat, lon = message.lat_int * 1e-7, message.lon_int * 1e-7
        if -90.0 <= lat <= 90.0 and -180.0 <= lon <= 180.0 and frame in _RELATIVE | _ABSOLUTE:
            east, north = fleet.origin.enu_of(lat, lon)
            datum = craft.home[2] if frame in _RELATIVE else -fleet.origin.alt_msl_m
            position = (east, north, message.alt + datum)
    if message.type_mask & _VEL_IGNORE == 0:
        velocity = (message.vy, message.vx, -message.vz)
    _act(fleet, craft, position, velocity, causes, message.type_mask)


def _enu(fleet: Fleet, craft: Craft, frame: int, x: float, y: float, z: float) -> Vector:
    """A vector of the message as east, north, up."""
    if frame not in _BODY_FRAMES:
        return y, x, -z
    yaw = float(fleet.estimate["yaw"][craft.row])
    return x * math.cos(yaw) + y * math.sin(yaw), x * math.sin(yaw) - y * math.cos(yaw), -z


def _sane(vector: Vector | None, most: float) -> bool:
    return vector is not None and all(abs(part) <= most for part in vector)


def _act(
    fleet: Fleet, craft: Craft, position: Vector | None, velocity: Vector | None, causes: Causes, mask: int = 0
) -> None:
    """Fly to the position, with or at the velocity; stop where the mask's choice is not met by sane numbers."""
    if not fleet.armed(craft) or fleet.landed(craft):
        return
    wants_position, wants_velocity = mask & _POS_IGNORE == 0, mask & _VEL_IGNORE == 0
    sane = not (mask & _FORCE and mask & _ACC_IGNORE == 0)
    sane = sane and (not wants_position or _sane(position, _FAR_M))
    sane = sane and (not wants_velocity or _sane(velocity, _FAST_MPS))
    craft.target_causes = causes
    fleet.timer(craft, Timer.STALE)
    if not sane or not (wants_position or wants_velocity):
        fleet.fly(craft, Control.VELOCITY)
        return
    if velocity is not None:
        fleet.timer(craft, Timer.STALE, fleet.now + from_seconds(fleet.param(craft, "GUID_TIMEOUT")))
    if position is None:
        fleet.fly(craft, Control.VELOCITY, velocity or (0.0, 0.0, 0.0))
        return
    fleet.fly(craft, Control.POSITION, velocity or (0.0, 0.0, 0.0))
    fleet.flight["target_pos"][craft.row] = position
    loop.face_target(fleet.flight, fleet.settings, craft.row)


def stale(fleet: Fleet, craft: Craft) -> None:
    """No new velocity came in time: stop (mode_guided.cpp, `get_timeout_ms`)."""
    if craft.mode == Mode.GUIDED and fleet.control(craft) in (Control.VELOCITY, Control.POSITION):
        fleet.flight["target_vel"][craft.row] = 0.0
