"""Episodes of alerts: the alarms that an operator would have to deal with.

An episode begins with an alert and takes up all alerts of the same subject that are less than `episode_ns` later than
its *beginning*; the next alert begins another one. If the distance to the *previous* alert counted instead, an alarm
that never ends would be a single false alarm, and one more alert could join two episodes and so lower their number.
Counted from the beginning, the number of episodes is the least number of intervals [t, t + episode_ns) that cover all
alerts, so no alert that is added lowers it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skyrange.core.compiled import compiled


@compiled
def find_episodes(subjects: NDArray[np.int64], times: NDArray[np.int64], episode_ns: int) -> NDArray[np.bool_]:
    """Which alerts begin an episode, shape (n,); `subjects` and `times` (ns), shape (n,), sorted by subject, then time.

    `episode_ns` is positive.
    """
    begins = np.zeros(times.shape[0], dtype=np.bool_)
    subject, begin = np.int64(-1), np.int64(0)
    for i in range(times.shape[0]):
        if subjects[i] != subject or times[i] - begin >= episode_ns:
            subject, begin = subjects[i], times[i]
            begins[i] = True
    return begins
