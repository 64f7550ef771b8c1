"""Session with one external vehicle: its connection, its interlock, its reports, and the requests for them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, Final

from skyrange.codec.mavlink import Message, Packer, decode, dialect, sender_system
from skyrange.codec.mavlink.deframer import Piece
from skyrange.codec.mavlink.flight_modes import MULTIROTOR_TYPES, is_arducopter_multirotor, vehicle_name
from skyrange.contracts.components import InstanceStatus
from skyrange.contracts.mailboxes import Arrival
from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.core.ids import FrameId
from skyrange.core.time import Time
from skyrange.core.whole_numbers import worth_noting
from skyrange.io.mavlink.connections import MavlinkConnection
from skyrange.vehicle.contract import VehicleSpec
from skyrange.vehicle.event_detection import EventDetector
from skyrange.vehicle.external.interlock import Interlock
from skyrange.vehicle.reported_poses import REACH_M, PositionReports

FAR_M: Final = 50.0
"""A vehicle farther than this from its `start` is not where the scenario says, and that is noted."""
CHECK_S: Final = 2.0
"""Interval at which the received messages are compared with the requested ones."""
MAX_RETRY_S: Final = 32.0
"""A message that never comes is requested less and less often, down to this interval."""
MIN_RATE_SHARE: Final = 0.6
"""Share of the requested rate; below it the message is requested again, since others may request it at a lower rate."""
COMPONENT: Final = int(dialect.MAV_COMP_ID_ONBOARD_COMPUTER4)
"""Component of the requests: a computer of the vehicle's own system, other than the companion."""
AUTOPILOT: Final = int(dialect.MAV_COMP_ID_AUTOPILOT1)
STATE_HZ: Final = 2.0
FLOWN: Final = (
    f"MAV_AUTOPILOT_ARDUPILOTMEGA with {', '.join(dialect.enums['MAV_TYPE'][kind].name for kind in MULTIROTOR_TYPES)}"
)
"""The vehicles that may be connected, in MAVLink's words."""

Note = tuple[str, Mapping[str, Any], tuple[FrameId, ...]]
"""Kind, data and causes."""


class VehicleSession:
    """One vehicle. Notes wait in `notes`; what repeats is noted at its 1st, 2nd, 4th … time."""

    def __init__(
        self, spec: VehicleSpec, wire: MavlinkConnection, origin: Origin, rate_hz: float, *, open_: bool
    ) -> None:
        """`open_` permits motion: the interlock opens once a heartbeat says that the vehicle is one that is flown."""
        self.spec = spec
        self.wire = wire
        self._origin = origin
        self.interlock = Interlock(spec.system_id)
        self._may_open = open_
        self.status = InstanceStatus.BOOTING
        self.notes: list[Note] = []
        self.reports = PositionReports()
        self.late_ns: Time | None = None
        """Age of a new position; `None` if there is none since it was last taken."""
        self.lost = 0
        """Frames that the interlock passed, and the connection did not accept."""
        self._events = EventDetector(spec.system_id, origin)
        self._packer = Packer(spec.system_id, COMPONENT)
        self._asked: dict[int, float] = {
            dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: rate_hz,
            dialect.MAVLINK_MSG_ID_ATTITUDE: rate_hz,
            dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: STATE_HZ,
        }
        self._received: dict[int, int] = dict.fromkeys(self._asked, 0)
        self._retry_s: dict[int, float] = dict.fromkeys(self._asked, CHECK_S)
        self._next_request_s: dict[int, float] = dict.fromkeys(self._asked, 0.0)
        self._checked_s = -math.inf
        self._heard_s = -math.inf
        """When it last sent anything, on the clock of the engine."""
        self._position_s = -math.inf
        self._reopened_s = math.inf
        """When its connection was last opened again."""
        self._heartbeats = 0
        self._strangers: dict[int, int] = {}
        self._out_of_range = False
        """Whether its reported position is beyond `REACH_M`."""

    # ---------------------------------------------------------------- to it

    def send(self, arrival: Arrival) -> None:
        """Send a frame of the range to it, if the interlock permits."""
        refusal = self.interlock.check(arrival.payload)
        if refusal is None:
            self.lost += not self.wire.write(arrival.payload)
            self._events.on_upload(arrival.payload)
            return
        count = self.interlock.refused[refusal]
        if worth_noting(count):
            self.note("event.interlock", {**refusal._asdict(), "count": count}, (arrival.ref,))

    def request_messages(self, now_s: float) -> None:
        """Request the messages that truth is made of, where they arrive less often than requested."""
        if not self.wire.connected or now_s < self._checked_s + CHECK_S:
            return
        since_s, self._checked_s = now_s - self._checked_s, now_s
        for number, rate_hz in self._asked.items():
            came, self._received[number] = self._received[number], 0
            if came >= MIN_RATE_SHARE * rate_hz * min(since_s, CHECK_S):
                self._retry_s[number], self._next_request_s[number] = CHECK_S, 0.0
            elif now_s >= self._next_request_s[number]:
                self._next_request_s[number] = now_s + self._retry_s[number]
                if not came:
                    self._retry_s[number] = min(2.0 * self._retry_s[number], MAX_RETRY_S)
                asks = self._packer.pack(_interval(self.spec.system_id, number, rate_hz))
                if self.interlock.check(asks) is None:
                    self.wire.write(asks)

    # ---------------------------------------------------------------- from it

    def on_frame(self, piece: Piece, now_s: float) -> None:
        """Process what it sent. Raises `InputError` for the heartbeat of a vehicle that is not flown."""
        if piece.garbage:
            return
        sender = sender_system(piece.data)
        if sender != self.spec.system_id:
            self._count_foreign(sender or 0)
            return
        message = decode(piece.data)
        if message.get_srcComponent() != AUTOPILOT:
            return
        self._heard_s = now_s
        number = int(type(message).id)
        if number in self._received:
            self._received[number] += 1
        if number == dialect.MAVLINK_MSG_ID_HEARTBEAT:
            self._identify(message.type, message.autopilot)
            self._heartbeats += 1
        elif number == dialect.MAVLINK_MSG_ID_ATTITUDE:
            self.reports.on_attitude(message)
        elif number == dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT:
            self._on_position(message, now_s)
        for kind, details in (*self._events.on_report(message), *self._events.on_public_frame(piece.data)):
            self.note(kind, details)

    def _identify(self, vehicle_type: int, autopilot: int) -> None:
        """Let the interlock open for a vehicle whose modes and commands are those that the range sends."""
        if not is_arducopter_multirotor(vehicle_type, autopilot):
            self.interlock.open = False
            raise InputError.one(
                f"external vehicle {self.spec.vehicle}",
                f"the heartbeat at {self.wire.address}",
                vehicle_name(vehicle_type, autopilot),
                f"an ArduCopter multirotor: {FLOWN}",
                "Other vehicles number their modes differently and are not flown. Connect another, or leave it out",
            )
        self.interlock.open = self._may_open

    def _on_position(self, message: Message, now_s: float) -> None:
        if message.time_boot_ms + 1000 < self.reports.boot_ms:
            self._events = self._events.renew()
            self.interlock.open = False  # until its next heartbeat: it may run another firmware
            self.note("event.reboot", {"system_id": self.spec.system_id})
        late_ns = self.reports.on_position(message, self._origin, now_s)
        self._out_of_range = late_ns is None
        if late_ns is None:
            return
        self.late_ns, self._position_s = late_ns, now_s

    def _count_foreign(self, system: int) -> None:
        count = self._strangers[system] = self._strangers.get(system, 0) + 1
        if worth_noting(count):
            self.note("event.foreign_system", {"system_id": system, "expected": self.spec.system_id, "count": count})

    # ---------------------------------------------------------------- how it is

    def update_status(self, now_s: float, silent_s: float) -> None:
        """Update the status: booting until its position is known, ready, silent while its position is older than
        `silent_s`.

        A connection without data for that long is opened again.
        """
        silent = now_s - self._position_s > silent_s
        if self.status is not InstanceStatus.READY:
            if not silent and self._heartbeats:
                self.status = InstanceStatus.READY
                self._check_start()
        elif silent:
            self.status = InstanceStatus.SILENT
            self.note("event.autopilot_lost", {"ended": "", "said": self.why})
        if self._reopened_s == math.inf:
            self._reopened_s = now_s  # the first time
        if now_s - max(self._heard_s, self._reopened_s) > silent_s:
            self._reopened_s = now_s
            self.interlock.open = False  # until its next heartbeat: another vehicle may answer
            self.wire.again(f"nothing was heard for {silent_s:g} s")

    def _check_start(self) -> None:
        assert self.reports.state is not None
        away = [a - b for a, b in zip(self.reports.state.position_enu_m, self.spec.home_enu_m, strict=True)]
        far_m = math.hypot(*away)
        if far_m > FAR_M:
            position = dict(zip(("east_m", "north_m", "up_m"), self.reports.state.position_enu_m, strict=True))
            self.note("event.far_from_start", {"away_m": round(far_m, 1), **position})

    @property
    def counts(self) -> dict[str, Any]:
        """How many frames passed the interlock, how many of them the connection did not accept, and what was refused,
        and why.
        """
        refused = [{**why._asdict(), "count": count} for why, count in self.interlock.refused.items()]
        return {"passed": self.interlock.passed, "not_taken": self.lost, "refused": refused}

    @property
    def why(self) -> str:
        """What keeps it from being ready, in words; "" if nothing does."""
        if self.wire.trouble:
            return f"{self.wire.address}: {self.wire.trouble}"
        if self._out_of_range:
            return f"{self.wire.address}: its position is over {REACH_M / 1e3:g} km from the origin; has it a fix?"
        if self.reports.state is None or not self._heartbeats:
            others = sorted(self._strangers)
            if others and self._heard_s == -math.inf:
                ids = ", ".join(map(str, others[:4]))
                return f"{self.wire.address}: system {ids} was heard, and not {self.spec.system_id}"
            what = "nothing" if self._heard_s == -math.inf else "no position" if self._heartbeats else "no heartbeat"
            return f"{self.wire.address}: {what} was heard of system {self.spec.system_id}"
        return f"{self.wire.address}: it tells no position any more"

    def note(self, kind: str, data: Mapping[str, Any], causes: tuple[FrameId, ...] = ()) -> None:
        """Keep a note for the record."""
        self.notes.append((kind, data, causes))

    def take_notes(self) -> Iterator[Note]:
        """The waiting notes, once."""
        kept, self.notes = self.notes, []
        yield from kept


def _interval(system: int, number: int, rate_hz: float) -> Message:
    return dialect.MAVLink_command_long_message(
        system, AUTOPILOT, dialect.MAV_CMD_SET_MESSAGE_INTERVAL, 0, number, 1e6 / rate_hz, 0, 0, 0, 0, 0
    )
