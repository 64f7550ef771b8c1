"""State of all bodies of a world: one table of arrays, which all kernels of the world read and write.

numba takes some 10 µs to find the type of a named tuple of this size, and of a plain one two. So what is called in
every tick takes the arrays as a plain tuple, `BodyArrays`, and names them again in compiled code.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Marks = NDArray[np.uint8]


BodyArrays = tuple[Any, ...]
"""The fields of a `BodyState` in their order."""


class BodyState(NamedTuple):
    """The arrays of n bodies. Local frame east-north-up, body frame forward-left-up, SI units."""

    # what does not change
    parameters: Floats
    """(airframes, numbers): `multirotor.parameter_row`."""
    batteries: Floats
    """(airframes, numbers): `battery.battery_row`."""
    shape: Floats
    """(airframes, numbers): `broad_phase.shape_row`."""
    airframe: Ints
    """(n,) rows of these tables."""
    run: Ints
    """(n,) the run of a batch that each belongs to: 0… in ascending order."""
    expo: Floats
    """(n, motors) thrust curves, as the next two of `multirotor.motor_rows`."""
    lag_up: Floats
    lag_down: Floats
    # what acts on a body
    air: Floats
    """(n, 3) the air's velocity at each."""
    floor: Floats
    """(n,) height of what is below it."""
    commands: Floats
    """(n, motors) 0…1."""
    alive: Marks
    """(n, motors) 0 where a motor is lost."""
    speed_share: Floats
    """(n, motors) 0…1 of a sound motor's speed."""
    limit: Floats
    """(n, motors) a rotor's speed at full command, rad/s."""
    is_imposed: Marks
    """(n,) `multirotor.IMPOSED` if an engine imposes the pose: nothing pushes such a body; `SIMULATED`; or 0."""
    # motion
    before: Floats
    """(n, 3) positions before the last quantum."""
    position: Floats
    """(n, 3) of the gear."""
    velocity: Floats
    attitude: Floats
    """(n, 4) body to local."""
    rates: Floats
    """(n, 3) in the body frame, as `accel`."""
    accel: Floats
    """(n, 3) specific force."""
    rotor_radps: Floats
    """(n, motors)."""
    height: Floats
    """(n,) above the floor."""
    flags: Marks
    """(n, 4): columns `multirotor.ALOFT` to `EVENTS`."""
    impact_mps: Floats
    """(n,) speed of the last touchdown."""
    odometer_m: Floats
    """(n,) an upper bound of the distance moved: the sum over the axes, which needs no root."""
    max_step2_m2: Floats
    """(runs,) square of the longest distance that any aircraft of a run moved in the last quantum."""
    impulse: Floats
    """(n, 6) impulses for the simulator, in the local frame: linear, and angular about the centre of gravity."""
    # batteries
    work_j: Floats
    """(n,) the rotors' work against the air since the last discharge."""
    charge: Floats
    """(n,) 0…1."""
    battery_v: Floats
    battery_a: Floats
