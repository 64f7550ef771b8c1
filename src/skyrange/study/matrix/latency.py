"""Delay of frames from their sender to the end of their processing at the other end of a link, by role of link."""

from __future__ import annotations

import numpy as np

from skyrange.core.time import NS_PER_MS
from skyrange.record.read.run import RunRecord

_COLUMNS = ["link", "direction", "sender", "serial", "sent_ns", "arrived_ns", "fate", "parent"]


def measure_transit_ms(run: RunRecord) -> dict[str, tuple[float, float]]:
    """Median and 95th percentile in milliseconds of the delays of delivered frames, by role such as `gcs`.

    A frame that a defence signs, unsigns or holds is recorded as several; the delay begins when the first was sent.
    """
    table = run.table("frames", _COLUMNS)
    columns = [table.column(name).to_pylist() for name in _COLUMNS]
    begun: dict[str, int] = {}
    """When the journey of each frame on this link and in this direction began."""
    delays: dict[str, list[int]] = {}
    rows = zip(*columns, strict=True)
    for link, direction, sender, serial, sent_ns, arrived_ns, fate, parent in sorted(rows, key=lambda row: row[4]):
        here = f"{link}|{direction}|"
        start_ns = begun.get(parent, sent_ns) if parent is not None and parent.startswith(here) else sent_ns
        begun[f"{here}{sender}|{serial}"] = start_ns
        if fate == "delivered":
            delays.setdefault(link.partition(":")[0], []).append(arrived_ns - start_ns)
    return {
        role: (float(np.median(found)) / NS_PER_MS, float(np.percentile(found, 95)) / NS_PER_MS)
        for role, found in sorted(delays.items())
    }
