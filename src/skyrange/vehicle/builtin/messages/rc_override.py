"""RC overrides: RC_CHANNELS_OVERRIDE and MANUAL_CONTROL, which move the pilot's sticks.

After libraries/RC_Channel (`get_radio_in` and the overrides) and GCS_Common.cpp (`handle_rc_channels_override`,
`handle_manual_control`, `manual_override`).
"""

from __future__ import annotations

from typing import Any

from skyrange.core.time import NEVER, from_seconds
from skyrange.vehicle.builtin.failsafes import ground_station
from skyrange.vehicle.builtin.fleet import RC_CHANNELS, Causes, Fleet, Timer, Vehicle
from skyrange.vehicle.builtin.mission import execution
from skyrange.vehicle.builtin.pilot import rc_channels
from skyrange.vehicle.builtin.pilot.rc_channels import MAX_US, MIN_US

_IGNORED, _UNSET = 65535, 32767


def on_override(fleet: Fleet, vehicle: Vehicle, message: Any, peer: tuple[int, int], causes: Causes) -> None:
    """RC_CHANNELS_OVERRIDE: microseconds per channel; 0 releases a channel, 65535 leaves it unchanged."""
    if not _accepts_override(fleet, vehicle, peer):
        return
    for channel in range(RC_CHANNELS):
        value = getattr(message, f"chan{channel + 1}_raw")
        if value != _IGNORED:
            _set_override(fleet, vehicle, channel, value)
    _update_overrides(fleet, vehicle, causes)


def on_manual_control(fleet: Fleet, vehicle: Vehicle, message: Any, peer: tuple[int, int], causes: Causes) -> None:
    """MANUAL_CONTROL: x forward, y right and r -1000…1000, z 0…1000, not negative. 32767 releases an axis."""
    if message.target != vehicle.system_id or not _accepts_override(fleet, vehicle, peer) or message.z < 0:
        return
    axes = ((message.y, 1000, 2000), (-message.x, 1000, 2000), (message.z, 0, 1000), (message.r, 1000, 2000))
    for channel, (value, offset, scale) in enumerate(axes):
        us = MIN_US + (MAX_US - MIN_US) * (value + offset) // scale
        _set_override(fleet, vehicle, channel, 0 if abs(value) == _UNSET else us)
    _update_overrides(fleet, vehicle, causes)


def _accepts_override(fleet: Fleet, vehicle: Vehicle, peer: tuple[int, int]) -> bool:
    """Whether overrides of this sender count: only SYSID_MYGCS may move the sticks.

    For the failsafe they count as heartbeats.
    """
    if peer[0] != int(fleet.param(vehicle, "SYSID_MYGCS")):
        return False
    ground_station.mark_seen(fleet, vehicle)
    return fleet.param(vehicle, "RC_OVERRIDE_TIME") != 0.0


def _set_override(fleet: Fleet, vehicle: Vehicle, channel: int, us: int) -> None:
    if us == 0:
        vehicle.rc_overrides.pop(channel, None)
    else:
        vehicle.rc_overrides[channel] = (us, fleet.now)


def on_timer(fleet: Fleet, vehicle: Vehicle) -> None:
    """Release overrides that were not repeated for RC_OVERRIDE_TIME."""
    _update_overrides(fleet, vehicle, ())


def _update_overrides(fleet: Fleet, vehicle: Vehicle, causes: Causes) -> None:
    """Drop expired overrides and update the sticks."""
    holds_s = fleet.param(vehicle, "RC_OVERRIDE_TIME")
    end = NEVER
    if holds_s >= 0.0:
        for channel, (_, since) in list(vehicle.rc_overrides.items()):
            until = since + from_seconds(holds_s)
            if until <= fleet.now:
                del vehicle.rc_overrides[channel]
            else:
                end = min(end, until)
    fleet.set_timer(vehicle, Timer.RC_OVERRIDE, end)
    rc_channels.update_sticks(fleet, vehicle)
    if rc_channels.throttle_input(fleet, vehicle) > 0.0 and fleet.armed(vehicle):
        if causes:
            vehicle.target_causes = causes
        if not vehicle.auto_armed:  # a raised throttle allows AUTO to leave the ground (update_auto_armed)
            vehicle.auto_armed = True
            execution.update(fleet, vehicle)
