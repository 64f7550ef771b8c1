"""Alarms of the failsafe checks: bits, in the order in which they are acted upon.

The order is that of ArduCopter's scheduler table (Copter.cpp): fence, battery, ground station and dead reckoning,
estimator, GNSS.
"""

from __future__ import annotations

from enum import IntFlag


class Alarm(IntFlag):
    """New findings of a check; `CHECK_STATE.alarms`."""

    FENCE_CHANGED = 1 << 0
    """The minimum altitude was enabled automatically, or types were disabled for a landing."""
    FENCE_BREACHED = 1 << 1
    FENCE_CLEARED = 1 << 2
    BATTERY = 1 << 3
    """A worse level; see `BATTERY_STATE.pending_level`."""
    GCS_LOST = 1 << 4
    GCS_RECOVERED = 1 << 5
    DEAD_RECKONING_STARTED = 1 << 6
    DEAD_RECKONING_STOPPED = 1 << 7
    DEAD_RECKONING_TIMEOUT = 1 << 8
    """Dead reckoning for longer than FS_DR_TIMEOUT."""
    DEAD_RECKONING_FAILSAFE = 1 << 9
    ESTIMATOR_BAD = 1 << 10
    ESTIMATOR_GOOD = 1 << 11
    GLITCH_STARTED = 1 << 12
    GLITCH_STOPPED = 1 << 13
    THRUST_LOST = 1 << 14
