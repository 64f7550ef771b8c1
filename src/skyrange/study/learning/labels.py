"""Labels of windows: which are attacked, which are not, and which say nothing about either."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from skyrange.core.time import NS_PER_S, Time

BENIGN, ATTACKED, UNKNOWN = 0, 1, 2


def label_windows(
    windows: pa.Table,
    acts: Mapping[str, Sequence[Mapping[str, Any]]],
    intruded_s: Mapping[str, float],
    window_ns: Time,
) -> NDArray[np.int64]:
    """(n,) the label of each row of `windows`, which has the columns run, vehicle and time_ns, the window's end.

    `acts` are the attacks by run, with vehicle ("" for all), first_s and last_s. A window is ATTACKED if an attack on
    its aircraft acts within it, and BENIGN in a run without attacks. In an attacked run all other windows are UNKNOWN:
    those before the onset are in the nominal run of the block already, and those after it may be its consequences, as
    those of other aircraft may. `intruded_s` has, by run, the first act of a harmless intrusion: windows that end after
    it are UNKNOWN too, because what a detector sees there is neither an attack nor authorised.
    """
    ends = windows.column("time_ns").to_numpy()
    runs, vehicles = windows.column("run").to_pylist(), windows.column("vehicle").to_pylist()
    labels = np.full(len(ends), BENIGN, dtype=np.int64)
    for row, (run, vehicle) in enumerate(zip(runs, vehicles, strict=True)):
        own = acts.get(run)
        if own is None:
            labels[row] = UNKNOWN if ends[row] > intruded_s.get(run, math.inf) * NS_PER_S else BENIGN
            continue
        labels[row] = UNKNOWN
        end, begin = int(ends[row]), int(ends[row]) - window_ns
        for act in own:
            if (
                act["vehicle"] in ("", vehicle)
                and act["first_s"] * NS_PER_S < end
                and act["last_s"] * NS_PER_S >= begin
            ):
                labels[row] = ATTACKED
                break
    return labels
