"""Fence: its types, which of them are in force (FENCE_…, DO_FENCE_ENABLE, FENCE_STATUS), and its pre-arm checks.

After libraries/AC_Fence/AC_Fence.cpp and libraries/GCS_MAVLink/GCS_Fence.cpp. Breaches are checked in
`failsafes.fence`; polygons and circles are uploaded by `mission_protocol.fence_items`.
"""

from __future__ import annotations

import math
from enum import IntFlag
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import dialect
from skyrange.vehicle.builtin.fence_zones import outside
from skyrange.vehicle.builtin.fleet import Craft, Fleet


class Kind(IntFlag):
    """Fence types: FENCE_TYPE's bits."""

    ALT_MAX = 1
    CIRCLE = 2
    POLYGON = 4
    ALT_MIN = 8


ALL: Final = Kind.ALT_MAX | Kind.CIRCLE | Kind.POLYGON | Kind.ALT_MIN
_ARMING_TYPES = Kind.ALT_MAX | Kind.CIRCLE | Kind.POLYGON
_NAMES = {Kind.ALT_MAX: "Max Alt", Kind.CIRCLE: "Circle", Kind.POLYGON: "Polygon", Kind.ALT_MIN: "Min Alt"}
_MANUALLY_ENABLED, _MANUALLY_DISABLED = 1, 2
_OPTION_DISABLE_MODE_CHANGE = 1  # OPTIONS::DISABLE_MODE_CHANGE
_OPTION_INCLUSION_UNION = 2  # OPTIONS::INCLUSION_UNION
_AUTO_TAKEOFF = (1, 2)
_AUTO_ARMED = 3


def names(kinds: int) -> str:
    """Return ArduPilot's name of some types together: "Max Alt and Circle fences" (`get_fence_names`)."""
    parts = [words for kind, words in _NAMES.items() if kinds & kind]
    whole = f"{', '.join(parts[:-1])} and {parts[-1]}" if len(parts) > 1 else parts[0]
    return f"{whole} fence{'s' if len(parts) > 1 else ''}"


def tell(fleet: Fleet, craft: Craft, what: str, kinds: int) -> None:
    """Send STATUSTEXT about some types; nothing for none (`print_fence_message`)."""
    if kinds:
        fleet.text(craft, dialect.MAV_SEVERITY_NOTICE, f"{names(kinds)} {what}")


def present(fleet: Fleet, craft: Craft) -> int:
    """Return the configured types; polygons only where some are stored."""
    kinds = int(fleet.param(craft, "FENCE_TYPE")) & ALL
    return kinds if fleet.zones["count"][craft.row] else kinds & ~Kind.POLYGON


def in_force(fleet: Fleet, craft: Craft) -> int:
    """Return the types that are checked now (`get_enabled_fences`)."""
    return int(fleet.boundary["enabled"][craft.row]) & present(fleet, craft)


def enable(fleet: Fleet, craft: Craft, on: bool, kinds: int, by_hand: bool = True) -> int:
    """Enable or disable some types and return those that changed. FENCE_ENABLE keeps its value."""
    row, boundary = craft.row, fleet.boundary
    kinds &= int(fleet.param(craft, "FENCE_TYPE"))
    before = int(boundary["enabled"][row])
    after = before | kinds if on else before & ~kinds
    if by_hand and kinds & Kind.ALT_MIN:
        boundary["floor"][row] = _MANUALLY_ENABLED if on else _MANUALLY_DISABLED
    boundary["enabled"][row] = after
    changed = before ^ after
    if not on:
        boundary["breached"][row] &= ~changed
    return changed


def command(fleet: Fleet, craft: Craft, what: int, kinds: int) -> int:
    """Execute MAV_CMD_DO_FENCE_ENABLE and return its MAV_RESULT: `what` is param1, `kinds` param2 (0 all).

    After `handle_command_do_fence_enable`: 0 disables, 1 enables, 2 disables the minimum altitude.
    """
    kinds = (kinds & 0xFF) or ALL
    if what == 0:
        enable(fleet, craft, False, kinds)
    elif what == 1:
        if not present(fleet, craft) & kinds:
            return int(dialect.MAV_RESULT_FAILED)
        enable(fleet, craft, True, kinds)
    elif what == 2:
        enable(fleet, craft, False, Kind.ALT_MIN)
    else:
        return int(dialect.MAV_RESULT_FAILED)
    return int(dialect.MAV_RESULT_ACCEPTED)


def on_arming(fleet: Fleet, craft: Craft) -> None:
    """Enable the fence on arming (FENCE_AUTOENABLE 3)."""
    if fleet.param(craft, "FENCE_AUTOENABLE") == _AUTO_ARMED:
        fleet.boundary["floor"][craft.row] = 0
        tell(fleet, craft, "auto-enabled", enable(fleet, craft, True, _ARMING_TYPES, by_hand=False))


def on_disarming(fleet: Fleet, craft: Craft) -> None:
    """Disable the fence on disarming (FENCE_AUTOENABLE 3)."""
    if fleet.param(craft, "FENCE_AUTOENABLE") == _AUTO_ARMED:
        tell(fleet, craft, "auto-disabled", enable(fleet, craft, False, ALL, by_hand=False))


def after_takeoff(fleet: Fleet, craft: Craft) -> None:
    """Enable the fence once an automatic take-off has reached its height (FENCE_AUTOENABLE 1 and 2)."""
    if fleet.param(craft, "FENCE_AUTOENABLE") in _AUTO_TAKEOFF:
        fleet.boundary["floor"][craft.row] = 0
        tell(fleet, craft, "auto-enabled", enable(fleet, craft, True, ALL, by_hand=False))


def mode_changed(fleet: Fleet, craft: Craft) -> None:
    """Ignore new breaches for 10 s after a mode was chosen during a breach (`manual_recovery_start`)."""
    if fleet.param(craft, "FENCE_ACTION") != 0 and fleet.boundary["breached"][craft.row]:
        fleet.boundary["recovery_ns"][craft.row] = max(fleet.now, 1)
        fleet.text(craft, dialect.MAV_SEVERITY_INFO, "Manual recovery started")


def holds_mode(fleet: Fleet, craft: Craft) -> bool:
    """Whether FENCE_OPTIONS forbids another mode until the breach is over ("in fence recovery")."""
    row = craft.row
    return (
        bool(int(fleet.param(craft, "FENCE_OPTIONS")) & _OPTION_DISABLE_MODE_CHANGE)
        and bool(fleet.boundary["enabled"][row])
        and bool(fleet.boundary["breached"][row])
        and craft.mode_reason == "fence_breached"
        and not fleet.landed(craft)
    )


def allows(fleet: Fleet, craft: Craft, place: tuple[float, float, float]) -> bool:
    """Whether a destination (east, north, up, m) lies inside the fences in force (`check_destination_within_fence`)."""
    kinds = in_force(fleet, craft)
    if not kinds:
        return True
    east, north, up = place
    above = up - craft.home[2]
    away = math.hypot(east - craft.home[0], north - craft.home[1])
    if kinds & Kind.ALT_MAX and above > fleet.param(craft, "FENCE_ALT_MAX"):
        return False
    if kinds & Kind.ALT_MIN and above < fleet.param(craft, "FENCE_ALT_MIN"):
        return False
    if kinds & Kind.CIRCLE and away > fleet.param(craft, "FENCE_RADIUS"):
        return False
    return not (kinds & Kind.POLYGON and out_of_zones(fleet, craft, east, north))


def out_of_zones(fleet: Fleet, craft: Craft, east: float, north: float) -> bool:
    """Whether a place breaches the polygons and circles."""
    union = bool(int(fleet.param(craft, "FENCE_OPTIONS")) & _OPTION_INCLUSION_UNION)
    return bool(outside(fleet.zones[craft.row], east, north, union)[0])


def safe_alt_m(fleet: Fleet, craft: Craft) -> float:
    """Return the maximum height above home, m, that keeps FENCE_MARGIN to FENCE_ALT_MAX; infinite without one."""
    if in_force(fleet, craft) & Kind.ALT_MAX:
        return fleet.param(craft, "FENCE_ALT_MAX") - fleet.param(craft, "FENCE_MARGIN")
    return math.inf


def troubles(fleet: Fleet, rows: NDArray[np.int64], located: NDArray[np.bool_]) -> list[tuple[NDArray[np.bool_], Any]]:
    """Return which of `rows` may not be armed because of the fence, by reason, most important first (`pre_arm_check`).

    `located` (rows,): where there is a position. A reason is a text, or a function of the aircraft that makes one.
    """
    settings, boundary, zones = fleet.settings, fleet.boundary, fleet.zones

    def value(name: str) -> NDArray[np.float64]:
        return np.asarray(settings[name][rows], dtype=float)

    kinds = value("FENCE_TYPE").astype(np.int64) & int(ALL)
    there = np.where(zones["count"][rows] > 0, kinds, kinds & ~int(Kind.POLYGON))
    wanted = value("FENCE_ENABLE") != 0
    watched = ((boundary["enabled"][rows] != 0) | (value("FENCE_AUTOENABLE") != 0)) & (kinds != 0)
    level = kinds & (Kind.CIRCLE | Kind.POLYGON) != 0
    margin, radius = value("FENCE_MARGIN"), value("FENCE_RADIUS")
    high, low = value("FENCE_ALT_MAX"), value("FENCE_ALT_MIN")
    tightest = zones["tightest"][rows]
    return [
        (wanted & (there == 0), "Fences enabled, but none selected"),
        (watched & level & ~located, "Fence requires position"),
        (
            watched & (there & Kind.POLYGON != 0) & (tightest > 0.0) & (tightest < margin),
            "Polygon fence margin is greater than inclusion circle radius",
        ),
        (watched & (radius < margin), "Circle FENCE_MARGIN is greater than FENCE_RADIUS"),
        (watched & (boundary["breached"][rows] != 0), _breach_text(fleet)),
        (watched & (high < low), "FENCE_ALT_MAX < FENCE_ALT_MIN"),
        (watched & (high - low <= 2.0 * margin), "FENCE_MARGIN too big"),
    ]


def _breach_text(fleet: Fleet) -> Any:
    return lambda craft: f"Vehicle breaching {names(int(fleet.boundary['breached'][craft.row]))}"
