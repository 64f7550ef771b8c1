"""Battery monitor: voltage, current, consumed charge, and the estimated resting voltage.

After libraries/AP_BattMonitor/AP_BattMonitor_Backend.cpp: `update_consumed`, `capacity_remaining_pct`,
`update_resistance_estimate`, `arming_checks`. The battery failsafe is in `failsafes.battery`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyrange.core.compiled import compiled
from skyrange.vehicle.builtin.fleet import Fleet
from skyrange.vehicle.builtin.layout import NO_PRIORITY

_MAH_PER_AS = 1.0 / 3.6
_FAST_S = 0.5  # AP_BATT_MONITOR_RES_EST_TC_1
_STEP = 0.1  # AP_BATT_MONITOR_RES_EST_TC_2
_CAPACITY_MIN_MAH = 10.0  # capacity_remaining_pct


@compiled
def _update_resistance(b: Any, dt_s: float) -> None:
    """Estimate the internal resistance from how voltage and current differ from their low-passed values."""
    if b.current <= 0.0:
        return
    b.current_max_a = max(b.current_max_a, b.current)
    change = b.current - b.current_filt_a
    if change == 0.0:
        return
    if b.voltage > b.reference_v:
        b.reference_v = b.voltage
        b.reference_a = b.current
    fast = min(dt_s / (dt_s + _FAST_S), 0.5)
    weight = min(1.0, _STEP * abs(change / b.current_max_a))
    seen = -(b.voltage - b.voltage_filt) / change
    if seen > 0.0:
        b.resistance = b.resistance * (1.0 - weight) + seen * weight
    if b.reference_v > b.voltage and b.current > b.reference_a:
        b.resistance = min(b.resistance, (b.reference_v - b.voltage) / (b.current - b.reference_a))
    b.voltage_filt += (b.voltage - b.voltage_filt) * fast
    b.current_filt_a += change * fast
    b.resting_v = b.voltage + b.current * b.resistance


@compiled
def update_battery(e: Any, p: Any, b: Any, dt_s: float) -> None:
    """Read voltage and current, and add up what was consumed in `dt_s`."""
    b.voltage = e.battery_v
    b.current = e.battery_a
    drawn_mah = b.current * dt_s * _MAH_PER_AS
    b.consumed_mah += drawn_mah
    b.consumed_wh += 0.001 * drawn_mah * b.voltage
    _update_resistance(b, dt_s)
    b.resting_v = max(b.resting_v, b.voltage)
    if p.BATT_CAPACITY > _CAPACITY_MIN_MAH:
        left = 100.0 * (p.BATT_CAPACITY - b.consumed_mah) / p.BATT_CAPACITY
        b.remaining_pct = int(min(max(left, 0.0), 255.0))
    else:
        b.remaining_pct = -1


def prearm_failures(fleet: Fleet, rows: NDArray[np.int64]) -> list[tuple[NDArray[np.bool_], str]]:
    """Return which of `rows` the battery forbids to arm, by reason, most important first (`arming_checks`)."""
    power, settings = fleet.battery, fleet.settings

    def value(name: str) -> NDArray[np.float64]:
        return np.asarray(settings[name][rows], dtype=float)

    now_v = power["voltage"][rows]
    volts = np.where(value("BATT_FS_VOLTSRC") == 1, power["resting_v"][rows], now_v)
    left_mah = value("BATT_CAPACITY") - power["consumed_mah"][rows]
    low_v, crt_v = value("BATT_LOW_VOLT"), value("BATT_CRT_VOLT")
    low_mah, crt_mah = value("BATT_LOW_MAH"), value("BATT_CRT_MAH")
    arm_v, arm_mah = value("BATT_ARM_VOLT"), value("BATT_ARM_MAH")
    watched = value("BATT_MONITOR") != 0
    reasons = (
        (~(now_v > 0.0), "unhealthy"),
        ((arm_v > 0.0) & (now_v < arm_v), "below minimum arming voltage"),
        ((arm_mah > 0.0) & (left_mah < arm_mah), "below minimum arming capacity"),
        ((volts > 0.0) & (low_v > 0.0) & (volts < low_v), "low voltage failsafe"),
        ((low_mah > 0.0) & (left_mah < low_mah), "low capacity failsafe"),
        ((volts > 0.0) & (crt_v > 0.0) & (volts < crt_v), "critical voltage failsafe"),
        ((crt_mah > 0.0) & (left_mah < crt_mah), "critical capacity failsafe"),
        ((crt_mah > 0.0) & (low_mah > 0.0) & (low_mah <= crt_mah), "capacity failsafe critical >= low"),
        ((crt_v > 0.0) & (low_v > 0.0) & (low_v <= crt_v), "voltage failsafe critical >= low"),
    )
    return [(watched & bad, f"Battery 1 {words}") for bad, words in reasons]


def reset_battery(fleet: Fleet, row: int) -> None:
    """Reset to a full battery without a failsafe, as after power-on."""
    fleet.battery[row] = np.zeros((), dtype=fleet.battery.dtype)
    fleet.battery["priority"][row] = NO_PRIORITY
    fleet.battery["voltage"][row] = fleet.estimate["battery_v"][row]
