"""Failsafe checks at 10 Hz and pre-arm checks at 1 Hz, called in every service.

One compiled function runs all checks of all aircraft; Python runs only for an aircraft that raised an alarm.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from skyrange.contracts.components import Floats
from skyrange.core.compiled import compiled
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.vehicle.builtin import battery_monitor
from skyrange.vehicle.builtin.arming import prearm
from skyrange.vehicle.builtin.failsafes import (
    battery,
    crash,
    ekf,
    fence,
    ground_station,
)
from skyrange.vehicle.builtin.failsafes.actions import Alarm
from skyrange.vehicle.builtin.failsafes.battery import check_battery
from skyrange.vehicle.builtin.failsafes.crash import check_thrust_loss
from skyrange.vehicle.builtin.failsafes.ekf import check_dead_reckoning, check_ekf, check_glitch, has_position
from skyrange.vehicle.builtin.failsafes.fence import check_fence
from skyrange.vehicle.builtin.failsafes.ground_station import check_ground_station
from skyrange.vehicle.builtin.fleet import Fleet, Vehicle
from skyrange.vehicle.builtin.layout import Records

PERIOD_NS: Final[Time] = 100 * NS_PER_MS
_PREARM_NS: Final[Time] = NS_PER_S
_PERIOD_S = PERIOD_NS / NS_PER_S


@compiled
def check_all(  # noqa: PLR0917
    estimate: Records,
    flight: Records,
    settings: Records,
    batteries: Records,
    fences: Records,
    zones: Records,
    checks: Records,
    now_ns: int,
    dt_s: float,
) -> int:
    """Run all checks of every row: set `CHECK_STATE.alarms` and return how many rows raised any."""
    alarmed = 0
    for i in range(checks.shape[0]):
        e: Any = estimate[i]
        f: Any = flight[i]
        p: Any = settings[i]
        w: Any = checks[i]
        if w.located == 0 and has_position(e, f, w):
            w.located = 1
        alarms = check_fence(e, f, p, fences[i], zones[i], w, now_ns)
        alarms |= check_battery(e, f, p, batteries[i], now_ns, dt_s)
        alarms |= check_ground_station(p, w, now_ns)
        alarms |= check_dead_reckoning(e, p, w, now_ns)
        alarms |= check_ekf(e, f, p, w, dt_s)
        alarms |= check_glitch(e, w)
        alarms |= check_thrust_loss(e, f, p, w, now_ns)
        w.alarms = alarms
        if alarms != 0:
            alarmed += 1
    return alarmed


_HANDLERS: Final[dict[Alarm, Callable[[Fleet, Vehicle], None]]] = {
    Alarm.FENCE_CHANGED: fence.on_auto_enable,
    Alarm.FENCE_BREACHED: fence.on_breach,
    Alarm.FENCE_CLEARED: fence.on_breach_cleared,
    Alarm.BATTERY: battery.on_battery_failsafe,
    Alarm.GCS_LOST: ground_station.on_lost,
    Alarm.GCS_RECOVERED: ground_station.on_recovered,
    Alarm.DEAD_RECKONING_STARTED: ekf.on_dead_reckoning_started,
    Alarm.DEAD_RECKONING_STOPPED: ekf.on_dead_reckoning_stopped,
    Alarm.DEAD_RECKONING_TIMEOUT: ekf.on_dead_reckoning_timeout,
    Alarm.DEAD_RECKONING_FAILSAFE: ekf.on_dead_reckoning_failsafe,
    Alarm.ESTIMATOR_BAD: ekf.on_ekf_bad,
    Alarm.ESTIMATOR_GOOD: ekf.on_ekf_good,
    Alarm.GLITCH_STARTED: ekf.on_glitch_started,
    Alarm.GLITCH_STOPPED: ekf.on_glitch_stopped,
}


def run_checks(fleet: Fleet, actuators: Floats) -> None:
    """Check and act where it is time to; `actuators` (n, motors) are the present commands."""
    now = fleet.now
    if now % PERIOD_NS != 0:
        return
    alarmed = check_all(
        fleet.estimate,
        fleet.flight,
        fleet.settings,
        fleet.battery,
        fleet.fence,
        fleet.fence_zones,
        fleet.checks,
        now,
        _PERIOD_S,
    )
    if alarmed:
        _handle_alarms(fleet, actuators)
    if now % _PREARM_NS == 0:
        prearm.update(fleet)


def _handle_alarms(fleet: Fleet, actuators: Floats) -> None:
    alarms = fleet.checks["alarms"]
    for row in np.flatnonzero(alarms).tolist():
        raised = int(alarms[row])
        vehicle = fleet.vehicles[row]
        for alarm, act in _HANDLERS.items():
            if raised & alarm:
                act(fleet, vehicle)
        if raised & Alarm.THRUST_LOST:
            crash.on_thrust_loss(fleet, vehicle, actuators)


def reset_state(fleet: Fleet, vehicle: Vehicle) -> None:
    """Reset to the state after power-on: a full battery, fence by parameters, nothing detected."""
    row = vehicle.row
    fleet.fence[row] = np.zeros((), dtype=fleet.fence.dtype)
    fleet.checks[row] = np.zeros((), dtype=fleet.checks.dtype)
    fleet.checks["home"][row] = vehicle.home
    battery_monitor.reset_battery(fleet, row)
