"""Useless frames: MAVLink messages that load a link or its receivers, and random bytes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Literal

from skyrange.attack.bases.mavlink.orders import AUTOPILOT
from skyrange.codec.mavlink import Packer
from skyrange.codec.mavlink import dialect as mav
from skyrange.core.chance import Chance
from skyrange.core.ids import hash64
from skyrange.core.time import Time

Subject = Literal["HEARTBEAT", "PING", "PARAM_REQUEST_LIST", "COMMAND_LONG", "random"]
"""A message, or random bytes."""
_SYSTEMS: Final = 254
_ALL_COMPONENTS: Final = 0


def _heartbeat(turn: int, system: int, now: Time) -> Any:
    return mav.MAVLink_heartbeat_message(mav.MAV_TYPE_GENERIC, mav.MAV_AUTOPILOT_INVALID, 0, 0, mav.MAV_STATE_ACTIVE, 3)


def _ping(turn: int, system: int, now: Time) -> Any:
    return mav.MAVLink_ping_message(now // 1000, turn & 0xFFFFFFFF, 0, 0)


def _parameter_list(turn: int, system: int, now: Time) -> Any:
    return mav.MAVLink_param_request_list_message(system, _ALL_COMPONENTS)


def _request(turn: int, system: int, now: Time) -> Any:
    wanted = float(mav.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
    command = mav.MAV_CMD_REQUEST_MESSAGE
    return mav.MAVLink_command_long_message(system, AUTOPILOT, command, 0, wanted, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


_MESSAGES: Final[dict[str, Callable[[int, int, Time], Any]]] = {
    "HEARTBEAT": _heartbeat, "PING": _ping, "PARAM_REQUEST_LIST": _parameter_list, "COMMAND_LONG": _request,
}  # fmt: skip


@dataclass(slots=True)
class UselessFrames:
    """Makes useless frames for one link; heartbeats have system ids of nobody on it."""

    subject: Subject
    random_bytes: int
    """Length of a frame of random bytes."""
    packer: Packer
    """The sender in whose name they are."""
    aircraft: int
    """System id of the aircraft on the link."""
    chance: Chance
    address: str
    """Of the random bytes, with the number of a frame."""

    def make(self, turn: int, now: Time) -> bytes:
        """Frame number `turn`, from 0."""
        if self.subject == "random":
            return self._draw_bytes(turn)
        if self.subject == "HEARTBEAT":
            self.packer.system, self.packer.component = self._foreign_system(turn), 1
        return self.packer.pack(_MESSAGES[self.subject](turn, self.aircraft, now))

    def _foreign_system(self, turn: int) -> int:
        """The next system id that is neither the aircraft's nor the ground station's."""
        system = 1 + turn % (_SYSTEMS - 1)
        return system + 1 if system >= self.aircraft else system

    def _draw_bytes(self, turn: int) -> bytes:
        who, made = hash64(self.address), b""
        while len(made) < self.random_bytes:
            for uniform in self.chance.uniform4("attack.flood", who, turn, len(made)):
                made += int(uniform * 2.0**48).to_bytes(6, "little")
        return made[: self.random_bytes]
