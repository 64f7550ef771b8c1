"""Message requests: the telemetry that a companion requests from its autopilot, for Remote ID and avoidance.

A message that has not arrived for a while is requested. So what a ground station has already requested is left
unchanged, and a lost request, a rebooted autopilot and a stream that somebody stopped are handled alike.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.frames import Ints
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time

MAV_STATE_ACTIVE: Final = int(mav.MAV_STATE_ACTIVE)
RETRY_NS: Final[Time] = 10 * NS_PER_S
"""Least time between two requests for the same message."""


class MessageRequest(NamedTuple):
    """One message: its interval, how long it may be missing, and the field of `BELIEF_DTYPE` that
    holds when it came.
    """

    message: int
    interval_ns: Time
    missing_ns: Time
    field: str


GOAL_REQUEST: Final = MessageRequest(
    int(mav.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT), NS_PER_S, 3 * NS_PER_S, "goal_ns"
)
REQUESTS: Final = (
    # no sooner than a ground station may have requested it, at a rate that avoidance can use
    MessageRequest(int(mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT), 250 * NS_PER_MS, 3 * NS_PER_S, "position_ns"),
    MessageRequest(int(mav.MAVLINK_MSG_ID_GPS_RAW_INT), NS_PER_S, 3 * NS_PER_S, "gnss_ns"),
    # clocks and home positions change seldom: HOME_POSITION is sent without a request when it does
    MessageRequest(int(mav.MAVLINK_MSG_ID_SYSTEM_TIME), 5 * NS_PER_S, 12 * NS_PER_S, "time_ns"),
    MessageRequest(int(mav.MAVLINK_MSG_ID_HOME_POSITION), 5 * NS_PER_S, 12 * NS_PER_S, "home_ns"),
    GOAL_REQUEST,
)


class MessageRequests:
    """The requests to many autopilots, and their times. Deep-copyable."""

    def __init__(self, avoids: NDArray[np.bool_]) -> None:
        """`avoids` (n,): the aircraft whose goals are needed."""
        count = len(avoids)
        self._avoids = avoids
        self._since_ns = np.full(count, -1, dtype=np.int64)
        self._asked_ns = np.full((count, len(REQUESTS)), -1, dtype=np.int64)

    def due(self, now: Time, table: Any, auto: int) -> list[tuple[int, MessageRequest]]:
        """(row, message) to request now; `auto` is the number of the mode in which there is a goal."""
        beating = table["heartbeat_ns"] >= 0
        new = beating & (self._since_ns < 0)
        self._since_ns[new] = now
        found = []
        for column, request in enumerate(REQUESTS):
            received, asked = table[request.field], self._asked_ns[:, column]
            never = asked < 0
            since = np.maximum(received, self._since_ns)
            silent = beating & (now - since >= request.missing_ns)
            if request.field != "position_ns":
                silent |= beating & never & (received < 0)  # at once
            silent &= never | (now - asked >= RETRY_NS)
            if request is GOAL_REQUEST:  # no goal is sent on the ground and in other modes
                silent &= self._avoids & (never | ((table["mode"] == auto) & (table["state"] == MAV_STATE_ACTIVE)))
            rows: Ints = np.flatnonzero(silent)
            self._asked_ns[rows, column] = now
            found += [(row, request) for row in rows.tolist()]
        return found
