"""Auxiliary functions of DO_AUX_FUNCTION: changes of mode, fence and disarming by a mission.

After libraries/RC_Channel/RC_Channel.cpp `do_aux_function` and RC_Channel_Copter.cpp `do_aux_function_change_mode`. The
low position of a mode's function returns to the mode of the pilot's switch, which is not fitted here. ArduCopter runs
the function before it starts the navigation command that follows; here it runs after that, at the same time.
"""

from __future__ import annotations

from typing import Final

from skyrange.vehicle.builtin.arming.arming import disarm
from skyrange.vehicle.builtin.fence import fence
from skyrange.vehicle.builtin.fleet import Causes, Fleet, Vehicle
from skyrange.vehicle.builtin.mission.stored_commands import (
    ARM_DISARM_FUNCTION,
    DISARM_FUNCTION,
    FENCE_FUNCTION,
    MODE_FUNCTIONS,
)
from skyrange.vehicle.builtin.mode_change import set_mode

_LOW: Final = 0
_HIGH: Final = 2
"""RC_Channel::AuxSwitchPos; a position beyond HIGH has no effect."""


def run_pending(fleet: Fleet) -> None:
    """Run the functions that missions have triggered in this tick, in the order of the fleet."""
    for vehicle in fleet.vehicles:
        while vehicle.aux_functions:
            _run(fleet, vehicle, *vehicle.aux_functions.pop(0))
    fleet.aux_pending = False


def _run(fleet: Fleet, vehicle: Vehicle, function: int, position: int, causes: Causes) -> None:
    if position > _HIGH:
        return
    if function in MODE_FUNCTIONS and position == _HIGH:
        set_mode(fleet, vehicle, MODE_FUNCTIONS[function], "aux_function", causes)
    elif function == FENCE_FUNCTION:
        fence.handle_do_fence_enable(fleet, vehicle, int(position == _HIGH), 0)
    elif (function, position) in ((DISARM_FUNCTION, _HIGH), (ARM_DISARM_FUNCTION, _LOW)) and fleet.armed(vehicle):
        disarm(fleet, vehicle, "aux_switch", causes)
