"""Fence failsafe: breaches and FENCE_ACTION.

After libraries/AC_Fence/AC_Fence.cpp (`update`, `check`, `check_fence_…`, `record_breach`, `auto_enable_fence_floor`)
and ArduCopter/fence.cpp (`fence_checks_async`, `fence_check`). Checked at 10 Hz, where ArduCopter does at 25 Hz.
"""

from __future__ import annotations

from typing import Any

from skyrange.codec.mavlink import dialect
from skyrange.core import elementary
from skyrange.core.compiled import compiled
from skyrange.core.time import NS_PER_S
from skyrange.vehicle.builtin import fence
from skyrange.vehicle.builtin.arming.arming import disarm
from skyrange.vehicle.builtin.failsafes.actions import Alarm
from skyrange.vehicle.builtin.fence import zone_breach
from skyrange.vehicle.builtin.fleet import Fleet, Vehicle
from skyrange.vehicle.builtin.layout import ControlMode
from skyrange.vehicle.builtin.mode_change import set_mode
from skyrange.vehicle.builtin.modes import Mode
from skyrange.vehicle.builtin.telemetry.table import build_message

_CHANGED = int(Alarm.FENCE_CHANGED)
_BREACHED = int(Alarm.FENCE_BREACHED)
_CLEARED = int(Alarm.FENCE_CLEARED)
_ALT_MAX = int(fence.FenceType.ALT_MAX)
_CIRCLE = int(fence.FenceType.CIRCLE)
_POLYGON = int(fence.FenceType.POLYGON)
_ALT_MIN = int(fence.FenceType.ALT_MIN)
_ALL = int(fence.ALL_TYPES)
_LAND = int(ControlMode.LAND)
_BACKUP_M = 20.0  # AC_FENCE_…_BACKUP_DISTANCE of a copter
_GIVE_UP_M = 100.0  # AC_FENCE_GIVE_UP_DISTANCE
_RECOVERY_NS = 10 * NS_PER_S  # AC_FENCE_MANUAL_RECOVERY_TIME_MIN
_NOTIFY_NS = NS_PER_S  # record_breach
_COUNT_MAX = 65_500
_UNION = 2  # FENCE_OPTIONS
_TAKEOFF_AUTO = 1  # FENCE_AUTOENABLE


@compiled
def _follow_parameters(p: Any, b: Any) -> None:
    """A changed FENCE_ENABLE or FENCE_AUTOENABLE sets the types in force again (`update`)."""
    wanted = int(p.FENCE_ENABLE)
    auto = int(p.FENCE_AUTOENABLE)
    if wanted != b.last_enable or auto != b.last_auto_enable:
        b.last_enable = wanted
        b.last_auto_enable = auto
        b.enabled = (int(p.FENCE_TYPE) & _ALL & ~_ALT_MIN) if wanted != 0 else 0


@compiled
def _record_breach(b: Any, kind: int, now_ns: int) -> int:
    if b.breached == 0:
        b.breach_ns = now_ns
    if b.count < _COUNT_MAX:
        b.count += 1
    b.breached |= kind
    return kind


@compiled
def _check_alt_max(p: Any, b: Any, above: float, now_ns: int) -> int:
    b.alt_max_breach_m = above - p.FENCE_ALT_MAX
    if above >= p.FENCE_ALT_MAX:
        if b.breached & _ALT_MAX == 0 or (b.backup_max_m != 0.0 and above >= b.backup_max_m):
            b.backup_max_m = above + _BACKUP_M
            return _record_breach(b, _ALT_MAX, now_ns)
    elif b.breached & _ALT_MAX != 0:
        b.breached &= ~_ALT_MAX
        b.backup_max_m = 0.0
    return 0


@compiled
def _check_alt_min(p: Any, b: Any, above: float, now_ns: int) -> int:
    b.alt_min_breach_m = p.FENCE_ALT_MIN - above
    if above <= p.FENCE_ALT_MIN:
        if b.breached & _ALT_MIN == 0 or (b.backup_min_m != 0.0 and above <= b.backup_min_m):
            b.backup_min_m = above - _BACKUP_M
            return _record_breach(b, _ALT_MIN, now_ns)
    elif b.breached & _ALT_MIN != 0:
        b.breached &= ~_ALT_MIN
        b.backup_min_m = 0.0
    return 0


@compiled
def _check_circle(p: Any, b: Any, away: float, now_ns: int) -> int:
    b.circle_breach_m = away - p.FENCE_RADIUS
    if away >= p.FENCE_RADIUS:
        if b.breached & _CIRCLE == 0 or (b.backup_circle_m != 0.0 and away >= b.backup_circle_m):
            b.backup_circle_m = away + _BACKUP_M
            return _record_breach(b, _CIRCLE, now_ns)
    elif b.breached & _CIRCLE != 0:
        b.breached &= ~_CIRCLE
        b.backup_circle_m = 0.0
    return 0


@compiled
def _check_polygon(e: Any, p: Any, b: Any, z: Any, now_ns: int) -> int:
    broken, b.polygon_breach_m = zone_breach(z, e.pos[0], e.pos[1], int(p.FENCE_OPTIONS) & _UNION != 0)
    if broken:
        if b.breached & _POLYGON == 0:
            return _record_breach(b, _POLYGON, now_ns)
    else:
        b.breached &= ~_POLYGON
    return 0


@compiled
def _auto_enable_alt_min(p: Any, b: Any, above: float) -> None:
    """Enable the minimum altitude automatically once it is reached (`auto_enable_fence_floor`)."""
    auto = int(p.FENCE_AUTOENABLE)
    if int(p.FENCE_TYPE) & _ALT_MIN == 0 or b.enabled & _ALT_MIN != 0 or b.alt_min_state == 2:
        return
    if b.enabled == 0 and p.FENCE_ENABLE == 0 and auto <= _TAKEOFF_AUTO:
        return
    if above >= p.FENCE_ALT_MIN + p.FENCE_MARGIN:
        b.enabled |= _ALT_MIN
        b.alt_min_enabled = 1


@compiled
def check_fence(e: Any, f: Any, p: Any, b: Any, z: Any, w: Any, now_ns: int) -> int:  # noqa: PLR0917
    """Check one aircraft and return its alarms; `FENCE_STATE.new_breaches` are the types breached newly."""
    configured = int(p.FENCE_TYPE) & _ALL
    if (
        p.FENCE_ENABLE == 0
        and b.last_enable == 0
        and p.FENCE_AUTOENABLE == 0
        and b.last_auto_enable == 0
        and b.enabled == 0
    ):
        return 0
    _follow_parameters(p, b)
    before = b.breached
    b.new_breaches = 0
    b.auto_disabled = 0
    b.alt_min_enabled = 0
    down = f.control == _LAND or f.landed == 1 or f.armed == 0
    off = 0
    if down:  # get_auto_disable_fences
        off = _ALL if p.FENCE_AUTOENABLE == _TAKEOFF_AUTO else _ALT_MIN
        if b.alt_min_state == 1:
            off &= ~_ALT_MIN
    b.auto_disabled = off & b.enabled
    b.breached &= configured & ~b.auto_disabled
    b.enabled &= ~off
    above = e.pos[2] - w.home[2]
    in_force = b.enabled & configured
    if z.count == 0:
        in_force &= ~_POLYGON
    fresh = 0
    if in_force & _ALT_MAX != 0:
        fresh |= _check_alt_max(p, b, above, now_ns)
    if in_force & _ALT_MIN != 0:
        fresh |= _check_alt_min(p, b, above, now_ns)
    if off & _ALT_MIN == 0:
        _auto_enable_alt_min(p, b, above)
    if in_force & _CIRCLE != 0:
        fresh |= _check_circle(p, b, elementary.hypot(e.pos[0] - w.home[0], e.pos[1] - w.home[1]), now_ns)
    if in_force & _POLYGON != 0:
        fresh |= _check_polygon(e, p, b, z, now_ns)
    else:
        b.breached &= ~_POLYGON
    if b.recovery_ns != 0:
        if now_ns - b.recovery_ns < _RECOVERY_NS:
            fresh = 0
        else:
            b.recovery_ns = 0
    b.new_breaches = fresh
    alarms = _CHANGED if b.auto_disabled != 0 or b.alt_min_enabled != 0 else 0
    if fresh != 0:
        alarms |= _BREACHED
    elif before != 0 and b.breached == 0:
        alarms |= _CLEARED
    return alarms


def on_auto_enable(fleet: Fleet, vehicle: Vehicle) -> None:
    """Report types disabled for a landing, or the minimum altitude that was enabled."""
    state = fleet.fence[vehicle.row]
    fence.send_fence_message(fleet, vehicle, "auto-disabled", int(state["auto_disabled"]))
    if state["alt_min_enabled"]:
        fleet.send_text(vehicle, dialect.MAV_SEVERITY_NOTICE, "Min Alt fence enabled (auto enable)")


def on_breach_cleared(fleet: Fleet, vehicle: Vehicle) -> None:
    """Report that the aircraft is back inside."""
    if not fleet.landed(vehicle):
        fleet.send_text(vehicle, dialect.MAV_SEVERITY_NOTICE, "Fence breach cleared")
    fleet.note("event.fence_cleared", vehicle)


def on_breach(fleet: Fleet, vehicle: Vehicle) -> None:
    """Report a new breach, or a backup breach 20 m farther out, and act if armed."""
    state = fleet.fence
    row = vehicle.row
    kinds = int(state["new_breaches"][row])
    if int(state["breach_ns"][row]) == fleet.now and fleet.now - int(state["status_sent_ns"][row]) > _NOTIFY_NS:
        state["status_sent_ns"][row] = fleet.now
        message = build_message(fleet, vehicle, dialect.MAVLINK_MSG_ID_FENCE_STATUS)
        if message is not None:
            fleet.send(vehicle, message)
    if not fleet.armed(vehicle):
        return
    fence.send_fence_message(fleet, vehicle, "breached", 0 if fleet.landed(vehicle) else kinds)
    fleet.note(
        "event.fence_breach",
        vehicle,
        {"fence": fence.fence_names(kinds), "outside_m": _breach_distance_m(fleet, vehicle, kinds)},
        vehicle.flight_causes,
    )
    action = int(fleet.param(vehicle, "FENCE_ACTION"))
    if action == 0:
        return
    if fleet.landed(vehicle):
        disarm(fleet, vehicle, "fence_breach", ())
    elif _breach_distance_m(fleet, vehicle, kinds) > _GIVE_UP_M:
        set_mode(fleet, vehicle, Mode.LAND, "fence_breached", ())
    else:
        _change_mode(fleet, vehicle, action)


def _change_mode(fleet: Fleet, vehicle: Vehicle, action: int) -> None:
    """FENCE_ACTION: 1 RTL, 2 LAND, 3 SmartRTL or RTL, 4 BRAKE, 5 SmartRTL or LAND; LAND where that is refused.

    There is no SmartRTL (`failsafes.actions`), so 3 returns and 5 lands.
    """
    first = {2: Mode.LAND, 4: Mode.BRAKE, 5: Mode.LAND}.get(action, Mode.RTL)
    if not set_mode(fleet, vehicle, first, "fence_breached", ()) and first != Mode.LAND:
        set_mode(fleet, vehicle, Mode.LAND, "fence_breached", ())


def _breach_distance_m(fleet: Fleet, vehicle: Vehicle, kinds: int) -> float:
    """Return the largest distance outside some types, m (`get_breach_distance`)."""
    state = fleet.fence[vehicle.row]
    names = {
        _ALT_MAX: "alt_max_breach_m",
        _ALT_MIN: "alt_min_breach_m",
        _CIRCLE: "circle_breach_m",
        _POLYGON: "polygon_breach_m",
    }
    return max(float(state[name]) for kind, name in names.items() if kinds & kind)
