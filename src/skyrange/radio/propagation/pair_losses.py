"""Received powers from a transmitter, or from many, at all radios in reach.

For users of the propagation model other than the builtin medium. Each value is that of
`link_budget.received_power_dbm` for the pair.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.medium import Floats, Ints
from skyrange.core.compiled import compiled
from skyrange.radio.propagation.link_budget import (
    BUCKET_SIDE_M,
    NO_SIGNAL,
    MediumParams,
    bucket_of,
    max_range_m,
    received_power_dbm,
)
from skyrange.radio.propagation.obstruction import Obstacles
from skyrange.radio.propagation.path_loss import dipole_dbi


@compiled
def best_gain_dbi(antenna: Floats) -> float:
    """The highest gain of any antenna in its best direction, in dBi; at least 0. `antenna` is (n, 2): pattern, gain."""
    best = 0.0
    for i in range(antenna.shape[0]):
        best = max(best, antenna[i, 1] + (dipole_dbi(0.0) if antenna[i, 0] == 1.0 else 0.0))
    return best


@compiled
def append_received_powers(
    params: MediumParams,
    obstacles: Obstacles,
    who: NDArray[np.uint64],
    antenna: Floats,
    pos: Floats,
    vel: Floats,
    head: Ints,
    follow: Ints,
    best_dbi: float,
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

    Arrays are as in `received_power_dbm`: `who` (n,) hashes of the radios' names, `antenna` (n, 2), `pos` and `vel`
    (n, 3) in m and m/s. `head` and `follow` are the index that `link_budget.index_positions` made of `pos`, and
    `best_dbi` is `best_gain_dbi(antenna)`. `power_dbm` goes into the sender's antenna, `centre` is in MHz, `time_ns`
    addresses the fading. `rows` and `dbm` are written from `count` on and need room for all n radios from there.

    A radio is left out if its power without shadowing and fading is below `floor_dbm`, if it is farther than the
    horizon, or if it has no position; a power with shadowing and fading may therefore be below the floor.
    """
    least = floor_dbm - params.table.best_gain_db  # the losses of a table may be less than those of free space
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


@compiled
def received_powers(
    params: MediumParams,
    obstacles: Obstacles,
    who: NDArray[np.uint64],
    antenna: Floats,
    pos: Floats,
    vel: Floats,
    head: Ints,
    follow: Ints,
    senders: Ints,
    power_dbm: Floats,
    centre: float,
    time_ns: int,
    floor_dbm: float,
) -> tuple[Ints, Ints, Floats]:
    """The radios that each of s senders reaches: (start, rows, dbm), with those of sender k in start[k]:start[k + 1].

    `senders` (s,) are rows, `power_dbm` (s,) their powers; the rest is as in `append_received_powers`.
    """
    n = pos.shape[0]
    best_dbi = best_gain_dbi(antenna)
    start = np.zeros(senders.shape[0] + 1, dtype=np.int64)
    rows, dbm = np.empty(2 * n, dtype=np.int64), np.empty(2 * n)
    count = 0
    for k in range(senders.shape[0]):
        if count + n > rows.shape[0]:
            more_rows, more_dbm = np.empty(2 * (count + n), dtype=np.int64), np.empty(2 * (count + n))
            more_rows[:count], more_dbm[:count] = rows[:count], dbm[:count]
            rows, dbm = more_rows, more_dbm
        count = append_received_powers(
            params, obstacles, who, antenna, pos, vel, head, follow, best_dbi, senders[k], power_dbm[k], centre,
            time_ns, floor_dbm, rows, dbm, count,
        )  # fmt: skip
        start[k + 1] = count
    return start, rows[:count].copy(), dbm[:count].copy()
