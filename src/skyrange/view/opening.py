"""Time at which a viewer opens: shortly before the first of two arms departs from the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from skyrange.core.time import NS_PER_S
from skyrange.metrics.aircraft import departures, read_ticks
from skyrange.record import RunRecord

LEAD_S: Final = 6.0
"""Time that is seen before what the viewer opens for."""


def find_opening_s(records: Sequence[RunRecord]) -> float | None:
    """When an aircraft first departs from its position in another of the runs, and `LEAD_S` before; `None` for never.

    The runs have the same aircraft and the truth of all of them.
    """
    if len(records) < 2:
        return None
    first, *others = (read_ticks(record) for record in records)
    departed_ns = [at_ns for other in others for at_ns in departures(first, other)[1].tolist() if at_ns >= 0]
    return max(min(departed_ns) / NS_PER_S - LEAD_S, 0.0) if departed_ns else None
