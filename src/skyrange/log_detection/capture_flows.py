"""MAVLink in the UDP and TCP flows of a capture: its frames, and which end of a flow is the ground station."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from skyrange.codec.internet_packets import Address, Segment
from skyrange.codec.mavlink import Deframer, Piece
from skyrange.log_detection.mavlink_systems import SystemCounts, read_head

STATION_PORT: Final = 14550
"""Of ground stations (mavlink.io, and `export.packet_captures`)."""
MOST_FLOWS: Final = 1024
_MOST_WAITING: Final = 64
_MOST_WAITING_BYTES: Final = 1 << 16
_WRAP: Final = 1 << 32
_HALF: Final = 1 << 31


class Flow(NamedTuple):
    """One direction between two sockets."""

    is_tcp: bool
    source: Address
    target: Address

    @property
    def pair(self) -> Pair:
        """Both directions."""
        ends = sorted((self.source, self.target))
        return Pair(self.is_tcp, ends[0], ends[1])


class Pair(NamedTuple):
    """Two sockets between which frames are sent, in order."""

    is_tcp: bool
    a: Address
    b: Address


@dataclass(slots=True)
class FlowCounts:
    """What was left out."""

    garbage_bytes: int = 0
    """Of UDP and TCP payloads: bytes of no frame."""
    lost_segments: int = 0
    """Gaps of TCP streams, after which the search for a frame begins anew."""
    flows_left_out: int = 0
    """Segments of flows beyond `MOST_FLOWS`."""


class _Stream:
    """One direction of a TCP connection, put in order."""

    def __init__(self) -> None:
        self.deframer = Deframer()
        self._next: int | None = None
        self._waiting: OrderedDict[int, bytes] = OrderedDict()

    def add(self, segment: Segment, counts: FlowCounts) -> bytes:
        """The bytes that are in order with a segment."""
        if segment.begins:
            self._next, self._waiting = (segment.sequence + 1) % _WRAP, OrderedDict()
        if not segment.payload:
            return b""
        if self._next is None:
            self._next = segment.sequence
        self._waiting[segment.sequence] = segment.payload
        data = self._take_ready()
        waiting_bytes = sum(map(len, self._waiting.values()))
        if (
            len(self._waiting) > _MOST_WAITING or waiting_bytes > _MOST_WAITING_BYTES
        ):  # what is missing was not captured
            counts.lost_segments += 1
            self._next = min(self._waiting, key=self._ahead)
            self.deframer = Deframer()
            data += self._take_ready()
        return data

    def _ahead(self, sequence: int) -> int:
        return (sequence - (self._next or 0)) % _WRAP

    def _take_ready(self) -> bytes:
        ready = b""
        while True:
            for sequence in list(self._waiting):
                ahead = self._ahead(sequence)
                payload = self._waiting[sequence]
                behind = _WRAP - ahead if ahead >= _HALF else 0
                if ahead and not behind:
                    continue
                del self._waiting[sequence]
                fresh = payload[behind:]
                if fresh:
                    ready += fresh
                    self._next = ((self._next or 0) + len(fresh)) % _WRAP
                    break
            else:
                return ready


@dataclass(slots=True)
class FlowReader:
    """Splits segments into frames, in one pass over a capture."""

    counts: FlowCounts = field(default_factory=FlowCounts)
    _streams: dict[Flow, _Stream] = field(default_factory=dict)

    def read(self, segment: Segment) -> Iterator[tuple[bytes, bool]]:
        """The frames that a segment completes, with True; and bytes that belong to none, with False."""
        for data, garbage in self._split(segment):
            self.counts.garbage_bytes += len(data) if garbage else 0
            yield data, not garbage

    def _split(self, segment: Segment) -> Iterator[Piece]:
        if not segment.is_tcp:
            if segment.payload:
                deframer = Deframer()
                yield from deframer.feed(segment.payload)
                yield from deframer.finish()
            return
        flow = Flow(segment.is_tcp, segment.source, segment.target)
        stream = self._streams.get(flow)
        if stream is None:
            if len(self._streams) >= 2 * MOST_FLOWS:
                self.counts.flows_left_out += 1
                return
            stream = self._streams[flow] = _Stream()
        yield from stream.deframer.feed(stream.add(segment, self.counts))


@dataclass(slots=True)
class FlowSurvey:
    """The MAVLink in both directions of each pair of sockets."""

    directions: dict[Flow, SystemCounts] = field(default_factory=dict)
    left_out: int = 0
    """Frames of pairs beyond `MOST_FLOWS`."""

    def add(self, flow: Flow, frame: bytes) -> None:
        """Count a frame."""
        counts = self.directions.get(flow)
        if counts is None:
            if len(self.directions) >= 2 * MOST_FLOWS:
                self.left_out += 1
                return
            counts = self.directions[flow] = SystemCounts()
        counts.add(read_head(frame), frame)

    def pairs(self) -> list[Pair]:
        """All pairs with MAVLink, in order."""
        return sorted({flow.pair for flow in self.directions})

    def counts(self, pair: Pair) -> tuple[SystemCounts, SystemCounts]:
        """What went from `a` to `b`, and what went back."""
        none = SystemCounts()
        there, back = Flow(pair.is_tcp, pair.a, pair.b), Flow(pair.is_tcp, pair.b, pair.a)
        return self.directions.get(there, none), self.directions.get(back, none)

    def find_station(self, pair: Pair) -> tuple[Address, str]:
        """The end of a pair at which the ground station is, and by what that is told."""
        there, back = self.counts(pair)
        if bool(there.vehicles) != bool(back.vehicles):
            return (pair.b if there.vehicles else pair.a), "the heartbeats of an autopilot"
        if bool(there.stations) != bool(back.stations):
            return (pair.a if there.stations else pair.b), "the ids of a ground station"
        if (pair.a.port == STATION_PORT) != (pair.b.port == STATION_PORT):
            return (pair.a if pair.a.port == STATION_PORT else pair.b), f"port {STATION_PORT}"
        return pair.a, "a guess: its address is the lower one"
