"""Values of ArduPilot's JSON physics backend: the motion that goes in, and the pulse widths that come out.

libraries/SITL/SIM_JSON.cpp. The local frame is north-east-down from home, the body frame forward-right-down.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.components import Floats, Sensors
from skyrange.core.compiled import compiled
from skyrange.world.airframes import MOTORS

PWM_MIN: Final = 1000.0
PWM_RANGE: Final = 1000.0
"""MOT_PWM_MIN, and the difference to MOT_PWM_MAX, as in ArduCopter."""
_ROOT: Final = math.sqrt(0.5)
_GYRO, _FORCE, _DOWN, _ATTITUDE, _RANGE = 0, 3, 6, 7, 11
"""Column of each quantity in a row of `Motion`."""
WIDTH: Final = 12
"""Length of a row without the battery."""
BATTERY_WIDTH: Final = WIDTH + 2
"""Length of a row with it."""


class Motion:
    """What inertial sensors, barometer and rangefinder measure, in ArduPilot's frames: one row per aircraft."""

    __slots__ = ("rows",)

    def __init__(self, rows: Floats) -> None:
        """`rows` (n, 12), in the order of the properties below; or (n, 14), then voltage in V and current in A."""
        self.rows = rows

    @property
    def gyro_radps(self) -> Floats:
        """(n, 3)"""
        return self.rows[:, _GYRO:_FORCE]

    @property
    def accel_mps2(self) -> Floats:
        """(n, 3) specific force: (0, 0, -9.8) at rest and level."""
        return self.rows[:, _FORCE:_DOWN]

    @property
    def down_m(self) -> Floats:
        """(n,) below home, by the barometer."""
        return self.rows[:, _DOWN]

    @property
    def attitude(self) -> Floats:
        """(n, 4) quaternion w, x, y, z, body to north-east-down."""
        return self.rows[:, _ATTITUDE:_RANGE]

    @property
    def range_m(self) -> Floats:
        """(n,) above the ground below."""
        return self.rows[:, _RANGE]


STANDING: Final = Motion(np.array([[0.0, 0.0, 0.0, 0.0, 0.0, -9.80665, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0]]))
"""One aircraft that stands level at home, heading north."""


def to_ardupilot_motion(sensors: Sensors, home_up_m: Floats, *, battery: bool = False) -> Motion:
    """Convert sensor readings to ArduPilot's frames. ArduPilot derives its compass from the true attitude.

    With `battery` the rows have its voltage and current too.
    """
    rows = np.empty((len(home_up_m), BATTERY_WIDTH if battery else WIDTH))
    if battery:
        rows[:, WIDTH], rows[:, WIDTH + 1] = sensors.battery_v, sensors.battery_a
    _to_ned(
        sensors.gyro_radps, sensors.accel_mps2, sensors.baro_up_m, sensors.attitude, sensors.rangefinder_m, home_up_m,
        rows,
    )  # fmt: skip
    return Motion(rows)


@compiled
def _to_ned(  # noqa: PLR0917
    gyro: Floats, force: Floats, baro_up: Floats, attitude: Floats, above: Floats, home_up: Floats, rows: Floats
) -> None:
    for i in range(len(rows)):
        # forward-left-up to forward-right-down
        rows[i, 0], rows[i, 1], rows[i, 2] = gyro[i, 0], -gyro[i, 1], -gyro[i, 2]
        rows[i, 3], rows[i, 4], rows[i, 5] = force[i, 0], -force[i, 1], -force[i, 2]
        rows[i, 6] = home_up[i] - baro_up[i]
        # q' = (0, √½, √½, 0) · q · (0, 1, 0, 0): east-north-up to north-east-down, and the body's half turn
        w, x, y, z = attitude[i, 0], attitude[i, 1], attitude[i, 2], attitude[i, 3]
        rows[i, 7] = -_ROOT * (w + z)
        rows[i, 8] = -_ROOT * (x + y)
        rows[i, 9] = _ROOT * (y - x)
        rows[i, 10] = _ROOT * (z - w)
        rows[i, 11] = above[i]


@compiled
def interpolate(before: Floats, after: Floats, share: float, row: Floats) -> None:
    """Write to `row` the motion that is `share` of the way from one row to the next.

    The specific force is not interpolated, because it is already the mean over the interval; nor are range and battery.
    """
    along = 0.0
    for k in range(_ATTITUDE, _RANGE):
        along += before[k] * after[k]
    sign = -1.0 if along < 0.0 else 1.0  # both signs are the same attitude
    for k in range(WIDTH):
        row[k] = before[k] * (sign if _ATTITUDE <= k < _RANGE else 1.0) * (1.0 - share) + after[k] * share
    row[3], row[4], row[5] = after[3], after[4], after[5]
    for k in range(_RANGE, len(row)):
        row[k] = after[k]
    square = 0.0
    for k in range(_ATTITUDE, _RANGE):
        square += row[k] * row[k]
    for k in range(_ATTITUDE, _RANGE):
        row[k] /= math.sqrt(square)


class MeanForce:
    """Mean specific force since each aircraft's last exchange, for those that skip some ticks."""

    def __init__(self, count: int) -> None:
        """Of `count` aircraft."""
        self._sum, self._ticks = np.zeros((count, 3)), np.zeros((count, 1))

    def add(self, force_mps2: Floats) -> None:
        """Add the specific forces of a tick: (n, 3), forward-left-up as from the sensors."""
        _add_force(force_mps2, self._sum, self._ticks)

    def apply(self, motion: Motion, due: NDArray[np.int64]) -> None:
        """Replace the last tick's values by the means; the sums of the rows that are `due` start anew."""
        _mean(self._sum, self._ticks, due, motion.rows)


@compiled
def _add_force(force: Floats, total: Floats, ticks: Floats) -> None:
    for i in range(len(force)):
        for k in range(3):
            total[i, k] += force[i, k]
        ticks[i, 0] += 1.0


@compiled
def _mean(total: Floats, ticks: Floats, due: NDArray[np.int64], rows: Floats) -> None:
    for i in range(len(rows)):
        # forward-left-up to forward-right-down
        rows[i, 3] = total[i, 0] / ticks[i, 0]
        rows[i, 4] = -(total[i, 1] / ticks[i, 0])
        rows[i, 5] = -(total[i, 2] / ticks[i, 0])
    for i in due:
        total[i, 0] = total[i, 1] = total[i, 2] = ticks[i, 0] = 0.0


@compiled
def step_time_s(step: int, step_ns: int) -> float:
    """The time of a step since the start, slightly increased, because ArduPilot truncates to microseconds."""
    return step * step_ns * 1e-9 * (1.0 + 1e-7)


@compiled
def read_commands(
    answers: NDArray[np.uint8], last: NDArray[np.int64], rows: NDArray[np.int64], commands: Floats
) -> None:
    """Write to `commands` (n, motors) what each of `rows` answered: of its answers (k, n, bytes) the one at `last`
    (n,).

    Commands are 0…1, motors in ArduCopter's order; 0 µs is no pulse.
    """
    for i in rows:
        for m in range(MOTORS):
            width = np.int64(answers[last[i], i, 2 * m]) | np.int64(answers[last[i], i, 2 * m + 1]) << 8
            commands[i, m] = min(max((width - PWM_MIN) / PWM_RANGE, 0.0), 1.0)
