"""Messages between skyrange and a radio engine that is another program: layouts, encoding and checked decoding.

`docs/reference/medium-protocol.md` specifies the protocol. All numbers are little-endian; all times are integer
nanoseconds of simulated time. Nothing is allocated from a length before the length has been checked.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum, IntFlag
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.codec import message_header
from skyrange.codec.message_header import HEADER as HEADER
from skyrange.codec.message_header import pack as pack
from skyrange.core.errors import DecodeError

VERSION: Final = 1
MAGIC: Final = b"SKYMEDIA"
MAX_BODY_BYTES: Final = 1 << 28
"""The longest body of a message."""
ORIGIN_NS: Final = -(1 << 42)
"""No message has an earlier time (−73 minutes): a simulator without negative times counts from here."""
NO_RADIO: Final = 0xFFFF_FFFF
"""In a noise row: the power arises at the receivers themselves."""

Rows = NDArray[np.void]

TRANSMISSION: Final = np.dtype(
    [
        ("key", "<i8"), ("at_ns", "<i8"), ("power_dbm", "<f8"), ("radio", "<u4"), ("size_bytes", "<u4"),
        ("waveform", "<u2"), ("channel", "<u2"), ("first_path", "<u4"), ("paths", "<u4"), ("zero", "<u4"),
    ]
)  # fmt: skip
NOISE: Final = np.dtype(
    [
        ("from_ns", "<i8"), ("to_ns", "<i8"), ("centre_mhz", "<f8"), ("width_mhz", "<f8"), ("power_dbm", "<f8"),
        ("radio", "<u4"), ("first_path", "<u4"), ("paths", "<u4"), ("zero", "<u4"),
    ]
)  # fmt: skip
PATH: Final = np.dtype([("gain_db", "<f8"), ("radio", "<u4"), ("zero", "<u4")])
SENT: Final = np.dtype(
    [("key", "<i8"), ("started_ns", "<i8"), ("ended_ns", "<i8"), ("radio", "<u4"), ("channel", "<u2"), ("fate", "<u2")]
)
HEARD: Final = np.dtype(
    [
        ("key", "<i8"), ("ended_ns", "<i8"), ("rssi_dbm", "<f8"), ("snir_db", "<f8"), ("radio", "<u4"),
        ("channel", "<u2"), ("outcome", "<u2"),
    ]
)  # fmt: skip

_HELLO = struct.Struct("<8sIIQqdB7xIII")
_RADIO = struct.Struct("<Qd")
_BUILDING = struct.Struct("<ddI")
_READY = struct.Struct("<8sIIIIq")
_ADVANCE = struct.Struct("<qqIIII")
_DONE = struct.Struct("<QIII4x")
_FORKED = struct.Struct("<I")
_TEXT = struct.Struct("<I")
_COUNT = struct.Struct("<I4x")


class MessageType(IntEnum):
    """Types of messages; an answer repeats the number of its request."""

    HELLO = 1
    ADVANCE = 2
    FORK = 3
    """Carries one file descriptor: the stream socket of the copy."""
    CLOSE = 4
    PATH_LOSSES = 5
    READY = 129
    """Answers HELLO."""
    DONE = 130
    """Answers ADVANCE."""
    FORKED = 131
    """Answers FORK, on the old socket and on the new one."""
    LOSSES = 133
    """Answers PATH_LOSSES."""
    FAILED = 255
    """May answer any request, and is the last message."""


class Ability(IntFlag):
    """Abilities that an engine declares in READY."""

    FORKS = 1
    OWN_LOSSES = 2
    REPEATS = 4


class EngineRadio(NamedTuple):
    """A radio as an engine gets to know it."""

    name: str
    stream: int
    """64 bits that depend on the name alone: the address of its random numbers."""
    noise_figure_db: float


class Building(NamedTuple):
    """A building as an engine gets it: a prism."""

    base_m: float
    top_m: float
    corners_m: NDArray[np.float64]
    """(k, 2), east and north, without a repeated last corner."""


@dataclass(frozen=True)
class Hello:
    """The first message: all that an engine needs to know before time begins."""

    seed: int
    horizon_m: float
    own_losses: bool
    """Whether the engine computes path losses; `gain_db` is then that of the antennas alone."""
    radios: Sequence[EngineRadio]
    params: Mapping[str, str] = field(default_factory=dict)
    buildings: Sequence[Building] = ()
    """Empty unless `own_losses`."""


class Ready(NamedTuple):
    """An engine's answer to `Hello`."""

    name: str
    release: str
    """Versions of the engine and of its simulator, for the record."""
    waveforms: int
    """Bit w: the engine simulates `Waveform` w."""
    abilities: Ability
    lookahead_ns: int


class Advance(NamedTuple):
    """A request to let time pass."""

    until_ns: int
    """Inclusive."""
    places_from_ns: int
    places: NDArray[np.float64] | None
    """(radios, 3) ENU metres, NaN for an absent radio; None if unchanged."""
    transmissions: Rows
    """`TRANSMISSION`"""
    noise: Rows
    """`NOISE`"""
    paths: Rows
    """`PATH`: the receivers of each row, `paths` of them from `first_path` on."""


class Done(NamedTuple):
    """What happened up to the end of an advance."""

    active: int
    """Frames of which more is to be told."""
    events: int
    """Events that the engine processed since its start."""
    sent: Rows
    """`SENT`"""
    heard: Rows
    """`HEARD`"""


def unpack_header(header: bytes) -> tuple[int, MessageType, int]:
    """Length of the body, type and number of a message whose 12 first bytes are `header`. Raises `DecodeError`."""
    return message_header.unpack(header, MessageType, MAX_BODY_BYTES)


class _Reader:
    """Checked reading of a body."""

    def __init__(self, body: bytes) -> None:
        self._view = memoryview(body)
        self._at = 0

    def take(self, count: int) -> memoryview:
        if count > len(self._view) - self._at:
            raise DecodeError(f"a body of {len(self._view)} bytes that ends within a field")
        piece = self._view[self._at : self._at + count]
        self._at += count
        return piece

    def fields(self, layout: struct.Struct) -> tuple[Any, ...]:
        return layout.unpack(self.take(layout.size))

    def rows(self, layout: np.dtype[Any], count: int) -> Rows:
        return np.frombuffer(self.take(count * layout.itemsize), dtype=layout).copy()

    def text(self) -> str:
        (length,) = self.fields(_TEXT)
        try:
            return bytes(self.take(length)).decode()
        except UnicodeDecodeError:
            raise DecodeError("a text that is not UTF-8") from None

    def end(self) -> None:
        if self._at != len(self._view):
            raise DecodeError(f"a body of {len(self._view)} bytes, of which {self._at} were expected")


def _text(value: str) -> bytes:
    data = value.encode()
    return _TEXT.pack(len(data)) + data


def encode_hello(hello: Hello) -> bytes:
    """The body of a HELLO. Raises `ValueError` for a parameter whose text cannot stand on a line of its own."""
    for name, value in hello.params.items():
        if "=" in name or "\n" in name + value:
            raise ValueError(f"the parameter {name!r} = {value!r}")
    params = "".join(f"{name}={value}\n" for name, value in hello.params.items())
    parts = [
        _HELLO.pack(
            MAGIC, VERSION, 0, hello.seed & 0xFFFF_FFFF_FFFF_FFFF, ORIGIN_NS, hello.horizon_m, hello.own_losses,
            len(hello.radios), len(hello.buildings), 0,
        ),
        _text(params),
    ]  # fmt: skip
    for radio in hello.radios:
        parts += [_RADIO.pack(radio.stream, radio.noise_figure_db), _text(radio.name)]
    for building in hello.buildings:
        corners = np.ascontiguousarray(building.corners_m, dtype="<f8")
        parts += [_BUILDING.pack(building.base_m, building.top_m, len(corners)), corners.tobytes()]
    return b"".join(parts)


def _check_version(magic: bytes, version: int) -> None:
    if magic != MAGIC:
        raise DecodeError(f"a greeting that begins with {magic!r} instead of {MAGIC!r}")
    if version != VERSION:
        raise DecodeError(f"version {version} of the medium protocol; this is version {VERSION}")


def decode_ready(body: bytes) -> Ready:
    """Decode a READY."""
    reader = _Reader(body)
    magic, version, waveforms, abilities, _, lookahead_ns = reader.fields(_READY)
    _check_version(magic, version)
    ready = Ready(reader.text(), reader.text(), waveforms, Ability(abilities & 7), lookahead_ns)
    reader.end()
    if not 0 <= lookahead_ns <= 10**9:
        raise DecodeError(f"a look-ahead of {lookahead_ns} ns")
    return ready


def encode_advance(advance: Advance) -> bytes:
    """The body of an ADVANCE."""
    places = b"" if advance.places is None else np.ascontiguousarray(advance.places, dtype="<f8").tobytes()
    return b"".join(
        (
            _ADVANCE.pack(
                advance.until_ns, advance.places_from_ns, advance.places is not None, len(advance.transmissions),
                len(advance.noise), len(advance.paths),
            ),
            places,
            np.ascontiguousarray(advance.transmissions, dtype=TRANSMISSION).tobytes(),
            np.ascontiguousarray(advance.noise, dtype=NOISE).tobytes(),
            np.ascontiguousarray(advance.paths, dtype=PATH).tobytes(),
        )
    )  # fmt: skip


def decode_done(body: bytes) -> Done:
    """Decode a DONE; what its rows say is not checked."""
    reader = _Reader(body)
    events, active, sent, heard = reader.fields(_DONE)
    done = Done(active, events, reader.rows(SENT, sent), reader.rows(HEARD, heard))
    reader.end()
    return done


def encode_path_losses(ends_m: NDArray[np.float64]) -> bytes:
    """The body of a PATH_LOSSES: (k, 6), the two ends of each path in ENU metres."""
    ends = np.ascontiguousarray(ends_m, dtype="<f8").reshape(-1, 6)
    return _COUNT.pack(len(ends)) + ends.tobytes()


def decode_losses(body: bytes) -> NDArray[np.float64]:
    """Decode a LOSSES."""
    return _decode_floats(body, 1)[:, 0]


def _decode_floats(body: bytes, width: int) -> NDArray[np.float64]:
    reader = _Reader(body)
    (count,) = reader.fields(_COUNT)
    rows = np.frombuffer(reader.take(8 * width * count), dtype="<f8").reshape(count, width).copy()
    reader.end()
    return rows


def decode_forked(body: bytes) -> int:
    """Decode a FORKED."""
    reader = _Reader(body)
    (pid,) = reader.fields(_FORKED)
    reader.end()
    return int(pid)


def decode_failed(body: bytes) -> str:
    """Decode a FAILED."""
    reader = _Reader(body)
    reason = reader.text()
    reader.end()
    return reason
