"""Telemetry logs (`.tlog`) read as a stream: frames, each after the time at which it was received or sent.

Before each frame are 8 bytes, big endian: microseconds since 1970 UTC (QGroundControl developer guide, "MAVLink log
format"). A frame is what `codec.mavlink.decode` accepts. After anything else the search goes on at the next frame that
has a time before it that can be.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from io import BufferedIOBase
from typing import Final, NamedTuple

from skyrange.codec.mavlink.deframer import BAD_CHECKSUM, MAGIC, UNKNOWN_MESSAGE, frame_end
from skyrange.codec.mavlink.frames import CHECKSUM, HEADER_V1, HEADER_V2, MAGIC_V1, MAGIC_V2, SIGNATURE, SIGNED

STAMP: Final = 8
_CHUNK: Final = 1 << 20
_LONGEST: Final = HEADER_V2 + 255 + CHECKSUM + SIGNATURE
_MAGICS: Final = frozenset({MAGIC_V1, MAGIC_V2})


def is_time(data: bytes) -> bool:
    """Whether eight bytes are microseconds since 1970 of the years 2005 to 2100."""
    return 1_104_537_600_000_000 <= int.from_bytes(data, "big") < 4_102_444_800_000_000


class LoggedFrame(NamedTuple):
    """A frame of a log."""

    time_us: int
    """Since 1970 UTC, as the log says."""
    data: bytes


@dataclass(slots=True)
class LogCounts:
    """What was in a log, in one pass over it."""

    frames: int = 0
    bad_bytes: int = 0
    """Bytes that belong to no frame and to no time of one, those of bad checksums included."""
    bad_checksums: int = 0
    """Places at which a frame was due, and its checksum was wrong."""
    unknown_messages: int = 0
    """Frames of messages that the dialect does not have, so that their checksums cannot be verified."""
    unknown_bytes: int = 0
    """Bytes of these frames and of their times."""
    cut_bytes: int = 0
    """Bytes at the end that are the begin of a frame."""


def read_frames(file: BufferedIOBase, counts: LogCounts) -> Iterator[LoggedFrame]:
    """The frames of a log from the present place of `file` on; what is met is added to `counts`.

    Holds a chunk of 1 MiB in memory.
    """
    buffer = b""
    at, is_last = 0, False
    while not is_last:
        chunk = file.read(_CHUNK)
        is_last = not chunk
        buffer, at = buffer[at:] + chunk, 0
        size = len(buffer)
        while at + STAMP < size and (is_last or at + 2 * (STAMP + _LONGEST) <= size):
            end = _end_at(buffer, at, size)
            if 0 < end <= size:
                yield LoggedFrame(int.from_bytes(buffer[at : at + STAMP], "big"), buffer[at + STAMP : end])
                counts.frames += 1
                at = end
                continue
            if end == UNKNOWN_MESSAGE and (after := _end_of_unknown(buffer, at, size)):
                counts.unknown_messages += 1
                counts.unknown_bytes += after - at
                at = after
                continue
            found, resume = _find_frame(buffer, at, size, is_last=is_last)
            if end > size and found is None:
                counts.cut_bytes += size - at
                return
            counts.bad_checksums += end == BAD_CHECKSUM
            counts.bad_bytes += (resume if found is None else found) - at
            at = resume if found is None else found
    counts.cut_bytes += max(len(buffer) - at, 0)


def _end_at(buffer: bytes, at: int, size: int) -> int:
    """The end of the frame whose time is at `at`, as `frame_end`."""
    return frame_end(buffer, at + STAMP, size) if buffer[at + STAMP] in _MAGICS else 0


def _end_of_unknown(buffer: bytes, at: int, size: int) -> int:
    """The end of a frame of an unknown message if another time and frame, or nothing, follow it; else 0."""
    start = at + STAMP
    length = buffer[start + 1]
    if buffer[start] == MAGIC_V2:
        end = start + HEADER_V2 + length + CHECKSUM + (SIGNATURE if buffer[start + 2] & SIGNED else 0)
    else:
        end = start + HEADER_V1 + length + CHECKSUM
    follows = end == size or (
        end + STAMP < size and buffer[end + STAMP] in _MAGICS and is_time(buffer[end : end + STAMP])
    )
    return end if follows and is_time(buffer[at:start]) else 0


def _find_frame(buffer: bytes, at: int, size: int, *, is_last: bool) -> tuple[int | None, int]:
    """Where the time of the next good frame after `at` is, None if there is none; and from where to search on."""
    place = at + STAMP + 1
    while (match := MAGIC.search(buffer, place)) is not None:
        start = match.start()
        end = frame_end(buffer, start, size)
        if end > size and not is_last:
            return None, max(start - STAMP, at + 1)  # its rest is in the next chunk
        if 0 < end <= size and is_time(buffer[start - STAMP : start]):
            return start - STAMP, start
        place = start + 1
    return None, max(size - STAMP, at + 1)
