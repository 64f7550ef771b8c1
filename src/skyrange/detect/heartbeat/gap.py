"""Heartbeat gap detector: raises an alert if no heartbeat of a MAVLink component arrives for longer than a limit.

Every MAVLink component sends HEARTBEAT about once a second (mavlink.io, Heartbeat/Connection Protocol), and counts as
disconnected when several in a row are missing. A jammed, cut or flooded link causes a gap, and so does an aircraft that
has crashed or flown out of range. The detector does not report the cause. A forged heartbeat ends a gap as a true one
does.

The default limit is ArduPilot's timeout of a ground station (`FS_GCS_TIMEOUT`, 5 s). At one heartbeat per second, an
alert needs four lost heartbeats in a row and a late fifth one. With 10 % frame loss that happens at most once in three
hours per aircraft, with 1 % at most once in three years.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import skyrange.plugin as sky


@sky.detector("heartbeat.gap")
class HeartbeatGap(sky.Detector):
    """Raises an alert if no heartbeat of a MAVLink component arrives on a link for longer than a limit.

    There is one alert for each gap on each link. A gap begins at time 0 or at the last heartbeat. The time of an alert
    is when the gap exceeded the limit, and its score is the length of the gap divided by the limit. `data` has the
    link, the time of the last heartbeat and the limit.
    """

    limit_s: sky.Number = sky.param(
        "Longest time between two heartbeats that raises no alert, in seconds.", default=5.0, ge=1.0, le=3600.0
    )
    component: sky.Whole = sky.param(
        "MAVLink component id whose heartbeats count: 1 is an autopilot, 190 a ground station.",
        default=1, ge=1, le=255,
    )  # fmt: skip
    last_ns: sky.Ints = sky.table()
    """(ends,) when the last heartbeat arrived."""
    raised: sky.Ints = sky.table()
    """(ends,) 1 where the gap has had its alert."""

    def observe(self, now: sky.Time, frames: sky.ObservedFrames) -> Sequence[sky.Alert]:
        """Read the heartbeats since the last service. Returns an alert for each link whose gap exceeds the limit."""
        self.grow(len(frames.ports), last_ns=0, raised=0)
        limit_ns, arrived = sky.from_seconds(self.limit_s), frames.take(frames.received)
        beats = sky.read_messages(arrived, "HEARTBEAT")
        rows = beats.rows[beats.components == self.component]
        places, at_ns = arrived.places[rows], np.maximum(arrived.at_ns[rows], 0)
        first_ns = np.full(len(frames.ports), sky.NEVER, dtype=np.int64)
        np.minimum.at(first_ns, places, at_ns)
        silent_ns = np.minimum(first_ns, now) - self.last_ns
        late = np.flatnonzero((silent_ns > limit_ns) & (self.raised == 0))
        alerts = []
        for place, last_ns in zip(late.tolist(), self.last_ns[late].tolist(), strict=True):
            link, score = frames.ports[place].link, int(silent_ns[place]) / limit_ns
            data = {"last_s": sky.to_seconds(last_ns), "limit_s": sky.to_seconds(limit_ns)}
            alerts.append(self.alert(last_ns + limit_ns, link, score, data))
        self.raised[late] = 1
        self.raised[places] = 0
        np.maximum.at(self.last_ns, places, at_ns)
        return alerts
