"""RC channels: from microseconds per channel to the stick positions of the loop, and the throttle checks of arming.

After libraries/RC_Channel (`pwm_to_range_dz`, `norm_input_dz`) and AP_Arming_Copter.cpp `arm_checks`. Channels range
from 1000 to 2000 µs and are reported at rest while nothing moves them: roll, pitch and yaw in the middle, throttle at
the bottom, switches off. A throttle that nothing moves counts as absent: it is at the bottom for STABILIZE, which
reads it in any case (`get_pilot_desired_throttle`), and requests no climb in other modes (`has_valid_input`,
RC_Channel_Copter.cpp).
"""

from __future__ import annotations

from skyrange.vehicle.builtin.fleet import RC_CHANNELS, Fleet, Vehicle
from skyrange.vehicle.builtin.modes import MANUAL_THROTTLE, Mode
from skyrange.vehicle.builtin.pilot import stick_input

MIN_US, MAX_US = 1000, 2000
_MID_US = 1500
_RESTING_US = (_MID_US, _MID_US, MIN_US, _MID_US, *[MIN_US] * (RC_CHANNELS - 4))
_DEAD_ZONES_US = (20, 20, 30, 20)
"""ArduCopter/radio.cpp `default_dead_zones`."""
_THROTTLE = 2
_ALT_HOLD_MODES = (Mode.ALT_HOLD, Mode.LOITER)


def update_sticks(fleet: Fleet, vehicle: Vehicle) -> None:
    """Update the channels and the stick positions of an aircraft."""
    values = [vehicle.rc_overrides.get(channel, (rest, 0))[0] for channel, rest in enumerate(_RESTING_US)]
    fleet.rc_channels[vehicle.row] = values
    stick = fleet.flight["sticks"][vehicle.row]
    for index, channel in enumerate((0, 1, 3)):
        stick[index] = _norm_input(values[channel], _DEAD_ZONES_US[channel])
    low = MIN_US + _DEAD_ZONES_US[_THROTTLE]
    thousandths = 1000 * (min(max(values[_THROTTLE], MIN_US), MAX_US) - low) // (MAX_US - low)
    stick[3] = max(thousandths, 0) / 1000.0
    if not _has_throttle_input(vehicle) and vehicle.mode in _ALT_HOLD_MODES:
        stick[3] = stick_input.THROTTLE_MID  # no climb is requested (Copter::get_pilot_desired_climb_rate)


def _has_throttle_input(vehicle: Vehicle) -> bool:
    """Whether there is throttle input: without it ArduCopter's `has_valid_input` is false."""
    return _THROTTLE in vehicle.rc_overrides


def throttle_input(fleet: Fleet, vehicle: Vehicle) -> float:
    """Return the throttle stick, 0…1; at the bottom while nothing moves it."""
    return float(fleet.flight["sticks"][vehicle.row, 3]) if _has_throttle_input(vehicle) else 0.0


def _norm_input(us: int, dead_us: int) -> float:
    """Return -1…1 with a dead zone (RC_Channel::norm_input_dz)."""
    low, high = _MID_US - dead_us, _MID_US + dead_us
    if us > high:
        return min((us - high) / (MAX_US - high), 1.0)
    if us < low:
        return max((us - low) / (low - MIN_US), -1.0)
    return 0.0


def throttle_too_high(fleet: Fleet, vehicle: Vehicle) -> bool:
    """Whether the throttle forbids arming (AP_Arming_Copter::arm_checks); GUIDED and AUTO ignore it."""
    if vehicle.mode in (Mode.GUIDED, Mode.AUTO):
        return False
    return throttle_above_mid(fleet, vehicle) or (
        vehicle.mode in MANUAL_THROTTLE and throttle_input(fleet, vehicle) > 0.0
    )


def throttle_above_mid(fleet: Fleet, vehicle: Vehicle) -> bool:
    """Whether the throttle stick is above its middle."""
    row = vehicle.row
    return stick_input.desired_climb_rate(fleet.flight[row], fleet.settings[row]) > 0.0


def manual_thrust(fleet: Fleet, vehicle: Vehicle) -> float:
    """Return the thrust that the throttle stick would give in STABILIZE."""
    if not _has_throttle_input(vehicle):
        return 0.0
    row = vehicle.row
    return float(stick_input.desired_throttle(fleet.flight[row], fleet.settings[row]))
