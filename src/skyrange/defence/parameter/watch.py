"""Parameter watch: parameters of an armed aircraft are locked, and read at intervals; one that changed is set back.

The lock drops what sets parameters or the fence, as messages or as files of MAVLink FTP. The watch asks for its
parameters one after the other: what the autopilot says while it is disarmed is right, and what it says otherwise while
armed was changed by a way that the lock does not cover, such as a link nearer to the autopilot.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, ClassVar, Final, Literal

from pydantic import AfterValidator, BeforeValidator

import skyrange.plugin as sky
from skyrange.attack.bases.mavlink.orders import read
from skyrange.codec.ardupilot_files import missions, parameters
from skyrange.codec.mavlink import dialect as mav
from skyrange.codec.mavlink import file_transfer
from skyrange.codec.mavlink.file_transfer import Opcode
from skyrange.defence.bases.link_ends import AUTOPILOT, role_of

_NAME_CHARS: Final = 16
"""Size of param_id in PARAM_SET."""
_RELATIVE: Final = 2.0**-23
"""A value has passed through 32-bit floating point, whose rounding this is."""
_READ: Final = frozenset((
    mav.MAVLINK_MSG_ID_PARAM_SET, mav.MAVLINK_MSG_ID_COMMAND_LONG, mav.MAVLINK_MSG_ID_COMMAND_INT,
    mav.MAVLINK_MSG_ID_MISSION_COUNT, mav.MAVLINK_MSG_ID_MISSION_CLEAR_ALL,
    mav.MAVLINK_MSG_ID_MISSION_WRITE_PARTIAL_LIST, mav.MAVLINK_MSG_ID_FENCE_POINT,
    mav.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL,
))  # fmt: skip

_ASKS: Final = frozenset((mav.MAVLINK_MSG_ID_PARAM_REQUEST_READ, mav.MAVLINK_MSG_ID_PARAM_SET))


def _names(names: tuple[str, ...]) -> tuple[str, ...]:
    for place, name in enumerate(names):
        if not (0 < len(name) <= _NAME_CHARS and name.isascii() and name == name.upper()):
            expected = f"a parameter's name: 1 to {_NAME_CHARS} capital ASCII characters"
            raise sky.refuse(sky.Problem(str(place), repr(name), expected))
    if len(set(names)) < len(names):
        raise sky.refuse(sky.Problem("", repr(list(names)), "each parameter once"))
    return names


_Names = Annotated[
    tuple[str, ...], BeforeValidator(sky.items, json_schema_input_type=list[str]), AfterValidator(_names)
]


@sky.defence(
    "parameter.watch",
    surface=("gcs", "log", "autopilot"),
    place="the proxy's end of the autopilot link, or the companion's end of the gcs link; knows the frames that pass",
    effect="drops what sets parameters or the fence while armed, and sets back what changed nevertheless",
    alerts=("parameter.lock", "parameter.changed"),
    against=("mavlink.parameter", "mavlink.fence", "mavlink.file_write"),
    evasion="sets parameters before the aircraft is armed, or beyond the lock those that are not watched, or shows the "
    "watch the old values",
    cost="a request on board every `every_s`, and its answer, which goes on to the station",
    nominal=("inject",),
    realism={"PARAM_SET and PARAM_VALUE": "cited: https://mavlink.io/en/services/parameter.html, GCS_Param.cpp"},
)
class ParameterWatch(sky.SpeakingTap):
    """Locks parameters and fence while the aircraft is armed, and sets back watched parameters that changed."""

    component: ClassVar = int(mav.MAV_COMP_ID_USER2)

    at: Literal["companion", "proxy"] = sky.param(
        "Where it is: companion, at its end of the gcs link, or proxy, at its end of the autopilot link, where frames "
        "of the companion pass too.",
        default="proxy",
    )
    allowed: _Names = sky.param(
        "Parameters that may be set while the aircraft is armed, such as ['WPNAV_SPEED'].", default=()
    )
    watched: _Names = sky.param(
        "Parameters that are read in turn, and set back where they changed while the aircraft is armed; by default "
        "those of failsafes and of the fence.",
        default=(
            "FS_GCS_ENABLE", "FS_GCS_TIMEOUT", "MAV_GCS_SYSID", "FS_EKF_ACTION", "FS_EKF_THRESH", "FS_CRASH_CHECK",
            "BATT_FS_LOW_ACT", "BATT_FS_CRT_ACT", "FENCE_ENABLE", "FENCE_ACTION", "FENCE_TYPE", "FENCE_RADIUS",
            "FENCE_ALT_MAX",
        ),
    )  # fmt: skip
    every_s: sky.Number = sky.param(
        "Time in seconds between two parameters that are read.", default=0.5, ge=0.05, le=3600
    )
    fence: bool = sky.param(
        "Whether the fence is locked too: DO_FENCE_ENABLE and uploads of a fence while the aircraft is armed.",
        default=True, strict=True,
    )  # fmt: skip
    known: dict[str, tuple[float, int]] = sky.state(dict)
    """Values of watched parameters, and their types, as the autopilot told them."""
    due: sky.Time = 0
    turn: int = 0
    """Parameters that were asked for so far."""
    asked: dict[str, int] = sky.state(dict)
    """The turn in which each was asked for last."""

    @staticmethod
    def inspects(frame: sky.Frame) -> bool:
        """Whether the content of a frame is read."""
        number = sky.message_id(frame.payload)
        return number in _READ if frame.direction == "fwd" else number == mav.MAVLINK_MSG_ID_PARAM_VALUE

    def find_end(self) -> tuple[str, str]:
        """See `EndTap`."""
        return role_of(self.at), self.at

    def find_exclusive(self, vehicle: str) -> list[sky.Exclusive]:
        """The watched parameters."""
        return [sky.Exclusive(f"parameters of {vehicle}", frozenset(self.watched))] if self.watched else []

    def find_rules(self, end: sky.PathEnd) -> Sequence[sky.PathRule]:
        """What it drops and sends."""
        passes = sky.Passes(end, "fwd", drops=frozenset((mav.MAVLINK_MSG_ID_PARAM_SET,)))
        return [passes, sky.Sends(end, "fwd", _ASKS)] if self.watched else [passes]

    def on_frame(self, now: sky.Time, frame: sky.Frame) -> Sequence[sky.Verdict]:
        """Drop what is locked; learn and compare values."""
        number = sky.message_id(frame.payload)
        if frame.direction == "rev":
            if number == mav.MAVLINK_MSG_ID_HEARTBEAT:
                self.learn_armed(frame.payload)
            elif number == mav.MAVLINK_MSG_ID_PARAM_VALUE:
                return self._compare(now, frame.payload)
            return ()
        what = self._find_locked(now, frame.payload) if number in _READ else ""
        return [sky.Drop(), *self.alarm.raise_at(now, "parameter.lock", 1.0, what=what)] if what else ()

    def next_wakeup(self) -> sky.Time | None:
        return self.due

    def on_wakeup(self, now: sky.Time) -> Sequence[sky.Verdict]:
        if now < self.due:
            return ()
        self.due = now + sky.from_seconds(self.every_s)
        if now < self.schedule.start_ns or not self.watched:
            return ()
        name = self._choose()
        return [self.say(mav.MAVLink_param_request_read_message(self.system, AUTOPILOT, name.encode(), -1))]

    def _choose(self) -> str:
        """The parameter that was not asked for the longest time; that of one that is not known counts twice.

        So values are learned before the aircraft is armed, and a parameter that the autopilot does not have keeps the
        watch from no other.
        """
        self.turn += 1
        ages = {name: (self.turn - self.asked.get(name, 0)) * (1 if name in self.known else 2) for name in self.watched}
        name = max(ages, key=ages.__getitem__)
        self.asked[name] = self.turn
        return name

    def _find_locked(self, now: sky.Time, payload: bytes) -> str:
        """What of a frame is locked; "" for nothing."""
        message = read(payload)
        if message is None:
            return ""
        number = message.get_msgId()
        if number == mav.MAVLINK_MSG_ID_PARAM_SET:
            name = _clean(message.param_id)
            if not self.armed:
                self.known.pop(name, None)  # the operator may set it: what is true is asked for anew
                return ""
            return "" if name in self.allowed else f"PARAM_SET {name}"
        if number == mav.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL:
            return self._find_locked_file(message)
        if not self.armed or not self.fence:
            return ""
        if number in (mav.MAVLINK_MSG_ID_COMMAND_LONG, mav.MAVLINK_MSG_ID_COMMAND_INT):
            return "DO_FENCE_ENABLE" if message.command == mav.MAV_CMD_DO_FENCE_ENABLE else ""
        if number == mav.MAVLINK_MSG_ID_FENCE_POINT:
            return "FENCE_POINT"
        return "fence upload" if message.mission_type == mav.MAV_MISSION_TYPE_FENCE else ""

    def _find_locked_file(self, message: sky.MavlinkMessage) -> str:
        """The file of parameters or of the fence that a request opens to write it; what it writes is not read."""
        request = file_transfer.unpack(bytes(message.payload))
        if request.opcode not in (Opcode.CREATE_FILE, Opcode.OPEN_FILE_WO):
            return ""
        path = file_transfer.text_of(request)
        if path.partition("?")[0] == parameters.PATH:
            if not self.armed:
                self.known.clear()
            return path if self.armed else ""
        return path if self.armed and self.fence and path == f"{missions.DIRECTORY}fence.dat" else ""

    def _compare(self, now: sky.Time, payload: bytes) -> Sequence[sky.Verdict]:
        """Learn a value while disarmed; set it back where it differs while armed."""
        message = read(payload)
        name = "" if message is None else _clean(message.param_id)
        if message is None or name not in self.watched or not math.isfinite(message.param_value):
            return ()
        value, kind = float(message.param_value), int(message.param_type)
        if not self.armed or name not in self.known:
            self.known[name] = value, kind
            return ()
        right, _ = self.known[name]
        if name in self.allowed:
            self.known[name] = value, kind
            return ()
        if abs(value - right) <= _RELATIVE * abs(right):
            return ()
        restore = mav.MAVLink_param_set_message(self.system, AUTOPILOT, name.encode(), right, kind)
        alarm = self.alarm.raise_at(now, "parameter.changed", 1.0, what=name, value=value, right=right)
        return [self.say(restore), *alarm]


def _clean(name: object) -> str:
    """A param_id as text."""
    text = name.decode("ascii", "replace") if isinstance(name, bytes) else str(name)
    return text.split("\0", 1)[0].upper()
