"""Yaw modes: how flight modes, mission items and messages set the yaw target (ArduCopter/autoyaw.cpp)."""

from __future__ import annotations

import math

from skyrange.vehicle.builtin import heading
from skyrange.vehicle.builtin.fleet import Craft, Fleet
from skyrange.vehicle.builtin.layout import Heading

_RATE_MAX_RADPS = 20.0  # faster than any ATC_SLEW_YAW: keeps an absurd request finite
_YAW_REACHED_RAD = math.radians(2.0)

Vector = tuple[float, float, float]


def default(fleet: Fleet, craft: Craft, returning: bool = False) -> None:
    """Set the mode that WP_YAW_BEHAVIOR selects (`set_mode_to_default`)."""
    set_kind(fleet, craft, _default_mode(fleet, craft, returning))


def _default_mode(fleet: Fleet, craft: Craft, returning: bool) -> Heading:
    behaviour = int(fleet.param(craft, "WP_YAW_BEHAVIOR"))
    if behaviour == 0 or (behaviour == 2 and returning):
        return Heading.HOLD
    return Heading.AHEAD if behaviour == 3 else Heading.NEXT


def as_armed(fleet: Fleet, craft: Craft) -> None:
    """Above home, turn to the yaw at arming, unless WP_YAW_BEHAVIOR never turns (RTL's `loiterathome_start`)."""
    if _default_mode(fleet, craft, True) == Heading.HOLD:
        set_kind(fleet, craft, Heading.HOLD)
        return
    row, flight = craft.row, fleet.flight
    flight["heading"][row] = Heading.ANGLE_RATE
    flight["target_yaw"][row] = craft.armed_yaw
    flight["target_yaw_rate"][row] = 0.0


def is_as_armed(fleet: Fleet, craft: Craft) -> bool:
    """Whether that turn is complete, to 2°, or none was requested (`loiterathome_run`)."""
    off = math.remainder(float(fleet.estimate["yaw"][craft.row]) - craft.armed_yaw, 2.0 * math.pi)
    return kind(fleet, craft) != Heading.ANGLE_RATE or abs(off) <= _YAW_REACHED_RAD


def set_kind(fleet: Fleet, craft: Craft, kind: Heading) -> None:
    """Set another yaw mode; its target starts from the present yaw."""
    row, flight = craft.row, fleet.flight
    if flight["heading"][row] != kind:
        flight["heading"][row] = kind
        flight["target_yaw"][row] = fleet.estimate["yaw"][row]
        flight["target_yaw_rate"][row] = 0.0


def kind(fleet: Fleet, craft: Craft) -> int:
    """Return the present yaw mode."""
    return int(fleet.flight["heading"][craft.row])


def keep_or_default(fleet: Fleet, craft: Craft) -> None:
    """Set the default on the way to a waypoint; keep a ROI, and a fixed yaw where WP_YAW_BEHAVIOR is 0."""
    now = kind(fleet, craft)
    if now == Heading.ROI or (now == Heading.FIXED and fleet.param(craft, "WP_YAW_BEHAVIOR") == 0):
        return
    default(fleet, craft)


def turn(fleet: Fleet, craft: Craft, angle_deg: float, rate_degps: float, direction: int, relative: bool) -> None:
    """Turn to a heading (clockwise from north), or by an angle if `relative`; `rate_degps` 0 is ATC_SLEW_YAW."""
    heading.ask_turn(
        fleet.estimate, fleet.flight, fleet.settings, craft.row,
        math.radians(angle_deg), math.radians(rate_degps), direction, relative,
    )  # fmt: skip


def turned(fleet: Fleet, craft: Craft) -> bool:
    """Whether that turn is complete."""
    return bool(heading.turned(fleet.estimate, fleet.flight, craft.row))


def angle_and_rate(fleet: Fleet, craft: Craft, yaw_rad: float, rate_radps: float) -> None:
    """Point to a yaw (clockwise from north) that goes on turning at a rate."""
    row, flight = craft.row, fleet.flight
    flight["heading"][row] = Heading.ANGLE_RATE
    flight["target_yaw"][row] = math.remainder(0.5 * math.pi - yaw_rad, 2.0 * math.pi)
    flight["target_yaw_rate"][row] = -min(max(rate_radps, -_RATE_MAX_RADPS), _RATE_MAX_RADPS)


def rate(fleet: Fleet, craft: Craft, rate_radps: float) -> None:
    """Turn at a rate, clockwise."""
    row, flight = craft.row, fleet.flight
    flight["heading"][row] = Heading.RATE
    most = math.radians(fleet.param(craft, "ATC_SLEW_YAW") * 0.01)
    flight["target_yaw_rate"][row] = -min(max(rate_radps, -most), most)


def look_at(fleet: Fleet, craft: Craft, place: Vector | None) -> None:
    """Keep the nose towards a place, ENU metres; `None` ends that (`set_roi`)."""
    if place is None:
        default(fleet, craft)
        return
    fleet.flight["roi"][craft.row] = place
    fleet.flight["heading"][craft.row] = Heading.ROI


def stop_turning(fleet: Fleet, craft: Craft) -> None:
    """End a yaw rate that is not repeated."""
    if kind(fleet, craft) in (Heading.RATE, Heading.ANGLE_RATE):
        set_kind(fleet, craft, Heading.HOLD)
