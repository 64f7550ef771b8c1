"""Received powers from a transmitter at all radios in reach.

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
    MAX_RANDOM_GAIN_DB,
    NO_SIGNAL,
    MediumParams,
    bucket_of,
    max_range_m,
    received_power_dbm,
)
from skyrange.radio.propagation.obstruction import Obstacles


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
    `best_dbi` is the highest gain of any antenna. `power_dbm` goes into the sender's antenna, `centre` is in MHz,
    `time_ns` addresses the fading. `rows` and `dbm` are written from `count` on and need room for all n radios there.

    A radio is left out if its power is below `floor_dbm`, if it is farther than the horizon, or if it has no position.
    """
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
