"""Battery model: charge, voltage under load, and the rotor speed that the voltage allows, in one kernel.

A resting voltage that depends on charge, in series with a resistance. The resting voltage is ArduPilot's table of a
lithium polymer cell (libraries/SITL/SIM_Battery.cpp, `soc_table`). The load is electrical power: the rotors'
aerodynamic power (torque times speed) divided by the efficiency of motors and controllers, plus the avionics. With E
the resting voltage and R the resistance, P = V·I and V = E - R·I give V = (E + √(E² - 4·R·P)) / 2, and at most the
power E²/4R.

A rotor's speed at full command is proportional to the voltage, as in ArduPilot's SIM_Motor.cpp (`voltage_scale`): the
table of airframes gives it at 3.7 V per cell. An empty battery stops the motors and stays empty. Left out:
temperature, ageing, recovery after load, and the rotors' own inertia.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.core.compiled import compiled
from skyrange.world.airframes import MOTORS, Airframe
from skyrange.world.body_state import BodyState, Floats, Marks

BATTERY_NS = 10_000_000
"""Interval at which voltage and charge are computed: as often as an autopilot reads them."""
RATED_V = 3.7
"""Per cell: a lithium polymer cell's nominal voltage, at which `Airframe.rotor_max_radps` holds."""

RESTING: Final = np.array(
    [
        (0.00, 0.001), (0.0001, 0.01), (0.002, 0.3), (0.004, 0.6), (0.006, 1.0), (0.007, 1.3), (0.008, 1.6),
        (0.009, 1.9), (0.010, 2.1), (0.011, 2.3), (0.012, 2.5), (0.013, 2.7), (0.015, 2.8), (0.020, 2.977),
        (0.0385, 3.091), (0.0769, 3.165), (0.1154, 3.218), (0.1538, 3.296), (0.1923, 3.379), (0.2308, 3.462),
        (0.2692, 3.503), (0.3077, 3.543), (0.3462, 3.588), (0.3846, 3.636), (0.4231, 3.679), (0.4615, 3.715),
        (0.5000, 3.742), (0.5385, 3.783), (0.5769, 3.801), (0.6154, 3.833), (0.6538, 3.854), (0.6923, 3.887),
        (0.7308, 3.908), (0.7692, 3.943), (0.8077, 3.987), (0.8462, 4.039), (0.8846, 4.071), (0.9231, 4.085),
        (0.9615, 4.112), (1.0000, 4.173),
    ]
)  # fmt: skip
"""(charge 0…1, volts of a resting cell)."""

_COULOMB, _CELLS, _OHM, _AVIONICS_W, _PER_EFFICIENCY, _RADPS_PER_V = range(6)


def battery_row(airframe: Airframe) -> list[float]:
    """An airframe's numbers as the kernel reads them."""
    return [
        3600.0 * airframe.capacity_ah,
        float(airframe.cells),
        airframe.resistance_ohm,
        airframe.avionics_w,
        1.0 / airframe.drive_efficiency,
        airframe.rotor_max_radps / (RATED_V * airframe.cells),
    ]


@compiled
def resting_v(charge: float) -> float:
    """Voltage of a resting cell, linear between the table's rows."""
    row = RESTING.shape[0] - 2
    while row > 0 and RESTING[row, 0] > charge:
        row -= 1
    share = (charge - RESTING[row, 0]) / (RESTING[row + 1, 0] - RESTING[row, 0])
    volts: float = RESTING[row, 1] + share * (RESTING[row + 1, 1] - RESTING[row, 1])
    return volts


@compiled
def discharge(step_s: float, bodies: BodyState) -> None:
    """Subtract the energy of the last `step_s` seconds (0 only reads), and compute the rotor speeds at full command.

    `work_j` is used and cleared; `charge`, `battery_v`, `battery_a` and `limit` are computed.
    """
    charge, volts, amperes, work_j = bodies.charge, bodies.battery_v, bodies.battery_a, bodies.work_j
    for i in range(charge.shape[0]):
        p = bodies.batteries[bodies.airframe[i]]
        power = p[_AVIONICS_W]
        if step_s > 0.0:
            power += work_j[i] * p[_PER_EFFICIENCY] / step_s
        work_j[i] = 0.0
        rest = p[_CELLS] * resting_v(charge[i])
        full = 0.0
        if charge[i] > 0.0:
            under = rest * rest - 4.0 * p[_OHM] * power
            volts[i] = 0.5 * (rest + math.sqrt(max(under, 0.0)))
            amperes[i] = min(power / volts[i], 0.5 * rest / p[_OHM])
            charge[i] = max(charge[i] - amperes[i] * step_s / p[_COULOMB], 0.0)
            full = p[_RADPS_PER_V] * volts[i]
        if charge[i] == 0.0:
            volts[i] = amperes[i] = full = 0.0
        for m in range(MOTORS):
            bodies.limit[i, m] = full * bodies.alive[i, m] * bodies.speed_share[i, m]


def speed_limits(parameters: Floats, alive: Marks, speed_share: Floats, volts: Floats) -> NDArray[np.float64]:
    """The rotor speeds at full command (n, motors) in rad/s that `discharge` computes, of batteries at `volts` (n,).

    `parameters` (n, numbers) are those of each aircraft, the other arguments as there.
    """
    full = parameters[:, _RADPS_PER_V] * volts
    return full[:, np.newaxis] * alive * speed_share
