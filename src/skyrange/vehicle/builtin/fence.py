"""Fence: its types and state, its pre-arm checks, and the geometry of its zones.

Fence zones: whether a place is inside the polygons and circles of a fence, and its distance from their edges. After
libraries/AC_Fence/AC_PolyFence_loader.cpp `breached` and libraries/AP_Math/polygon.cpp, in metres of the local frame
where ArduPilot uses integer degrees × 10⁻⁷.

Its types, which of them are in force (FENCE_…, DO_FENCE_ENABLE, FENCE_STATUS), and its pre-arm checks: after
libraries/AC_Fence/AC_Fence.cpp and libraries/GCS_MAVLink/GCS_Fence.cpp. Breaches are checked in `failsafes.fence`;
polygons and circles are uploaded by `mission_protocol.fence_items`.
"""

from __future__ import annotations

import math
from enum import IntFlag
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import dialect
from skyrange.core import elementary
from skyrange.core.compiled import compiled
from skyrange.vehicle.builtin.fleet import Fleet, Vehicle
from skyrange.vehicle.builtin.layout import CIRCLE_IN, CIRCLE_OUT, POLYGON_IN, POLYGON_OUT

_UNSET = -1e30


@compiled
def _in_polygon(z: Any, first: int, size: int, east: float, north: float) -> bool:
    """Whether an odd number of edges lies on one side (`Polygon_outside`)."""
    inside = False
    for k in range(size):
        a = first + k
        b = first + (k + 1) % size
        if (z.point[a, 0] > east) != (z.point[b, 0] > east):
            across = z.point[b, 0] - z.point[a, 0]
            left = (north - z.point[a, 1]) * across
            right = (z.point[b, 1] - z.point[a, 1]) * (east - z.point[a, 0])
            if (across < 0.0 and left > right) or (across >= 0.0 and left < right):
                inside = not inside
    return inside


@compiled
def _edge_distance(z: Any, first: int, size: int, east: float, north: float) -> float:
    """Return the distance to the nearest edge, m (`Polygon_closest_distance_point`)."""
    least = 1e30
    for k in range(size):
        a = first + k
        b = first + (k + 1) % size
        d_e = z.point[b, 0] - z.point[a, 0]
        d_n = z.point[b, 1] - z.point[a, 1]
        o_e = east - z.point[a, 0]
        o_n = north - z.point[a, 1]
        square = d_e * d_e + d_n * d_n
        share = 0.0
        if square > 0.0:
            share = min(max((o_e * d_e + o_n * d_n) / square, 0.0), 1.0)
        o_e -= share * d_e
        o_n -= share * d_n
        least = min(least, o_e * o_e + o_n * o_n)
    return math.sqrt(least)


@compiled
def zone_breach(z: Any, east: float, north: float, union: bool) -> tuple[bool, float]:  # noqa: FBT001
    """Return whether a place breaches the zones, and how far outside it is, m; negative inside.

    A place must be inside all inclusion zones (with `union`, inside any of them) and outside all exclusion zones. As in
    ArduPilot, the search for the distance ends at the first exclusion polygon that is entered.
    """
    if z.count == 0:
        return False, 0.0
    far = _UNSET
    inclusions = 0
    left = 0
    for k in range(z.count):
        if z.kind[k] != POLYGON_IN:
            continue
        inclusions += 1
        edge = _edge_distance(z, z.first[k], z.size[k], east, north)
        if _in_polygon(z, z.first[k], z.size[k], east, north):
            far = max(far, -edge)
        else:
            left += 1
            far = min(far, edge) if far > 0.0 else edge
    for k in range(z.count):
        if z.kind[k] != POLYGON_OUT:
            continue
        edge = _edge_distance(z, z.first[k], z.size[k], east, north)
        if _in_polygon(z, z.first[k], z.size[k], east, north):
            return True, edge
        far = max(far, -edge)
    for k in range(z.count):
        if z.kind[k] != CIRCLE_OUT:
            continue
        edge = z.radius[k] - elementary.hypot(east - z.point[z.first[k], 0], north - z.point[z.first[k], 1])
        far = max(far, edge)
        if edge > 0.0:
            return True, far
    for k in range(z.count):
        if z.kind[k] != CIRCLE_IN:
            continue
        inclusions += 1
        edge = elementary.hypot(east - z.point[z.first[k], 0], north - z.point[z.first[k], 1]) - z.radius[k]
        far = max(far, edge)
        if edge > 0.0:
            left += 1
    broken = (inclusions > 0 and left == inclusions) if union else left > 0
    return broken, far if far > _UNSET else 0.0


class FenceType(IntFlag):
    """Fence types: FENCE_TYPE's bits."""

    ALT_MAX = 1
    CIRCLE = 2
    POLYGON = 4
    ALT_MIN = 8


ALL_TYPES: Final = FenceType.ALT_MAX | FenceType.CIRCLE | FenceType.POLYGON | FenceType.ALT_MIN
_ARMING_TYPES = FenceType.ALT_MAX | FenceType.CIRCLE | FenceType.POLYGON
_NAMES = {
    FenceType.ALT_MAX: "Max Alt",
    FenceType.CIRCLE: "Circle",
    FenceType.POLYGON: "Polygon",
    FenceType.ALT_MIN: "Min Alt",
}
_MANUALLY_ENABLED, _MANUALLY_DISABLED = 1, 2
_OPTION_DISABLE_MODE_CHANGE = 1  # OPTIONS::DISABLE_MODE_CHANGE
_OPTION_INCLUSION_UNION = 2  # OPTIONS::INCLUSION_UNION
_AUTO_TAKEOFF = (1, 2)
_AUTO_ARMED = 3


def fence_names(kinds: int) -> str:
    """Return ArduPilot's name of some types together: "Max Alt and Circle fences" (`get_fence_names`)."""
    parts = [name for kind, name in _NAMES.items() if kinds & kind]
    whole = f"{', '.join(parts[:-1])} and {parts[-1]}" if len(parts) > 1 else parts[0]
    return f"{whole} fence{'s' if len(parts) > 1 else ''}"


def send_fence_message(fleet: Fleet, vehicle: Vehicle, what: str, kinds: int) -> None:
    """Send STATUSTEXT about some types; nothing for none (`print_fence_message`)."""
    if kinds:
        fleet.send_text(vehicle, dialect.MAV_SEVERITY_NOTICE, f"{fence_names(kinds)} {what}")


def present_fences(fleet: Fleet, vehicle: Vehicle) -> int:
    """Return the configured types; polygons only where some are stored."""
    kinds = int(fleet.param(vehicle, "FENCE_TYPE")) & ALL_TYPES
    return kinds if fleet.fence_zones["count"][vehicle.row] else kinds & ~FenceType.POLYGON


def enabled_fences(fleet: Fleet, vehicle: Vehicle) -> int:
    """Return the types that are checked now (`get_enabled_fences`)."""
    return int(fleet.fence["enabled"][vehicle.row]) & present_fences(fleet, vehicle)


def enable_fences(fleet: Fleet, vehicle: Vehicle, kinds: int, *, on: bool, by_hand: bool = True) -> int:
    """Enable or disable some types and return those that changed. FENCE_ENABLE keeps its value."""
    row, boundary = vehicle.row, fleet.fence
    kinds &= int(fleet.param(vehicle, "FENCE_TYPE"))
    before = int(boundary["enabled"][row])
    after = before | kinds if on else before & ~kinds
    if by_hand and kinds & FenceType.ALT_MIN:
        boundary["alt_min_state"][row] = _MANUALLY_ENABLED if on else _MANUALLY_DISABLED
    boundary["enabled"][row] = after
    changed = before ^ after
    if not on:
        boundary["breached"][row] &= ~changed
    return changed


def handle_do_fence_enable(fleet: Fleet, vehicle: Vehicle, what: int, kinds: int) -> int:
    """Execute MAV_CMD_DO_FENCE_ENABLE and return its MAV_RESULT: `what` is param1, `kinds` param2 (0 all).

    After `handle_command_do_fence_enable`: 0 disables, 1 enables, 2 disables the minimum altitude.
    """
    kinds = (kinds & 0xFF) or ALL_TYPES
    if what == 0:
        enable_fences(fleet, vehicle, kinds, on=False)
    elif what == 1:
        if not present_fences(fleet, vehicle) & kinds:
            return int(dialect.MAV_RESULT_FAILED)
        enable_fences(fleet, vehicle, kinds, on=True)
    elif what == 2:
        enable_fences(fleet, vehicle, FenceType.ALT_MIN, on=False)
    else:
        return int(dialect.MAV_RESULT_FAILED)
    return int(dialect.MAV_RESULT_ACCEPTED)


def auto_enable_on_arming(fleet: Fleet, vehicle: Vehicle) -> None:
    """Enable the fence on arming (FENCE_AUTOENABLE 3)."""
    if fleet.param(vehicle, "FENCE_AUTOENABLE") == _AUTO_ARMED:
        fleet.fence["alt_min_state"][vehicle.row] = 0
        send_fence_message(
            fleet, vehicle, "auto-enabled", enable_fences(fleet, vehicle, _ARMING_TYPES, on=True, by_hand=False)
        )


def auto_disable_on_disarming(fleet: Fleet, vehicle: Vehicle) -> None:
    """Disable the fence on disarming (FENCE_AUTOENABLE 3)."""
    if fleet.param(vehicle, "FENCE_AUTOENABLE") == _AUTO_ARMED:
        send_fence_message(
            fleet, vehicle, "auto-disabled", enable_fences(fleet, vehicle, ALL_TYPES, on=False, by_hand=False)
        )


def auto_enable_after_takeoff(fleet: Fleet, vehicle: Vehicle) -> None:
    """Enable the fence once an automatic take-off has reached its height (FENCE_AUTOENABLE 1 and 2)."""
    if fleet.param(vehicle, "FENCE_AUTOENABLE") in _AUTO_TAKEOFF:
        fleet.fence["alt_min_state"][vehicle.row] = 0
        send_fence_message(
            fleet, vehicle, "auto-enabled", enable_fences(fleet, vehicle, ALL_TYPES, on=True, by_hand=False)
        )


def start_manual_recovery(fleet: Fleet, vehicle: Vehicle) -> None:
    """Ignore new breaches for 10 s after a mode was chosen during a breach (`manual_recovery_start`)."""
    if fleet.param(vehicle, "FENCE_ACTION") != 0 and fleet.fence["breached"][vehicle.row]:
        fleet.fence["recovery_ns"][vehicle.row] = max(fleet.now, 1)
        fleet.send_text(vehicle, dialect.MAV_SEVERITY_INFO, "Manual recovery started")


def blocks_mode_change(fleet: Fleet, vehicle: Vehicle) -> bool:
    """Whether FENCE_OPTIONS forbids another mode until the breach is over ("in fence recovery")."""
    row = vehicle.row
    return (
        bool(int(fleet.param(vehicle, "FENCE_OPTIONS")) & _OPTION_DISABLE_MODE_CHANGE)
        and bool(fleet.fence["enabled"][row])
        and bool(fleet.fence["breached"][row])
        and vehicle.mode_reason == "fence_breached"
        and not fleet.landed(vehicle)
    )


def destination_within_fence(fleet: Fleet, vehicle: Vehicle, place: tuple[float, float, float]) -> bool:
    """Whether a destination (east, north, up, m) lies inside the fences in force (`check_destination_within_fence`)."""
    kinds = enabled_fences(fleet, vehicle)
    if not kinds:
        return True
    east, north, up = place
    above = up - vehicle.home[2]
    away = elementary.hypot(east - vehicle.home[0], north - vehicle.home[1])
    if kinds & FenceType.ALT_MAX and above > fleet.param(vehicle, "FENCE_ALT_MAX"):
        return False
    if kinds & FenceType.ALT_MIN and above < fleet.param(vehicle, "FENCE_ALT_MIN"):
        return False
    if kinds & FenceType.CIRCLE and away > fleet.param(vehicle, "FENCE_RADIUS"):
        return False
    return not (kinds & FenceType.POLYGON and breaches_zones(fleet, vehicle, east, north))


def breaches_zones(fleet: Fleet, vehicle: Vehicle, east: float, north: float) -> bool:
    """Whether a place breaches the polygons and circles."""
    union = bool(int(fleet.param(vehicle, "FENCE_OPTIONS")) & _OPTION_INCLUSION_UNION)
    return bool(zone_breach(fleet.fence_zones[vehicle.row], east, north, union)[0])


def safe_alt_max_m(fleet: Fleet, vehicle: Vehicle) -> float:
    """Return the maximum height above home, m, that keeps FENCE_MARGIN to FENCE_ALT_MAX; infinite without one."""
    if enabled_fences(fleet, vehicle) & FenceType.ALT_MAX:
        return fleet.param(vehicle, "FENCE_ALT_MAX") - fleet.param(vehicle, "FENCE_MARGIN")
    return math.inf


def prearm_failures(
    fleet: Fleet, rows: NDArray[np.int64], located: NDArray[np.bool_]
) -> list[tuple[NDArray[np.bool_], Any]]:
    """Return which of `rows` may not be armed because of the fence, by reason, most important first (`pre_arm_check`).

    `located` (rows,): where there is a position. A reason is a text, or a function of the aircraft that makes one.
    """
    settings, boundary, zones = fleet.settings, fleet.fence, fleet.fence_zones

    def value(name: str) -> NDArray[np.float64]:
        return np.asarray(settings[name][rows], dtype=float)

    kinds = value("FENCE_TYPE").astype(np.int64) & int(ALL_TYPES)
    there = np.where(zones["count"][rows] > 0, kinds, kinds & ~int(FenceType.POLYGON))
    wanted = value("FENCE_ENABLE") != 0
    watched = ((boundary["enabled"][rows] != 0) | (value("FENCE_AUTOENABLE") != 0)) & (kinds != 0)
    level = kinds & (FenceType.CIRCLE | FenceType.POLYGON) != 0
    margin, radius = value("FENCE_MARGIN"), value("FENCE_RADIUS")
    high, low = value("FENCE_ALT_MAX"), value("FENCE_ALT_MIN")
    tightest = zones["min_circle_radius"][rows]
    return [
        (wanted & (there == 0), "Fences enabled, but none selected"),
        (watched & level & ~located, "Fence requires position"),
        (
            watched & (there & FenceType.POLYGON != 0) & (tightest > 0.0) & (tightest < margin),
            "Polygon fence margin is greater than inclusion circle radius",
        ),
        (watched & (radius < margin), "Circle FENCE_MARGIN is greater than FENCE_RADIUS"),
        (watched & (boundary["breached"][rows] != 0), _breach_text(fleet)),
        (watched & (high < low), "FENCE_ALT_MAX < FENCE_ALT_MIN"),
        (watched & (high - low <= 2.0 * margin), "FENCE_MARGIN too big"),
    ]


def _breach_text(fleet: Fleet) -> Any:
    return lambda vehicle: f"Vehicle breaching {fence_names(int(fleet.fence['breached'][vehicle.row]))}"
