"""Events aboard an ArduPilot, read from its messages and noted as those of the builtin autopilot.

`AUTOPILOT_EVENTS` lists them. A few reports are requested on the private port ten times a second, so an event is
detected within 0.1 s; others are read from its texts and from its answers. No message gives the reason for a change of
mode, and causes are not known.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

from skyrange.codec.mavlink import Message, decode, dialect, message_id
from skyrange.codec.mavlink.flight_modes import mode_name
from skyrange.core.errors import DecodeError
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.vehicle.mavlink_state.answered_requests import ANSWERS, REQUESTS, AnsweredRequests
from skyrange.vehicle.mavlink_state.status_texts import Event, FenceState, read_status_text

REPORTS: Final = {
    dialect.MAVLINK_MSG_ID_HEARTBEAT: 10.0,
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 10.0,
    dialect.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 10.0,
    dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 10.0,
}
"""The reports requested on the private port, in Hz."""
GLITCH_FLAG: Final = 1 << 15
"""EKF_STATUS_REPORT.flags (AP_NavEKF/AP_Nav_Common.h, `gps_glitching`)."""
POSITION_VALID_FLAG: Final = int(dialect.EKF_POS_HORIZ_ABS)
JUMP_M: Final = 1.5
"""A step of the estimate beyond its velocity between two reports counts as a reset."""
_GROUND: Final = int(dialect.MAV_LANDED_STATE_ON_GROUND)
_ARMED: Final = int(dialect.MAV_MODE_FLAG_SAFETY_ARMED)
_DEGREE_M: Final = math.radians(6_378_137.0)
_PUBLIC: Final = ANSWERS | {dialect.MAVLINK_MSG_ID_STATUSTEXT, dialect.MAVLINK_MSG_ID_FENCE_STATUS}


class EventDetector:
    """The known state of one aircraft; every change of it is an event."""

    def __init__(self, system_id: int, origin: Origin) -> None:
        """Of the aircraft with this MAVLink system id, in a range with this origin."""
        self.mode = -1
        self.armed = False
        self.landed = True
        self.flags = 0
        """Of the estimator's last report."""
        self._glitching = False
        self._of = system_id, origin
        self._requests = AnsweredRequests(system_id, origin)
        self._fence = FenceState()
        self._place: tuple[Time, float, float, float, float, float, float] | None = None

    def renew(self) -> EventDetector:
        """Return a detector of the same aircraft that knows nothing yet, as after a reboot."""
        return EventDetector(*self._of)

    def on_upload(self, payload: bytes) -> None:
        """Process a frame to the autopilot: its answer may be an event."""
        if message_id(payload) in REQUESTS:
            try:
                self._requests.on_request(decode(payload))
            except DecodeError:
                return

    def on_public_frame(self, payload: bytes) -> Iterator[Event]:
        """The events in a frame from its public port."""
        number = message_id(payload)
        if number not in _PUBLIC:
            return
        message = decode(payload)
        if number == dialect.MAVLINK_MSG_ID_STATUSTEXT:
            yield from read_status_text(message.text, self._fence)
        elif number == dialect.MAVLINK_MSG_ID_FENCE_STATUS:
            yield from self._fence.on_status(message, self.armed, self.landed)
        else:
            yield from self._requests.on_answer(message, self.landed)

    def on_report(self, message: Message) -> Iterator[Event]:
        """The events in a message from its private port."""
        kind = message.get_type()
        if kind == "HEARTBEAT" and message.autopilot != dialect.MAV_AUTOPILOT_INVALID:
            if message.custom_mode != self.mode:
                first, self.mode = self.mode < 0, message.custom_mode
                if not first:
                    name = mode_name(message.type, message.autopilot, self.mode)
                    yield "event.mode", {"mode": name, "number": self.mode, "reason": ""}
            armed = bool(message.base_mode & _ARMED)
            if armed != self.armed:
                self.armed = armed
                yield ("event.armed", {"forced": False}) if armed else ("event.disarmed", {"reason": ""})
        elif kind == "EXTENDED_SYS_STATE":
            landed = message.landed_state == _GROUND
            if landed != self.landed:
                self.landed = landed
                yield ("event.landed" if landed else "event.takeoff"), {}
        elif kind == "EKF_STATUS_REPORT":
            self.flags = message.flags
            glitching = bool(message.flags & GLITCH_FLAG)
            if glitching != self._glitching:
                self._glitching = glitching
                yield "event.glitch", {"on": glitching}
        elif kind == "GLOBAL_POSITION_INT":
            yield from self._moved(message)

    def _moved(self, message: Message) -> Iterator[Event]:
        """A jump of the reported position is a reset of the estimator."""
        now = message.time_boot_ms * NS_PER_MS
        lat, lon, up = message.lat * 1e-7, message.lon * 1e-7, message.alt * 1e-3
        velocity = (message.vx * 1e-2, message.vy * 1e-2, -message.vz * 1e-2)
        before, self._place = self._place, (now, lat, lon, up, *velocity)
        if before is None or not self.flags & POSITION_VALID_FLAG:
            return
        north = (lat - before[1]) * _DEGREE_M
        east = (lon - before[2]) * _DEGREE_M * math.cos(math.radians(lat))
        seconds = (now - before[0]) / NS_PER_S
        jump = [
            way - 0.5 * seconds * (speed + was)
            for way, speed, was in zip((north, east, up - before[3]), velocity, before[4:], strict=True)
        ]
        if math.hypot(*jump) >= JUMP_M:
            yield "event.estimator", {"reset": "position", "east_m": jump[1], "north_m": jump[0], "up_m": jump[2]}
