"""Where shall the nose point? What modes, mission items and messages ask of the heading (ArduCopter/autoyaw.cpp)."""

from __future__ import annotations

import math

from skyrange.vehicle.builtin import heading
from skyrange.vehicle.builtin.fleet import Craft, Fleet
from skyrange.vehicle.builtin.layout import Heading

_RATE_MAX_RADPS = 20.0  # beyond any ATC_SLEW_YAW: keeps an absurd request finite
_TURNED_RAD = math.radians(2.0)

Vector = tuple[float, float, float]


def default(fleet: Fleet, craft: Craft, returning: bool = False) -> None:
    """As WP_YAW_BEHAVIOR says (`set_mode_to_default`)."""
    set_kind(fleet, craft, _default(fleet, craft, returning))


def _default(fleet: Fleet, craft: Craft, returning: bool) -> Heading:
    behaviour = int(fleet.param(craft, "WP_YAW_BEHAVIOR"))
    if behaviour == 0 or (behaviour == 2 and returning):
        return Heading.HOLD
    return Heading.AHEAD if behaviour == 3 else Heading.NEXT


def as_armed(fleet: Fleet, craft: Craft) -> None:
    """Above home: as it stood when it was armed, unless WP_YAW_BEHAVIOR turns no nose (RTL's `loiterathome_start`)."""
    if _default(fleet, craft, True) == Heading.HOLD:
        set_kind(fleet, craft, Heading.HOLD)
        return
    row, flight = craft.row, fleet.flight
    flight["heading"][row] = Heading.ANGLE_RATE
    flight["target_yaw"][row] = craft.armed_yaw
    flight["target_yaw_rate"][row] = 0.0


def is_as_armed(fleet: Fleet, craft: Craft) -> bool:
    """Whether that turn is done, to 2°, or none was asked for (`loiterathome_run`)."""
    off = math.remainder(float(fleet.estimate["yaw"][craft.row]) - craft.armed_yaw, 2.0 * math.pi)
    return kind(fleet, craft) != Heading.ANGLE_RATE or abs(off) <= _TURNED_RAD


def set_kind(fleet: Fleet, craft: Craft, kind: Heading) -> None:
    """Another way of heading; one that turns nothing by itself starts from the present yaw."""
    row, flight = craft.row, fleet.flight
    if flight["heading"][row] != kind:
        flight["heading"][row] = kind
        flight["target_yaw"][row] = fleet.estimate["yaw"][row]
        flight["target_yaw_rate"][row] = 0.0


def kind(fleet: Fleet, craft: Craft) -> int:
    """How it heads."""
    return int(fleet.flight["heading"][craft.row])


def keep_or_default(fleet: Fleet, craft: Craft) -> None:
    """On the way to a waypoint: a region of interest stays looked at, a fixed heading where WP_YAW_BEHAVIOR is 0."""
    now = kind(fleet, craft)
    if now == Heading.ROI or (now == Heading.FIXED and fleet.param(craft, "WP_YAW_BEHAVIOR") == 0):
        return
    default(fleet, craft)


def turn(fleet: Fleet, craft: Craft, angle_deg: float, rate_degps: float, direction: int, relative: bool) -> None:
    """Turn to a heading (clockwise from north) or on by an angle; `rate_degps` 0 is ATC_SLEW_YAW."""
    heading.ask_turn(
        fleet.estimate, fleet.flight, fleet.settings, craft.row,
        math.radians(angle_deg), math.radians(rate_degps), direction, relative,
    )  # fmt: skip


def turned(fleet: Fleet, craft: Craft) -> bool:
    """Whether that turn is done."""
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
    """A rate that nobody repeats ends."""
    if kind(fleet, craft) in (Heading.RATE, Heading.ANGLE_RATE):
        set_kind(fleet, craft, Heading.HOLD)
