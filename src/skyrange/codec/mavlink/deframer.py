"""Incremental MAVLink deframer: splits a byte stream into frames and garbage.

A frame is what `mavlink.decode` accepts. Everything else is garbage. When a checksum is wrong, flags are unknown or a
message id is outside the dialect (its checksum cannot be verified without the definition), the search resumes at the
byte after the frame's magic byte, so that no good frame inside is lost. (pymavlink's parser skips the whole bad frame
instead, so a frame hidden in the payload of a bad one is found here and not there.)
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import NamedTuple

from skyrange.codec.mavlink.frames import (
    CHECKSUM,
    HEADER_V1,
    HEADER_V2,
    LAYOUTS,
    MAGIC_V2,
    SIGNATURE,
    SIGNED,
    checksum,
)

MAGIC = re.compile(rb"[\xfd\xfe]")


class Piece(NamedTuple):
    """A run of the stream: one whole valid frame, or consecutive garbage bytes."""

    data: bytes
    garbage: bool


@dataclass(slots=True)
class DeframerCounts:
    """Counters of one stream; they do not depend on how the stream was cut into chunks.

    `bad_checksums` and `unknown_messages` count positions where a frame could have begun, so bytes in garbage that
    merely look like a magic byte count as well.
    """

    frames: int = 0
    garbage_bytes: int = 0
    bad_checksums: int = 0
    unknown_messages: int = 0
    truncated: int = 0
    """Streams that ended inside a possible frame: at most one per `finish`."""


class Deframer:
    """Splits arbitrary chunks of one stream into frames and garbage, without losing or adding a byte.

    Holds back at most one incomplete frame (under 280 bytes) between calls.
    """

    __slots__ = ("_pending", "counts")

    def __init__(self) -> None:
        self._pending = b""
        self.counts = DeframerCounts()

    def feed(self, data: bytes) -> list[Piece]:
        """The pieces that `data` completes, in stream order; adjacent garbage bytes form one piece."""
        return self._scan(self._pending + data, ended=False)

    def finish(self) -> list[Piece]:
        """End the stream: search what was held back again for whole frames. The deframer is then ready for another
        stream.
        """
        return self._scan(self._pending, ended=True)

    def _scan(self, buffer: bytes, *, ended: bool) -> list[Piece]:
        pieces: list[Piece] = []
        counts = self.counts
        size = len(buffer)
        garbage_from = at = 0
        truncated = False
        while True:
            match = MAGIC.search(buffer, at)
            if match is None:
                at = size
                break
            at = match.start()
            end = frame_end(buffer, at, size)
            if end > size:
                if not ended:
                    break
                truncated = True
            elif end == UNKNOWN_MESSAGE:
                counts.unknown_messages += 1
            elif end == BAD_CHECKSUM:
                counts.bad_checksums += 1
            elif end > 0:
                self._add_garbage(pieces, buffer[garbage_from:at])
                pieces.append(Piece(buffer[at:end], garbage=False))
                counts.frames += 1
                garbage_from = at = end
                truncated = False
                continue
            at += 1
        self._add_garbage(pieces, buffer[garbage_from:at])
        self._pending = buffer[at:]
        counts.truncated += truncated
        return pieces

    def _add_garbage(self, pieces: list[Piece], data: bytes) -> None:
        if data:
            pieces.append(Piece(data, garbage=True))
            self.counts.garbage_bytes += len(data)


_BAD_FLAGS = 0
UNKNOWN_MESSAGE = -1
BAD_CHECKSUM = -2


def frame_end(buffer: bytes, at: int, size: int) -> int:
    """The end of the frame whose magic byte is at `at`: beyond `size` while more bytes are needed.

    0 or less if there is no frame: `UNKNOWN_MESSAGE`, `BAD_CHECKSUM`, or 0 for unknown flags.
    """
    undecided = size + 1
    available = size - at
    if buffer[at] == MAGIC_V2:
        if available < 3:
            return undecided
        flags = buffer[at + 2]
        if flags & ~SIGNED:
            return _BAD_FLAGS
        if available < HEADER_V2:
            return undecided
        number = buffer[at + 7] | buffer[at + 8] << 8 | buffer[at + 9] << 16
        covered_end = at + HEADER_V2 + buffer[at + 1]
        end = covered_end + CHECKSUM + (SIGNATURE if flags else 0)
    else:
        if available < HEADER_V1:
            return undecided
        number = buffer[at + 5]
        covered_end = at + HEADER_V1 + buffer[at + 1]
        end = covered_end + CHECKSUM
    layout = LAYOUTS.get(number)
    if layout is None:
        return UNKNOWN_MESSAGE
    if covered_end + CHECKSUM > size:
        return undecided
    crc = checksum(buffer[at + 1 : covered_end], layout.crc_extra)
    if buffer[covered_end] | buffer[covered_end + 1] << 8 != crc:
        return BAD_CHECKSUM
    return end
