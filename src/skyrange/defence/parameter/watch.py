"""Parameter watch: parameters of an armed aircraft are locked, and read at intervals; one that changed is set back.

The lock drops what sets parameters or the fence. The watch asks for its parameters one after the other: what the
autopilot says while it is disarmed is right, and what it says otherwise while armed was changed by a way that the lock
does not cover, such as a link nearer to the autopilot.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Final, Literal

from pydantic import AfterValidator, BeforeValidator, Field

from skyrange.attack.bases.mavlink_orders import read
from skyrange.attack.exclusive import Exclusive
from skyrange.attack.on_path import TapMaker, ends_of
from skyrange.codec.mavlink import Message, Packer, message_id
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.links import Schedule
from skyrange.contracts.params import Number, items, refuse
from skyrange.contracts.verdicts import Drop, Inject, Verdict
from skyrange.core.errors import Problem
from skyrange.core.ids import link_name
from skyrange.core.time import Time, from_seconds
from skyrange.defence.contract import Defence, DefenceContext, DefencePlugin
from skyrange.defence.path_rules import Passes, PathRule, Sends, ends_at
from skyrange.defence.placement import Alarm, DefenceTap, Protected, find_protected, place_taps

COMPONENT: Final = int(mav.MAV_COMP_ID_USER2)
"""Component id that it reads and sets as."""
_STATION: Final = 255
"""System id of a ground station, in whose network it stands."""
_AUTOPILOT: Final = int(mav.MAV_COMP_ID_AUTOPILOT1)
_NAME_CHARS: Final = 16
"""Size of param_id in PARAM_SET."""
_RELATIVE: Final = 2.0**-23
"""A value has passed through 32-bit floating point, whose rounding this is."""
_READ: Final = frozenset((
    mav.MAVLINK_MSG_ID_PARAM_SET, mav.MAVLINK_MSG_ID_COMMAND_LONG, mav.MAVLINK_MSG_ID_COMMAND_INT,
    mav.MAVLINK_MSG_ID_MISSION_COUNT, mav.MAVLINK_MSG_ID_MISSION_CLEAR_ALL,
    mav.MAVLINK_MSG_ID_MISSION_WRITE_PARTIAL_LIST, mav.MAVLINK_MSG_ID_FENCE_POINT,
))  # fmt: skip

_ASKS: Final = frozenset((mav.MAVLINK_MSG_ID_PARAM_REQUEST_READ, mav.MAVLINK_MSG_ID_PARAM_SET))


def _names(names: tuple[str, ...]) -> tuple[str, ...]:
    for place, name in enumerate(names):
        if not (0 < len(name) <= _NAME_CHARS and name.isascii() and name == name.upper()):
            expected = f"a parameter's name: 1 to {_NAME_CHARS} capital ASCII characters"
            raise refuse(Problem(str(place), repr(name), expected))
    if len(set(names)) < len(names):
        raise refuse(Problem("", repr(list(names)), "each parameter once"))
    return names


_Names = Annotated[tuple[str, ...], BeforeValidator(items, json_schema_input_type=list[str]), AfterValidator(_names)]


class ParameterWatch(Protected):
    """What is locked, and what is watched."""

    at: Literal["companion", "proxy"] = Field(
        default="proxy",
        description="Where it is: companion, at its end of the gcs link, or proxy, at its end of the autopilot link, "
        "where frames of the companion pass too.",
    )
    allowed: _Names = Field(
        default=(), description="Parameters that may be set while the aircraft is armed, such as ['WPNAV_SPEED']."
    )
    watched: _Names = Field(
        default=(
            "FS_GCS_ENABLE", "FS_GCS_TIMEOUT", "MAV_GCS_SYSID", "FS_EKF_ACTION", "FS_EKF_THRESH", "FS_CRASH_CHECK",
            "BATT_FS_LOW_ACT", "BATT_FS_CRT_ACT", "FENCE_ENABLE", "FENCE_ACTION", "FENCE_TYPE", "FENCE_RADIUS",
            "FENCE_ALT_MAX",
        ),
        description="Parameters that are read in turn, and set back where they changed while the aircraft is armed; "
        "by default those of failsafes and of the fence.",
    )  # fmt: skip
    every_s: Number = Field(
        default=0.5, ge=0.05, le=3600, description="Time in seconds between two parameters that are read."
    )
    fence: bool = Field(
        default=True,
        strict=True,
        description="Whether the fence is locked too: DO_FENCE_ENABLE and uploads of a fence while the aircraft is "
        "armed.",
    )


@dataclass(slots=True)
class ParameterTap(DefenceTap):
    """Locks and watches the parameters of one aircraft."""

    system: int
    params: ParameterWatch
    packer: Packer
    alarm: Alarm
    schedule: Schedule
    armed: bool = False
    known: dict[str, tuple[float, int]] = field(default_factory=dict)
    """Values of watched parameters, and their types, as the autopilot told them."""
    due: Time | None = 0
    turn: int = 0
    """Parameters that were asked for so far."""
    asked: dict[str, int] = field(default_factory=dict)
    """The turn in which each was asked for last."""

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """Drop what is locked; learn and compare values."""
        number = message_id(frame.payload)
        if frame.direction == "rev":
            if number == mav.MAVLINK_MSG_ID_HEARTBEAT:
                message = read(frame.payload)
                if message is not None and message.autopilot != mav.MAV_AUTOPILOT_INVALID:
                    self.armed = bool(message.base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED)
            elif number == mav.MAVLINK_MSG_ID_PARAM_VALUE:
                return self._compare(now, frame.payload)
            return ()
        if number not in _READ:
            return ()
        what = self._find_locked(now, frame.payload)
        if not what:
            return ()
        return [Drop(), *self.alarm.raise_at(now, "parameter.lock", 1.0, what=what)]

    def next_wakeup(self) -> Time | None:
        """When the next parameter is read."""
        return self.due

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """Ask for the next parameter."""
        if self.due is None or now < self.due:
            return ()
        self.due = now + from_seconds(self.params.every_s)
        if now < self.schedule.start_ns or not self.params.watched:
            return ()
        name = self._choose()
        return [self._say(mav.MAVLink_param_request_read_message(self.system, _AUTOPILOT, name.encode(), -1))]

    def _choose(self) -> str:
        """The parameter that was not asked for the longest time; that of one that is not known counts twice.

        So values are learned before the aircraft is armed, and a parameter that the autopilot does not have keeps the
        watch from no other.
        """
        self.turn += 1
        ages = {
            name: (self.turn - self.asked.get(name, 0)) * (1 if name in self.known else 2)
            for name in self.params.watched
        }
        name = max(ages, key=ages.__getitem__)
        self.asked[name] = self.turn
        return name

    def _find_locked(self, now: Time, payload: bytes) -> str:
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
            return "" if name in self.params.allowed else f"PARAM_SET {name}"
        if not self.armed or not self.params.fence:
            return ""
        if number in (mav.MAVLINK_MSG_ID_COMMAND_LONG, mav.MAVLINK_MSG_ID_COMMAND_INT):
            return "DO_FENCE_ENABLE" if message.command == mav.MAV_CMD_DO_FENCE_ENABLE else ""
        if number == mav.MAVLINK_MSG_ID_FENCE_POINT:
            return "FENCE_POINT"
        return "fence upload" if message.mission_type == mav.MAV_MISSION_TYPE_FENCE else ""

    def _compare(self, now: Time, payload: bytes) -> Sequence[Verdict]:
        """Learn a value while disarmed; set it back where it differs while armed."""
        message = read(payload)
        name = "" if message is None else _clean(message.param_id)
        if message is None or name not in self.params.watched or not math.isfinite(message.param_value):
            return ()
        value, kind = float(message.param_value), int(message.param_type)
        if not self.armed or name not in self.known:
            self.known[name] = value, kind
            return ()
        right, _ = self.known[name]
        if name in self.params.allowed:
            self.known[name] = value, kind
            return ()
        if abs(value - right) <= _RELATIVE * abs(right):
            return ()
        restore = mav.MAVLink_param_set_message(self.system, _AUTOPILOT, name.encode(), right, kind)
        alarm = self.alarm.raise_at(now, "parameter.changed", 1.0, what=name, value=value, right=right)
        return [self._say(restore), *alarm]

    def _say(self, message: Message) -> Inject:
        return Inject(self.packer.pack(message), "fwd", *ends_of(self.link, "fwd"))


def _clean(name: object) -> str:
    """A param_id as text."""
    text = name.decode("ascii", "replace") if isinstance(name, bytes) else str(name)
    return text.split("\0", 1)[0].upper()


@dataclass(frozen=True, slots=True)
class _Maker:
    """Makes the tap of a link."""

    params: ParameterWatch
    vehicles: tuple[tuple[str, str, int], ...]
    schedule: Schedule

    def __call__(self, link: str) -> ParameterTap:
        vehicle, system = next((one, number) for name, one, number in self.vehicles if name == link)
        return ParameterTap(link, system, self.params, Packer(_STATION, COMPONENT), Alarm(vehicle), self.schedule)


def _is_read(frame: Frame) -> bool:
    """Whether the content of a frame is read."""
    number = message_id(frame.payload)
    return number in _READ if frame.direction == "fwd" else number == mav.MAVLINK_MSG_ID_PARAM_VALUE


def make(params: ParameterWatch, context: DefenceContext) -> Defence:
    """The parts. Raises `InputError` for aircraft that the scenario does not have."""
    vehicles = find_protected(params, context)
    role = "gcs" if params.at == "companion" else "autopilot"
    known = tuple((link_name(role, one), one, context.vehicles[one].system_id) for one in vehicles)
    taps = place_taps(role, params.at, vehicles, context, TapMaker(_Maker(params, known, context.schedule)), _is_read)
    watched = frozenset(params.watched)
    parts = [Exclusive(f"parameters of {vehicle}", watched) for vehicle in vehicles] if watched else []
    rules: list[PathRule] = []
    for end in ends_at(role, params.at, vehicles):
        rules.append(Passes(end, "fwd", drops=frozenset((mav.MAVLINK_MSG_ID_PARAM_SET,))))
        if watched:
            rules.append(Sends(end, "fwd", _ASKS))
    return Defence(taps=taps, exclusive=parts, path_rules=rules)


WATCH = DefencePlugin(
    ParameterWatch,
    make,
    "Locks parameters and fence while the aircraft is armed, and sets back watched parameters that changed.",
    surface=("gcs", "log", "autopilot"),
    place="the proxy's end of the autopilot link, or the companion's end of the gcs link; knows the frames that pass",
    effect="drops what sets parameters or the fence while armed, and sets back what changed nevertheless",
    alerts=("parameter.lock", "parameter.changed"),
    against=("mavlink.parameter", "mavlink.fence"),
    evasion="sets parameters before the aircraft is armed, or beyond the lock those that are not watched, or shows the "
    "watch the old values",
    cost="a request on board every `every_s`, and its answer, which goes on to the station",
    nominal=("inject",),
    realism={"PARAM_SET and PARAM_VALUE": "cited: https://mavlink.io/en/services/parameter.html, GCS_Param.cpp"},
)
