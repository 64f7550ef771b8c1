"""Link budget: the power that arrives at a radio from another one, and the search for radios in range."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.medium import Floats, Ints
from skyrange.core.compiled import compiled
from skyrange.radio.propagation.fading import cell_of, cell_side_m, coherence_ns, fade_db, pair_of, shadow_db
from skyrange.radio.propagation.loss_table import LossTable, table_loss_db
from skyrange.radio.propagation.obstruction import BLOCKED, Obstacles, obstruction_db
from skyrange.radio.propagation.path_loss import dipole_dbi, ground_excess_db, open_ground_db, wavelength_m

NO_SIGNAL: Final = -math.inf
NLOS_LOSS_DB: Final = 6.0
"""A path counts as without line of sight from this loss on: an edge exactly on the line costs 6 dB."""
BUCKET_SIDE_M: Final = 400.0


class MediumParams(NamedTuple):
    """Parameters of the whole medium, as kernels take them."""

    seed: np.uint64
    horizon_m: float
    randomness: bool
    """Whether there is shadowing and fading."""
    background_share: float
    """Background traffic: share of time, and its mean power at any receiver."""
    background_mean_mw: float
    every_pair: bool
    tabled: bool
    """Whether there is a loss table."""
    table: LossTable
    """Losses that replace those of open ground and buildings where it covers both positions."""
    capture_db: float = math.inf
    """Margin of frame capture; infinite without it. This and what follows is for the builtin medium alone."""
    strongest_preamble: bool = True
    """Whether a Wi-Fi receiver locks on the strongest of the frames that begin within aCCATime, not on the first."""
    eifs: bool = True
    """Whether Wi-Fi senders wait for EIFS after errors."""


@compiled
def tabled_loss_db(
    table: LossTable, ax: float, ay: float, az: float, bx: float, by: float, bz: float, distance: float,
    wavelength: float,
) -> float:  # fmt: skip
    """Loss that a table gives on top of `path_loss.open_ground_db`, negative if it is less; NaN where it gives none."""
    loss = table_loss_db(table, ax, ay, az, bx, by, bz, distance, wavelength)
    return loss - open_ground_db(distance, az, bz, wavelength)


@compiled
def median_power_dbm(
    power_dbm: float, distance: float, az: float, bz: float, wavelength: float, pattern_a: float, gain_a: float,
    pattern_b: float, gain_b: float,
) -> float:  # fmt: skip
    """Median power at the receiver's input without obstructions. Scalars only, as in `random_gain_db`, because it is
    called often.
    """
    sine = (bz - az) / distance if distance > 0.0 else 0.0
    mean = power_dbm + gain_a + gain_b - open_ground_db(distance, az, bz, wavelength)
    if pattern_a == 1.0:
        mean += dipole_dbi(sine)
    if pattern_b == 1.0:
        mean += dipole_dbi(-sine)
    return mean


@compiled
def random_gain_db(
    seed: np.uint64, who_a: np.uint64, who_b: np.uint64, ax: float, ay: float, az: float, bx: float, by: float,
    bz: float, speed_mps: float, wavelength: float, centre: float, time_ns: int, loss_db: float,
) -> float:  # fmt: skip
    """What shadowing and fading add for two radios at two positions, in dB."""
    hidden = loss_db >= NLOS_LOSS_DB
    pair = pair_of(who_a, who_b)
    side = cell_side_m(hidden)
    near, far = cell_of(ax, ay, az, side), cell_of(bx, by, bz, side)
    if who_b < who_a:
        near, far = far, near
    shadow = shadow_db(seed, pair, near, far, max(min(az, bz), 0.0), hidden)
    return shadow + fade_db(seed, pair, time_ns, coherence_ns(speed_mps, wavelength), centre, hidden)


@compiled
def received_power_dbm(
    params: MediumParams,
    obstacles: Obstacles,
    who: NDArray[np.uint64],
    antenna: Floats,
    pos: Floats,
    vel: Floats,
    sender: int,
    receiver: int,
    power_dbm: float,
    centre: float,
    time_ns: int,
    floor_dbm: float,
) -> float:
    """Power at the receiver's input; `NO_SIGNAL` if its median is below `floor_dbm`, or if a radio has no position."""
    ax, ay, az = pos[sender, 0], pos[sender, 1], pos[sender, 2]
    bx, by, bz = pos[receiver, 0], pos[receiver, 1], pos[receiver, 2]
    dx, dy, dz = bx - ax, by - ay, bz - az
    distance = math.sqrt(dx * dx + dy * dy + dz * dz)
    if not distance <= params.horizon_m:  # true for NaN as well
        return NO_SIGNAL
    wavelength = wavelength_m(centre)
    mean = median_power_dbm(
        power_dbm, distance, az, bz, wavelength, antenna[sender, 0], antenna[sender, 1], antenna[receiver, 0],
        antenna[receiver, 1],
    )  # fmt: skip
    loss = math.nan
    if params.tabled:
        loss = tabled_loss_db(params.table, ax, ay, az, bx, by, bz, distance, wavelength)
    if loss == loss:
        if mean - loss < floor_dbm:
            return NO_SIGNAL
    else:
        if mean + ground_excess_db(distance, az, bz, wavelength) < floor_dbm:  # a street may guide it as in free space
            return NO_SIGNAL
        loss = obstruction_db(obstacles, ax, ay, az, bx, by, bz, wavelength, mean - floor_dbm)
        if loss == BLOCKED:
            return NO_SIGNAL
    mean -= loss
    if params.randomness:
        ux = vel[receiver, 0] - vel[sender, 0]
        uy = vel[receiver, 1] - vel[sender, 1]
        uz = vel[receiver, 2] - vel[sender, 2]
        speed = math.sqrt(ux * ux + uy * uy + uz * uz)
        mean += random_gain_db(
            params.seed, who[sender], who[receiver], ax, ay, az, bx, by, bz, speed, wavelength, centre, time_ns, loss
        )
    return mean


@compiled
def max_range_m(best_dbi: float, power_dbm: float, floor_dbm: float, centre: float) -> float:
    """The distance at which a signal falls to a floor in free space between the best antennas."""
    budget = power_dbm + 2.0 * max(best_dbi, 0.0) - floor_dbm
    return float(wavelength_m(centre) / (4.0 * math.pi) * 10.0 ** (0.05 * budget))


@compiled
def bucket_of(column: int, row: int, mask: int) -> int:
    """The hash bucket that lists the radios of a square of the plane."""
    return (column * 73856093 ^ row * 19349663) & mask


@compiled
def index_positions(head: Ints, follow: Ints, pos: Floats) -> None:
    """List all radios by position: the first of each bucket in `head` (a power of two of them), the
    next in `follow`.
    """
    head[:] = -1
    mask = head.shape[0] - 1
    for i in range(pos.shape[0] - 1, -1, -1):
        x, y = pos[i, 0] / BUCKET_SIDE_M, pos[i, 1] / BUCKET_SIDE_M
        if not (abs(x) < 1e9 and abs(y) < 1e9):
            continue
        place = bucket_of(math.floor(x), math.floor(y), mask)
        follow[i] = head[place]
        head[place] = i
