"""RC overrides: RC_CHANNELS_OVERRIDE and MANUAL_CONTROL, which move the pilot's sticks.

After libraries/RC_Channel (`get_radio_in` and the overrides) and GCS_Common.cpp (`handle_rc_channels_override`,
`handle_manual_control`, `manual_override`).
"""

from __future__ import annotations

from typing import Any

from skyrange.core.time import NEVER, from_seconds
from skyrange.vehicle.builtin import navigator, sticks_in
from skyrange.vehicle.builtin.failsafes import ground_station
from skyrange.vehicle.builtin.fleet import CHANNELS, Causes, Craft, Fleet, Timer
from skyrange.vehicle.builtin.sticks_in import MAX_US, MIN_US

_IGNORED, _UNSET = 65535, 32767


def on_override(fleet: Fleet, craft: Craft, message: Any, partner: tuple[int, int], causes: Causes) -> None:
    """RC_CHANNELS_OVERRIDE: microseconds per channel; 0 releases a channel, 65535 leaves it unchanged."""
    if not _accepts_override(fleet, craft, partner):
        return
    for channel in range(CHANNELS):
        value = getattr(message, f"chan{channel + 1}_raw")
        if value != _IGNORED:
            _set_override(fleet, craft, channel, value)
    _update_overrides(fleet, craft, causes)


def on_manual_control(fleet: Fleet, craft: Craft, message: Any, partner: tuple[int, int], causes: Causes) -> None:
    """MANUAL_CONTROL: x forward, y right and r -1000…1000, z 0…1000, not negative. 32767 releases an axis."""
    if message.target != craft.system_id or not _accepts_override(fleet, craft, partner) or message.z < 0:
        return
    axes = ((message.y, 1000, 2000), (-message.x, 1000, 2000), (message.z, 0, 1000), (message.r, 1000, 2000))
    for channel, (value, offset, scale) in enumerate(axes):
        us = MIN_US + (MAX_US - MIN_US) * (value + offset) // scale
        _set_override(fleet, craft, channel, 0 if abs(value) == _UNSET else us)
    _update_overrides(fleet, craft, causes)


def _accepts_override(fleet: Fleet, craft: Craft, partner: tuple[int, int]) -> bool:
    """Whether overrides of this sender count: only SYSID_MYGCS may move the sticks.

    For the failsafe they count as heartbeats.
    """
    if partner[0] != int(fleet.param(craft, "SYSID_MYGCS")):
        return False
    ground_station.seen(fleet, craft)
    return fleet.param(craft, "RC_OVERRIDE_TIME") != 0.0


def _set_override(fleet: Fleet, craft: Craft, channel: int, us: int) -> None:
    if us == 0:
        craft.overrides.pop(channel, None)
    else:
        craft.overrides[channel] = (us, fleet.now)


def on_timer(fleet: Fleet, craft: Craft) -> None:
    """Release overrides that were not repeated for RC_OVERRIDE_TIME."""
    _update_overrides(fleet, craft, ())


def _update_overrides(fleet: Fleet, craft: Craft, causes: Causes) -> None:
    """Drop expired overrides and update the sticks."""
    holds_s = fleet.param(craft, "RC_OVERRIDE_TIME")
    end = NEVER
    if holds_s >= 0.0:
        for channel, (_, since) in list(craft.overrides.items()):
            until = since + from_seconds(holds_s)
            if until <= fleet.now:
                del craft.overrides[channel]
            else:
                end = min(end, until)
    fleet.timer(craft, Timer.STICKS, end)
    sticks_in.place(fleet, craft)
    if sticks_in.throttle(fleet, craft) > 0.0 and fleet.armed(craft):
        if causes:
            craft.target_causes = causes
        if not craft.ready:  # a raised throttle allows AUTO to leave the ground (update_auto_armed)
            craft.ready = True
            navigator.update(fleet, craft)
