"""Link budget: the power that arrives at a radio from another one, and at all radios in reach."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.medium import Floats, Ints
from skyrange.core import elementary
from skyrange.core.compiled import compiled
from skyrange.radio.propagation.fading import (
    cell_of,
    cell_side_m,
    coherence_ns,
    fade_db,
    fade_draws,
    pair_of,
    shadow_db,
)
from skyrange.radio.propagation.loss_table import LossTable, table_loss_db
from skyrange.radio.propagation.obstruction import Obstacles, stop_threshold, trace_line, traced_loss_db
from skyrange.radio.propagation.path_loss import (
    CLEAR_NU,
    dipole_dbi,
    ground_excess_db,
    knife_edge_db,
    open_ground_db,
    wavelength_m,
)
from skyrange.radio.propagation.street_canyon import UNKNOWN

NO_SIGNAL: Final = -math.inf
NLOS_LOSS_DB: Final = 6.0
"""A path counts as without line of sight from this loss on: an edge exactly on the line costs 6 dB."""
MAX_RANDOM_GAIN_DB: Final = 30.0
"""Shadowing and fading together add at most this. Without line of sight they exceed it once in 6,000 draws."""
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
def tabled_loss_db(  # noqa: PLR0917
    table: LossTable, ax: float, ay: float, az: float, bx: float, by: float, bz: float, distance: float,
    wavelength: float,
) -> float:  # fmt: skip
    """Loss that a table gives on top of `path_loss.open_ground_db`, negative if it is less; NaN where it gives none."""
    loss = table_loss_db(table, ax, ay, az, bx, by, bz, distance, wavelength)
    return loss - open_ground_db(distance, az, bz, wavelength)


@compiled
def median_power_dbm(  # noqa: PLR0917
    power_dbm: float, distance: float, az: float, bz: float, wavelength: float, pattern_a: float, gain_a: float,
    pattern_b: float, gain_b: float,
) -> float:  # fmt: skip
    """Median power at the receiver's input without obstructions. Scalars only, as in `random_gain_db`, because it is
    called often.
    """
    sine = (bz - az) / distance if distance > 0.0 else 0.0
    mean = power_dbm + gain_a + gain_b - open_ground_db(distance, az, bz, wavelength)
    if pattern_a == 1.0 or pattern_b == 1.0:
        mean += (pattern_a + pattern_b) * dipole_dbi(sine)  # the same upwards and downwards
    return mean


@compiled
def random_gain_db(  # noqa: PLR0917
    seed: np.uint64, who_a: np.uint64, who_b: np.uint64, ax: float, ay: float, az: float, bx: float, by: float,
    bz: float, fade: tuple[float, float], hidden: bool,  # noqa: FBT001
) -> float:  # fmt: skip
    """What shadowing and fading add for two radios at two positions, in dB, at most `MAX_RANDOM_GAIN_DB`.

    `fade` are the pair's `fade_draws`; `hidden`: without line of sight, that is, with a loss of at least
    `NLOS_LOSS_DB`.
    """
    side = cell_side_m(hidden)
    near, far = cell_of(ax, ay, az, side), cell_of(bx, by, bz, side)
    if who_b < who_a:
        near, far = far, near
    shadow = shadow_db(seed, pair_of(who_a, who_b), near, far, max(min(az, bz), 0.0), hidden)
    return min(shadow + fade_db(fade, hidden), MAX_RANDOM_GAIN_DB)


@compiled
def path_power_dbm(  # noqa: PLR0917
    obstacles: Obstacles, seed: np.uint64, randomness: bool, who_a: np.uint64, who_b: np.uint64, ax: float, ay: float,  # noqa: FBT001
    az: float, bx: float, by: float, bz: float, speed_mps: float, wavelength: float, centre: float, time_ns: int,
    median_dbm: float, tabled_db: float, guiding_db: float, floor_dbm: float, street_a: int,
) -> float:  # fmt: skip
    """Power that shadowing, fading and buildings make of a median over open ground; `NO_SIGNAL` if below `floor_dbm`.

    `tabled_db` is a loss that replaces that of buildings, or NaN; `guiding_db` is the most that a street may add.
    Shadowing and fading are drawn first, because that is faster than tracing the line, which is then traced only as far
    as it matters. `speed_mps` is that of one end against the other, `street_a` as in
    `street_excess_by_place_db`.
    """
    covered = tabled_db == tabled_db
    power = median_dbm - tabled_db if covered else median_dbm + guiding_db
    if power + (MAX_RANDOM_GAIN_DB if randomness else 0.0) < floor_dbm:
        return NO_SIGNAL
    hidden = clear = median_dbm
    fade = (0.0, 0.0)
    if randomness:
        fade = fade_draws(seed, pair_of(who_a, who_b), time_ns, coherence_ns(speed_mps, wavelength), centre)
        if not tabled_db < NLOS_LOSS_DB:
            hidden += random_gain_db(seed, who_a, who_b, ax, ay, az, bx, by, bz, fade, hidden=True)
    loss = tabled_db
    margin = hidden - floor_dbm
    drawn = not randomness
    if not covered:
        if margin < NLOS_LOSS_DB:  # it can only be received with line of sight
            if randomness:
                clear += random_gain_db(seed, who_a, who_b, ax, ay, az, bx, by, bz, fade, hidden=False)
            drawn = True
            margin = min(clear - floor_dbm, NLOS_LOSS_DB)
            if margin + guiding_db < 0.0:
                return NO_SIGNAL
        stop = stop_threshold(elementary.exp10(0.05 * margin), ax, ay, bx, by, wavelength)
        met = trace_line(obstacles, ax, ay, az, bx, by, bz, wavelength, stop)
        loss = 0.0
        if met.blocking > 0 or guiding_db > 0.0:
            loss = traced_loss_db(obstacles, met, ax, ay, az, bx, by, bz, wavelength, margin, street_a)
        elif met.grazing_nu > CLEAR_NU:
            loss = knife_edge_db(met.grazing_nu)
    if loss >= NLOS_LOSS_DB:
        power = hidden - loss
    else:
        if not drawn:
            clear += random_gain_db(seed, who_a, who_b, ax, ay, az, bx, by, bz, fade, hidden=False)
        power = clear - loss
    return power if power >= floor_dbm else NO_SIGNAL


@compiled
def received_power_dbm(  # noqa: PLR0917
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
    """Power at the receiver's input; `NO_SIGNAL` if it is below `floor_dbm`, or if a radio has no position."""
    ax, ay, az = pos[sender, 0], pos[sender, 1], pos[sender, 2]
    bx, by, bz = pos[receiver, 0], pos[receiver, 1], pos[receiver, 2]
    dx, dy, dz = bx - ax, by - ay, bz - az
    distance = math.sqrt(dx * dx + dy * dy + dz * dz)
    if not distance <= params.horizon_m:  # true for NaN as well
        return NO_SIGNAL
    wavelength = wavelength_m(centre)
    median = median_power_dbm(
        power_dbm, distance, az, bz, wavelength, antenna[sender, 0], antenna[sender, 1], antenna[receiver, 0],
        antenna[receiver, 1],
    )  # fmt: skip
    tabled = math.nan
    if params.tabled:
        tabled = tabled_loss_db(params.table, ax, ay, az, bx, by, bz, distance, wavelength)
    ux = vel[receiver, 0] - vel[sender, 0]
    uy = vel[receiver, 1] - vel[sender, 1]
    uz = vel[receiver, 2] - vel[sender, 2]
    return path_power_dbm(
        obstacles, params.seed, params.randomness, who[sender], who[receiver], ax, ay, az, bx, by, bz,
        math.sqrt(ux * ux + uy * uy + uz * uz), wavelength, centre, time_ns, median, tabled,
        ground_excess_db(distance, az, bz, wavelength), floor_dbm, UNKNOWN,
    )  # fmt: skip


@compiled
def max_range_m(best_dbi: float, power_dbm: float, floor_dbm: float, centre: float) -> float:
    """The distance at which a signal falls to a floor in free space between the best antennas."""
    budget = power_dbm + 2.0 * max(best_dbi, 0.0) - floor_dbm
    return float(wavelength_m(centre) / (4.0 * math.pi) * elementary.exp10(0.05 * budget))


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


class IndexedRadios(NamedTuple):
    """Radios, and the index of their positions."""

    who: NDArray[np.uint64]
    """(n,) hashes of their names."""
    antenna: Floats
    """(n, 2) pattern and gain in dBi."""
    best_dbi: float
    """The highest gain of any antenna."""
    pos: Floats
    """(n, 3) m."""
    vel: Floats
    """(n, 3) m/s."""
    head: Ints
    follow: Ints
    """The index that `index_positions` made of `pos`."""


@compiled
def append_received_powers(  # noqa: PLR0917
    params: MediumParams,
    obstacles: Obstacles,
    radios: IndexedRadios,
    sender: int,
    power_dbm: float,
    centre: float,
    time_ns: int,
    floor_dbm: float,
    rows: Ints,
    dbm: Floats,
    count: int,
) -> int:
    """Append the rows of all radios that one sender reaches, ascending, and the power at each; returns the new count.

    `power_dbm` goes into the sender's antenna, `centre` is in MHz, `time_ns` addresses the fading. `rows` and `dbm` are
    written from `count` on and need room for all n radios there.

    A radio is left out if its power is below `floor_dbm`, if it is farther than the horizon, or if it has no position.
    """
    who, antenna, best_dbi, pos, vel, head, follow = radios
    least = floor_dbm - params.table.best_gain_db  # the losses of a table may be less than those of free space
    if params.randomness:
        least -= MAX_RANDOM_GAIN_DB
    reach = min(max_range_m(best_dbi, power_dbm, least, centre), params.horizon_m)
    reach *= 1.0 + 1e-9  # the decision is that of `received_power_dbm`, whose roundings differ
    x, y, z = pos[sender, 0], pos[sender, 1], pos[sender, 2]
    if not (abs(x) < 1e9 and abs(y) < 1e9 and abs(z) < 1e9):  # true for NaN as well
        return count
    mask = head.shape[0] - 1
    end = count
    column0, column1 = math.floor((x - reach) / BUCKET_SIDE_M), math.floor((x + reach) / BUCKET_SIDE_M)
    row0, row1 = math.floor((y - reach) / BUCKET_SIDE_M), math.floor((y + reach) / BUCKET_SIDE_M)
    for column in range(column0, column1 + 1):
        for row in range(row0, row1 + 1):
            i = head[bucket_of(column, row, mask)]
            while i >= 0:
                ex, ey, ez = pos[i, 0] - x, pos[i, 1] - y, pos[i, 2] - z
                if (
                    i != sender
                    and ex * ex + ey * ey + ez * ez <= reach * reach
                    and math.floor(pos[i, 0] / BUCKET_SIDE_M) == column
                    and math.floor(pos[i, 1] / BUCKET_SIDE_M) == row
                ):
                    rows[end] = i
                    end += 1
                i = follow[i]
    rows[count:end].sort()
    for k in range(count, end):
        receiver = rows[k]
        power = received_power_dbm(
            params, obstacles, who, antenna, pos, vel, sender, receiver, power_dbm, centre, time_ns, floor_dbm
        )
        if power != NO_SIGNAL:
            rows[count], dbm[count] = receiver, power
            count += 1
    return count
