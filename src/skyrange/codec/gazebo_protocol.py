"""Messages between skyrange and its plugin in Gazebo: layouts, encoding and checked decoding.

skyrange sends HELLO once, then STEP for each tick of its world; the plugin answers each with READY or STEPPED, or with
FAILED. All numbers are little-endian; vectors are in the local frame, east-north-up in metres, rates in the body frame,
forward-left-up. Nothing is allocated from a length before the length has been checked.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.codec import message_header
from skyrange.codec.message_header import HEADER as HEADER
from skyrange.codec.message_header import pack as pack
from skyrange.core.errors import DecodeError

VERSION: Final = 1
MAGIC: Final = b"SKYGAZEB"
MAX_BODY_BYTES: Final = 1 << 26
"""The longest body of a message."""
MAX_TEXT_BYTES: Final = 4096

CONTACT: Final = np.dtype(
    [
        ("vehicle", "<u4"), ("other", "<i4"), ("rotor", "<i4"), ("other_rotor", "<i4"),
        ("position_m", "<f8", (3,)), ("normal", "<f8", (3,)), ("depth_m", "<f8"),
    ]
)  # fmt: skip
"""`other` is the other aircraft's number, or -1 less the number of a building; `rotor` is -1 for the frame. The normal
has length 1 and points from the other to the aircraft."""
STATE_NUMBERS: Final = 13
"""Numbers of an aircraft's state: centre of gravity (3), its velocity (3), quaternion w, x, y, z, body rates (3)."""
INPUT_NUMBERS: Final = 9
"""Numbers of an aircraft's inputs beside its rotor speeds: air (3), impulse (3), angular impulse (3)."""
POSE_NUMBERS: Final = 7
"""Numbers of a shown body's pose: position of its gear (3), quaternion w, x, y, z."""

_HELLO = struct.Struct("<8sIIIIId")
_READY = struct.Struct("<8sI")
_STEP = struct.Struct("<q")
_STEPPED = struct.Struct("<qI4x")
_LENGTH = struct.Struct("<I")

Floats = NDArray[np.float64]


class MessageType(IntEnum):
    """Types of messages; an answer repeats the number of its request."""

    HELLO = 1
    STEP = 2
    READY = 129
    """Answers HELLO."""
    STEPPED = 130
    """Answers STEP."""
    FAILED = 255
    """May answer any request, and is the last message."""


class Aircraft(NamedTuple):
    """An aircraft that Gazebo moves."""

    model: str
    """The name of its model in the world."""
    thrust_ns2: float
    torque_arm_m: float
    rotor_drag_ns2: float
    body_drag: float
    """Drag in N per (m/s)²."""
    spin_drag: float
    """Torque in N·m per (rad/s)²."""
    rotors: Sequence[tuple[float, float, float]]
    """Forward m, left m, and direction of rotation of each (+1 counter-clockwise from above)."""


class Stepped(NamedTuple):
    """Answer to a step."""

    states: Floats
    """(n, 13) `STATE_NUMBERS` of each aircraft."""
    contacts: NDArray[np.void]
    """(k,) of `CONTACT`."""


def unpack_header(data: bytes) -> tuple[int, MessageType, int]:
    """Length of the body, type and number of a message. Raises `DecodeError`."""
    return message_header.unpack(data, MessageType, MAX_BODY_BYTES)


def encode_hello(aircraft: Sequence[Aircraft], shown: Sequence[str], step_s: float, steps: int, motors: int) -> bytes:
    """The body of HELLO: `steps` of `step_s` make a tick; `shown` are the models of bodies that Gazebo only shows."""
    parts = [_HELLO.pack(MAGIC, VERSION, len(aircraft), len(shown), motors, steps, step_s)]
    for airframe in aircraft:
        numbers = [
            airframe.thrust_ns2,
            airframe.torque_arm_m,
            airframe.rotor_drag_ns2,
            airframe.body_drag,
            airframe.spin_drag,
        ]
        numbers += [number for rotor in airframe.rotors for number in rotor]
        parts += [_text(airframe.model), np.array(numbers, dtype="<f8").tobytes()]
    return b"".join([*parts, *map(_text, shown)])


def encode_step(tick_ns: int, inputs: Floats, shown: Floats) -> bytes:
    """The body of STEP: `inputs` (n, motors + `INPUT_NUMBERS`) and `shown` (m, `POSE_NUMBERS`)."""
    return _STEP.pack(tick_ns) + inputs.astype("<f8").tobytes() + shown.astype("<f8").tobytes()


def decode_ready(body: bytes) -> tuple[str, str]:
    """Gazebo's version and its physics engine. Raises `DecodeError`, also for a plugin of another version."""
    if len(body) < _READY.size:
        raise DecodeError(f"a READY of {len(body)} bytes")
    magic, version = _READY.unpack_from(body)
    if magic != MAGIC or version != VERSION:
        raise DecodeError(f"version {version} of the protocol, expected {VERSION}")
    release, at = _take_text(body, _READY.size)
    physics, at = _take_text(body, at)
    if at != len(body):
        raise DecodeError(f"a READY with {len(body) - at} bytes too many")
    return release, physics


def decode_failed(body: bytes) -> str:
    """What went wrong. Raises `DecodeError`."""
    text, at = _take_text(body, 0)
    if at != len(body):
        raise DecodeError(f"a FAILED with {len(body) - at} bytes too many")
    return text


def decode_stepped(body: bytes, tick_ns: int, count: int, buildings: int) -> Stepped:
    """States and contacts of `count` aircraft after the tick `tick_ns`, among a number of `buildings`.

    Raises `DecodeError` for another tick, a wrong length, a number that is not finite, and a contact of an aircraft or
    a building that does not exist.
    """
    if len(body) < _STEPPED.size:
        raise DecodeError(f"a STEPPED of {len(body)} bytes")
    tick, touches = _STEPPED.unpack_from(body)
    if tick != tick_ns:
        raise DecodeError(f"the tick {tick}, expected {tick_ns}")
    middle = _STEPPED.size + count * STATE_NUMBERS * 8
    if len(body) != middle + touches * CONTACT.itemsize:
        raise DecodeError(f"a STEPPED of {len(body)} bytes for {count} aircraft and {touches} contacts")
    states = np.frombuffer(body, "<f8", count * STATE_NUMBERS, _STEPPED.size).reshape(count, STATE_NUMBERS)
    contacts = np.frombuffer(body, CONTACT, touches, middle)
    if not np.isfinite(states).all():
        row = int(np.flatnonzero(~np.isfinite(states).all(axis=1))[0])
        raise DecodeError(f"a state of aircraft {row} that is not a number: {states[row].tolist()}")
    if touches and not _are_valid(contacts, count, buildings):
        raise DecodeError("a contact of an aircraft or a building that does not exist")
    return Stepped(states, contacts)


def _are_valid(contacts: NDArray[np.void], count: int, buildings: int) -> bool:
    numbers = np.concatenate([contacts["position_m"], contacts["normal"]], axis=1)
    other = contacts["other"]
    known = (contacts["vehicle"] < count) & (other < count) & (other >= -buildings)
    return bool(known.all() and np.isfinite(numbers).all())


def _text(text: str) -> bytes:
    data = text.encode()
    return _LENGTH.pack(len(data)) + data


def _take_text(body: bytes, at: int) -> tuple[str, int]:
    """The text at `at`, and where it ends."""
    if at + _LENGTH.size > len(body):
        raise DecodeError("a text without a length")
    (length,) = _LENGTH.unpack_from(body, at)
    at += _LENGTH.size
    if length > MAX_TEXT_BYTES or at + length > len(body):
        raise DecodeError(f"a text of {length} bytes")
    return body[at : at + length].decode("utf-8", "replace"), at + length
