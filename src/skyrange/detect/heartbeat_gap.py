"""Heartbeat gap detector: alerts where a MAVLink peer has not been heard for longer than it should be silent.

Every MAVLink component sends HEARTBEAT about once a second (mavlink.io, Heartbeat/Connection Protocol), and counts as
disconnected when several in a row are missing. A link that is jammed, cut or flooded shows as a gap. So does an
aircraft that has crashed or flown out of range: the detector says that there is silence, not why. A forged heartbeat
ends a gap as a true one does.

The default limit is ArduPilot's own for a ground station that is gone (`FS_GCS_TIMEOUT`, 5 s). At one heartbeat a
second, four in a row must be lost and a fifth must come late for an alert: on a link that loses every tenth frame that
is at most once in three hours for each aircraft, on one that loses one in a hundred at most once in three years.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydantic import Field

from skyrange.contracts.detectors import DetectorContext, DetectorPlugin
from skyrange.contracts.monitors import Alert, Monitor, ObservedFrames
from skyrange.contracts.params import Number, Params, Whole
from skyrange.core.time import NEVER, NS_PER_MS, Time, from_seconds, to_seconds
from skyrange.detect.telemetry import read_messages

KIND = "heartbeat.gap"
"""The kind of its alerts."""
ABOUT = "Alerts where no heartbeat of a MAVLink component has come over a link for longer than a limit."

SERVICE_NS: Time = 500 * NS_PER_MS
"""How often silence is looked for: what an alert comes late at most."""


class HeartbeatGapParams(Params):
    """Parameters of the heartbeat gap detector."""

    limit_s: Number = Field(
        default=5.0,
        ge=1.0,
        le=3600.0,
        description="Longest silence between two heartbeats that is no alert, in seconds.",
    )
    component: Whole = Field(
        default=1,
        ge=1,
        le=255,
        description="MAVLink component id whose heartbeats count: 1 an autopilot, 190 a ground station.",
    )


class HeartbeatGap:
    """A `skyrange.contracts.monitors.Monitor`: one alert for each gap of each link, as soon as the limit is passed.

    Silence counts from time 0, also on a link on which nothing was ever heard. An alert's subject is the link's owner
    (`blue/b1` of `gcs:blue/b1`), its time the moment at which the limit was passed, its score how long the silence has
    lasted, in limits. `data` has the link, the time of the last heartbeat and the limit.
    """

    service_ns: Time = SERVICE_NS

    def __init__(self, params: HeartbeatGapParams) -> None:
        self._limit_ns = from_seconds(params.limit_s)
        self._component = params.component
        self._last = np.zeros(0, dtype=np.int64)
        self._raised = np.zeros(0, dtype=np.bool_)

    def observe(self, now: Time, frames: ObservedFrames) -> Sequence[Alert]:
        """Take in the heartbeats since the last service; alert of links that have been silent for too long."""
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
