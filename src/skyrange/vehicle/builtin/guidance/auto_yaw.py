"""Yaw modes: how flight modes, mission items and messages set the yaw target (ArduCopter/autoyaw.cpp)."""

from __future__ import annotations

import math

from skyrange.vehicle.builtin.fleet import Fleet, Vehicle
from skyrange.vehicle.builtin.guidance import yaw_target
from skyrange.vehicle.builtin.layout import AutoYawMode

_RATE_MAX_RADPS = 20.0  # faster than any ATC_SLEW_YAW: keeps an absurd request finite
_YAW_REACHED_RAD = math.radians(2.0)

Vector = tuple[float, float, float]


def set_mode_to_default(fleet: Fleet, vehicle: Vehicle, *, returning: bool = False) -> None:
    """Set the mode that WP_YAW_BEHAVIOR selects (`set_mode_to_default`)."""
    set_mode(fleet, vehicle, _default_mode(fleet, vehicle, returning=returning))


def _default_mode(fleet: Fleet, vehicle: Vehicle, *, returning: bool) -> AutoYawMode:
    behaviour = int(fleet.param(vehicle, "WP_YAW_BEHAVIOR"))
    if behaviour == 0 or (behaviour == 2 and returning):
        return AutoYawMode.HOLD
    return AutoYawMode.LOOK_AHEAD if behaviour == 3 else AutoYawMode.LOOK_AT_NEXT_WP


def set_to_armed_yaw(fleet: Fleet, vehicle: Vehicle) -> None:
    """Above home, turn to the yaw at arming, unless WP_YAW_BEHAVIOR never turns (RTL's `loiterathome_start`)."""
    if _default_mode(fleet, vehicle, returning=True) == AutoYawMode.HOLD:
        set_mode(fleet, vehicle, AutoYawMode.HOLD)
        return
    row, flight = vehicle.row, fleet.flight
    flight["auto_yaw_mode"][row] = AutoYawMode.ANGLE_RATE
    flight["target_yaw"][row] = vehicle.armed_yaw
    flight["target_yaw_rate"][row] = 0.0


def reached_armed_yaw(fleet: Fleet, vehicle: Vehicle) -> bool:
    """Whether that turn is complete, to 2°, or none was requested (`loiterathome_run`)."""
    off = math.remainder(float(fleet.estimate["yaw"][vehicle.row]) - vehicle.armed_yaw, 2.0 * math.pi)
    return mode(fleet, vehicle) != AutoYawMode.ANGLE_RATE or abs(off) <= _YAW_REACHED_RAD


def set_mode(fleet: Fleet, vehicle: Vehicle, kind: AutoYawMode) -> None:
    """Set another yaw mode; its target starts from that of the last, or from the present yaw to look ahead."""
    row, flight = vehicle.row, fleet.flight
    if flight["auto_yaw_mode"][row] != kind:
        flight["auto_yaw_mode"][row] = kind
        flight["target_yaw_rate"][row] = 0.0
        if kind == AutoYawMode.LOOK_AHEAD:
            flight["target_yaw"][row] = fleet.estimate["yaw"][row]


def mode(fleet: Fleet, vehicle: Vehicle) -> int:
    """Return the present yaw mode."""
    return int(fleet.flight["auto_yaw_mode"][vehicle.row])


def keep_roi_or_default(fleet: Fleet, vehicle: Vehicle) -> None:
    """Set the default on the way to a waypoint; keep a ROI, and a fixed yaw where WP_YAW_BEHAVIOR is 0."""
    now = mode(fleet, vehicle)
    if now == AutoYawMode.ROI or (now == AutoYawMode.FIXED and fleet.param(vehicle, "WP_YAW_BEHAVIOR") == 0):
        return
    set_mode_to_default(fleet, vehicle)


def set_fixed_yaw(
    fleet: Fleet, vehicle: Vehicle, angle_deg: float, rate_degps: float, direction: int, *, relative: bool
) -> None:
    """Turn to a heading (clockwise from north), or by an angle if `relative`; `rate_degps` 0 is ATC_SLEW_YAW."""
    yaw_target.set_fixed_yaw_target(
        fleet.estimate, fleet.flight, fleet.settings, vehicle.row,
        math.radians(angle_deg), math.radians(rate_degps), direction, relative,
    )  # fmt: skip


def resume_fixed_yaw(fleet: Fleet, vehicle: Vehicle) -> None:
    """Continue a turn that another mode has interrupted for a pass, from the yaw that the mode has requested."""
    if mode(fleet, vehicle) in (AutoYawMode.HOLD, AutoYawMode.LOOK_AT_NEXT_WP):
        yaw_target.request_track_yaw(fleet.flight, vehicle.row)
    set_mode(fleet, vehicle, AutoYawMode.FIXED)


def reached_fixed_yaw_target(fleet: Fleet, vehicle: Vehicle) -> bool:
    """Whether that turn is complete."""
    return bool(yaw_target.reached_fixed_yaw_target(fleet.estimate, fleet.flight, vehicle.row))


def set_yaw_angle_and_rate(fleet: Fleet, vehicle: Vehicle, yaw_rad: float, rate_radps: float) -> None:
    """Point to a yaw (clockwise from north) that goes on turning at a rate."""
    row, flight = vehicle.row, fleet.flight
    flight["auto_yaw_mode"][row] = AutoYawMode.ANGLE_RATE
    flight["target_yaw"][row] = math.remainder(0.5 * math.pi - yaw_rad, 2.0 * math.pi)
    flight["target_yaw_rate"][row] = -min(max(rate_radps, -_RATE_MAX_RADPS), _RATE_MAX_RADPS)


def set_rate(fleet: Fleet, vehicle: Vehicle, rate_radps: float) -> None:
    """Turn at a rate, clockwise."""
    row, flight = vehicle.row, fleet.flight
    flight["auto_yaw_mode"][row] = AutoYawMode.RATE
    most = math.radians(fleet.param(vehicle, "ATC_SLEW_YAW") * 0.01)
    flight["target_yaw_rate"][row] = -min(max(rate_radps, -most), most)


def set_roi(fleet: Fleet, vehicle: Vehicle, place: Vector | None) -> None:
    """Keep the nose towards a place, ENU metres; `None` ends that (`set_roi`)."""
    if place is None:
        set_mode_to_default(fleet, vehicle)
        return
    fleet.flight["roi"][vehicle.row] = place
    fleet.flight["auto_yaw_mode"][vehicle.row] = AutoYawMode.ROI


def stop_yaw_rate(fleet: Fleet, vehicle: Vehicle) -> None:
    """End a yaw rate that is not repeated."""
    if mode(fleet, vehicle) in (AutoYawMode.RATE, AutoYawMode.ANGLE_RATE):
        set_mode(fleet, vehicle, AutoYawMode.HOLD)
