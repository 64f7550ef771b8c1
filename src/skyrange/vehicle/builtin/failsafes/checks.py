"""Failsafe checks at 10 Hz and pre-arm checks at 1 Hz, called in every service.

One compiled function runs all checks of all aircraft; Python runs only for an aircraft that raised an alarm.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from skyrange.agent.contracts import Floats
from skyrange.core.compiled import kernel
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.vehicle.builtin import battery as charge
from skyrange.vehicle.builtin import prearm
from skyrange.vehicle.builtin.failsafes import battery, boundary, estimator, ground_station, thrust
from skyrange.vehicle.builtin.failsafes.alarms import Alarm
from skyrange.vehicle.builtin.failsafes.battery import check_battery
from skyrange.vehicle.builtin.failsafes.boundary import check_fence
from skyrange.vehicle.builtin.failsafes.estimator import check_estimator, check_glitch, check_reckoning, has_position
from skyrange.vehicle.builtin.failsafes.ground_station import check_station
from skyrange.vehicle.builtin.failsafes.thrust import check_thrust
from skyrange.vehicle.builtin.fleet import Craft, Fleet
from skyrange.vehicle.builtin.layout import Records

PERIOD_NS: Final[Time] = 100 * NS_PER_MS
_PREARM_NS: Final[Time] = NS_PER_S
_PERIOD_S = PERIOD_NS / NS_PER_S


@kernel
def check(
    estimate: Records,
    flight: Records,
    settings: Records,
    power: Records,
    boundaries: Records,
    zones: Records,
    watch: Records,
    now_ns: int,
    dt_s: float,
) -> int:
    """Run all checks of every row: set `CHECK_STATE.alarms` and return how many rows raised any."""
    alarmed = 0
    for i in range(watch.shape[0]):
        e: Any = estimate[i]
        f: Any = flight[i]
        p: Any = settings[i]
        w: Any = watch[i]
        if w.located == 0 and has_position(e, f, w):
            w.located = 1
        alarms = check_fence(e, f, p, boundaries[i], zones[i], w, now_ns)
        alarms |= check_battery(e, f, p, power[i], now_ns, dt_s)
        alarms |= check_station(p, w, now_ns)
        alarms |= check_reckoning(e, p, w, now_ns)
        alarms |= check_estimator(e, f, p, w, dt_s)
        alarms |= check_glitch(e, w)
        alarms |= check_thrust(e, f, p, w, now_ns)
        w.alarms = alarms
        if alarms != 0:
            alarmed += 1
    return alarmed


_HANDLERS: Final[dict[Alarm, Callable[[Fleet, Craft], None]]] = {
    Alarm.FENCE_CHANGED: boundary.changed,
    Alarm.FENCE_BREACHED: boundary.breached,
    Alarm.FENCE_CLEARED: boundary.cleared,
    Alarm.BATTERY: battery.worse,
    Alarm.STATION_LOST: ground_station.lost,
    Alarm.STATION_BACK: ground_station.back,
    Alarm.RECKONING_STARTED: estimator.reckoning_started,
    Alarm.RECKONING_STOPPED: estimator.reckoning_stopped,
    Alarm.RECKONING_OVER: estimator.reckoning_over,
    Alarm.RECKONING_FAILSAFE: estimator.reckoning_failsafe,
    Alarm.ESTIMATOR_BAD: estimator.bad,
    Alarm.ESTIMATOR_GOOD: estimator.good,
    Alarm.GLITCH_STARTED: estimator.glitch_started,
    Alarm.GLITCH_STOPPED: estimator.glitch_stopped,
}


def serve(fleet: Fleet, actuators: Floats) -> None:
    """Check and act where it is time to; `actuators` (n, motors) are the present commands."""
    now = fleet.now
    if now % PERIOD_NS != 0:
        return
    alarmed = check(
        fleet.estimate,
        fleet.flight,
        fleet.settings,
        fleet.power,
        fleet.boundary,
        fleet.zones,
        fleet.watch,
        now,
        _PERIOD_S,
    )
    if alarmed:
        _handle_alarms(fleet, actuators)
    if now % _PREARM_NS == 0:
        prearm.update(fleet)


def _handle_alarms(fleet: Fleet, actuators: Floats) -> None:
    alarms = fleet.watch["alarms"]
    for row in np.flatnonzero(alarms).tolist():
        raised = int(alarms[row])
        craft = fleet.crafts[row]
        for alarm, act in _HANDLERS.items():
            if raised & alarm:
                act(fleet, craft)
        if raised & Alarm.THRUST_LOST:
            thrust.lost(fleet, craft, actuators)


def boot(fleet: Fleet, craft: Craft) -> None:
    """Reset to the state after power-on: a full battery, fence by parameters, nothing detected."""
    row = craft.row
    fleet.boundary[row] = np.zeros((), dtype=fleet.boundary.dtype)
    fleet.watch[row] = np.zeros((), dtype=fleet.watch.dtype)
    fleet.watch["home"][row] = craft.home
    charge.full(fleet, row)
