"""Messages of a companion to its autopilot: commands, and requests of the telemetry that it reads.

GCS_MAVLink_Copter.cpp and GCS_Common.cpp: DO_SET_MODE, SET_MESSAGE_INTERVAL by COMMAND_LONG, and
SET_POSITION_TARGET_GLOBAL_INT in GUIDED, from component 191 of the aircraft's own system.

Message requests: the telemetry that a companion requests from its autopilot, for Remote ID and avoidance. A message
that has not arrived for a while is requested. So what a ground station has already requested is left unchanged, and a
lost request, a rebooted autopilot and a stream that somebody stopped are handled alike.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import Message
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.frames import Ints
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.vehicle.avoidance.contract import Vector

COMPONENT: Final = int(mav.MAV_COMP_ID_ONBOARD_COMPUTER)
"""191."""
AUTOPILOT: Final = int(mav.MAV_COMP_ID_AUTOPILOT1)
AUTO: Final = int(mav.COPTER_MODE_AUTO)
GUIDED: Final = int(mav.COPTER_MODE_GUIDED)
RTL: Final = int(mav.COPTER_MODE_RTL)

_POSITION_ONLY: Final = 0b110111111000
_VELOCITY_ONLY: Final = 0b110111000111
"""POSITION_TARGET_TYPEMASK: what is ignored. Acceleration, yaw and yaw rate are always ignored."""


def set_mode(system: int, mode: int) -> Message:
    """DO_SET_MODE."""
    return mav.MAVLink_command_long_message(
        system, AUTOPILOT, mav.MAV_CMD_DO_SET_MODE, 0, mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, mode, 0, 0, 0, 0, 0
    )


def set_speed(system: int, speed_mps: float) -> Message:
    """DO_CHANGE_SPEED over ground: ArduCopter forgets the mission's speed with every change of mode."""
    return mav.MAVLink_command_long_message(
        system, AUTOPILOT, mav.MAV_CMD_DO_CHANGE_SPEED, 0, mav.SPEED_TYPE_GROUNDSPEED, speed_mps, -1, 0, 0, 0, 0
    )


def set_interval(system: int, message: int, interval_us: int) -> Message:
    """SET_MESSAGE_INTERVAL."""
    return mav.MAVLink_command_long_message(
        system, AUTOPILOT, mav.MAV_CMD_SET_MESSAGE_INTERVAL, 0, message, interval_us, 0, 0, 0, 0, 0
    )


def go_to(system: int, boot_ms: int, origin: Origin, place: Vector) -> Message:
    """Fly to a position and stay there."""
    lat, lon = origin.geodetic_of(place[0], place[1])
    return mav.MAVLink_set_position_target_global_int_message(
        boot_ms, system, AUTOPILOT, mav.MAV_FRAME_GLOBAL_INT, _POSITION_ONLY, round(lat * 1e7), round(lon * 1e7),
        origin.alt_msl_m + place[2], 0, 0, 0, 0, 0, 0, 0, 0,
    )  # fmt: skip


def hold(system: int, boot_ms: int) -> Message:
    """Stop: a velocity of 0, which ArduCopter keeps after the command expires (GUID_TIMEOUT)."""
    return mav.MAVLink_set_position_target_global_int_message(
        boot_ms, system, AUTOPILOT, mav.MAV_FRAME_GLOBAL_INT, _VELOCITY_ONLY, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0
    )


def arm_status(problem: str) -> Message:
    """OPEN_DRONE_ID_ARM_STATUS: good, or the reason why not."""
    status = mav.MAV_ODID_ARM_STATUS_PRE_ARM_FAIL_GENERIC if problem else mav.MAV_ODID_ARM_STATUS_GOOD_TO_ARM
    return mav.MAVLink_open_drone_id_arm_status_message(status, problem.encode()[:50])


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
        requests = []
        for column, request in enumerate(REQUESTS):
            received, asked_ns = table[request.field], self._asked_ns[:, column]
            never = asked_ns < 0
            since = np.maximum(received, self._since_ns)
            silent = beating & (now - since >= request.missing_ns)
            if request.field != "position_ns":
                silent |= beating & never & (received < 0)  # at once
            silent &= never | (now - asked_ns >= RETRY_NS)
            if request is GOAL_REQUEST:  # no goal is sent on the ground and in other modes
                silent &= self._avoids & (never | ((table["mode"] == auto) & (table["state"] == MAV_STATE_ACTIVE)))
            rows: Ints = np.flatnonzero(silent)
            self._asked_ns[rows, column] = now
            requests += [(row, request) for row in rows.tolist()]
        return requests
