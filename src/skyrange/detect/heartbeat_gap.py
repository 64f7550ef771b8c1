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
from pydantic import Field

from skyrange.contracts.alerts import Alert
from skyrange.contracts.detectors import DetectorContext, DetectorPlugin
from skyrange.contracts.monitors import Monitor, ObservedFrames
from skyrange.contracts.params import Number, Params, Whole
from skyrange.core.time import NEVER, NS_PER_MS, Time, from_seconds, to_seconds
from skyrange.detect.telemetry import read_messages

KIND = "heartbeat.gap"
"""The kind of its alerts."""
ABOUT = "Raises an alert if no heartbeat of a MAVLink component arrives on a link for longer than a limit."

SERVICE_NS: Time = 500 * NS_PER_MS
"""Interval between checks, which is also the largest delay of an alert."""


class HeartbeatGapParams(Params):
    """Parameters of the heartbeat gap detector."""

    limit_s: Number = Field(
        default=5.0,
        ge=1.0,
        le=3600.0,
        description="Longest time between two heartbeats that raises no alert, in seconds.",
    )
    component: Whole = Field(
        default=1,
        ge=1,
        le=255,
        description="MAVLink component id whose heartbeats count: 1 is an autopilot, 190 a ground station.",
    )


class HeartbeatGap:
    """A `skyrange.contracts.monitors.Monitor`: one alert for each gap on each link, when it exceeds the limit.

    A gap begins at time 0 or at the last heartbeat. The subject of an alert is the owner of the link (`blue/b1` of
    `gcs:blue/b1`), its time is when the gap exceeded the limit, and its score is the length of the gap divided by the
    limit. `data` has the link, the time of the last heartbeat and the limit.
    """

    service_ns: Time = SERVICE_NS

    def __init__(self, params: HeartbeatGapParams) -> None:
        self._limit_ns = from_seconds(params.limit_s)
        self._component = params.component
        self._last = np.zeros(0, dtype=np.int64)
        self._raised = np.zeros(0, dtype=np.bool_)

    def observe(self, now: Time, frames: ObservedFrames) -> Sequence[Alert]:
        """Read the heartbeats since the last service. Returns an alert for each link whose gap exceeds the limit."""
        count = len(frames.ports)
        if len(self._last) != count:
            self._last, self._raised = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.bool_)
        arrived = frames.take(frames.received)
        beats = read_messages(arrived, "HEARTBEAT")
        rows = beats.rows[beats.components == self._component]
        places, at = arrived.places[rows], np.maximum(arrived.at_ns[rows], 0)
        first = np.full(count, NEVER, dtype=np.int64)
        np.minimum.at(first, places, at)
        silent_ns = np.minimum(first, now) - self._last
        late = np.flatnonzero((silent_ns > self._limit_ns) & ~self._raised)
        alerts = [self._alert(frames.ports[place].link, place, int(silent_ns[place])) for place in late.tolist()]
        self._raised[late] = True
        self._raised[places] = False
        np.maximum.at(self._last, places, at)
        return alerts

    def _alert(self, link: str, place: int, silent_ns: Time) -> Alert:
        last = int(self._last[place])
        return Alert(
            last + self._limit_ns,
            link.partition(":")[2],
            KIND,
            silent_ns / self._limit_ns,
            {"link": link, "last_s": to_seconds(last), "limit_s": to_seconds(self._limit_ns)},
        )


def make_heartbeat_gap(params: HeartbeatGapParams, context: DetectorContext | None = None) -> Monitor:
    """A new detector."""
    return HeartbeatGap(params)


HEARTBEAT_GAP = DetectorPlugin(HeartbeatGapParams, make_heartbeat_gap, ABOUT)
