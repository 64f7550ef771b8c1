"""Frames that crossed from one node to another: one row each, made from the sender's and the receiver's record."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pyarrow as pa

from skyrange.contracts.frames import Fate
from skyrange.core.time import NEVER, NS_PER_S, Time
from skyrange.record.live_merge.frame_matching import TOLERANCE_NS, UNRECORDED, FrameMatcher, LinkDirection, SentFrame
from skyrange.record.live_merge.node_record import FRAME_COLUMNS, INCOMING, NodeRecord
from skyrange.record.read.time_order import merge_sorted

OUTSIDE = "outside"
"""The sender of a frame that was received but that no node of the range sent."""

_RETRANSMITTED_NS = (
    60 * NS_PER_S
)  # a lossy reliable channel may delay a frame so long, and longer if retransmissions are lost too
_SWEEP_NS = NS_PER_S
_ROW = (*FRAME_COLUMNS, "payload", "part")
_INDEX = {name: place for place, name in enumerate(_ROW)}

ROWS = pa.schema(
    [
        *((name, pa.string()) for name in ("link", "direction", "sender")),
        ("serial", pa.int64()),
        *((name, pa.string()) for name in ("src", "dst")),
        *((name, pa.int64()) for name in ("sent_ns", "arrived_ns")),
        *((name, pa.string()) for name in ("fate", "parent")),
        ("causes", pa.list_(pa.string())),
        ("payload", pa.binary()),
        ("part", pa.int64()),
    ]
)
"""Columns of matched frames: `parent` and `causes` are ids as recorded by part number `part`."""


@dataclass(frozen=True, slots=True)
class DirectionSpec:
    """One direction of a link, as the header declares it."""

    src: str
    dst: str
    reliable: bool
    grace_ns: Time
    """Longest time that the channel may delay a frame."""


def direction_specs(header: Mapping[str, Any]) -> dict[LinkDirection, DirectionSpec]:
    """Both directions of every link that the header declares, by (link, direction)."""
    specs = {}
    for link in header.get("links") or ():
        channel = link.get("channel") or {}
        reliable = channel.get("mode") == "reliable"
        grace = int(channel.get("latency_ns", 0)) + int(channel.get("jitter_ns", 0)) + TOLERANCE_NS
        if channel.get("reorder"):
            grace += int(channel.get("reorder_ns", 0))
        if channel.get("rate_bps"):
            grace += int(channel.get("queue_bytes", 0) * 8 * NS_PER_S / channel["rate_bps"])
        if channel.get("duplicate"):
            grace += int(channel.get("latency_ns", 0))
        if reliable and channel.get("loss"):
            grace += _RETRANSMITTED_NS
        for direction, src, dst in (("fwd", link["a"], link["b"]), ("rev", link["b"], link["a"])):
            specs[link["name"], direction] = DirectionSpec(src, dst, reliable, grace)
    return specs


class RecordingSpans:
    """Time spans in which each endpoint was recorded."""

    def __init__(self, parts: Sequence[NodeRecord]) -> None:
        """`parts` are in order of time; a complete part lasted until the end of the run."""
        self._spans: dict[str, list[tuple[Time, Time]]] = {}
        end = max((part.last_ns for part in parts), default=-NEVER)
        for part in parts:
            until = part.until_ns
            if until is None:
                until = end if part.status == "complete" else part.last_ns
            for endpoint in part.endpoints:
                spans = self._spans.setdefault(endpoint, [])
                spans.append((part.first_ns if spans else -NEVER, until))

    def __contains__(self, endpoint: str) -> bool:
        return endpoint in self._spans

    def end(self, endpoint: str) -> Time:
        """The end of the endpoint's last span; `-NEVER` if it was not recorded."""
        return max((until for _, until in self._spans.get(endpoint, ())), default=-NEVER)

    def recorded(self, endpoint: str, at: Time) -> bool:
        """Whether the endpoint's node was recording at time `at`; its first span begins with the run."""
        return any(start <= at <= until for start, until in self._spans.get(endpoint, ()))


class CrossingMatcher:
    """Matches frames that crossed between nodes, and gives each part the true ids of the frames it received."""

    def __init__(
        self, parts: Sequence[NodeRecord], directions: Mapping[LinkDirection, DirectionSpec], spans: RecordingSpans
    ) -> None:
        self._parts = {part.number: part for part in parts}
        self._directions = directions
        self._spans = spans
        self._matching: dict[LinkDirection, FrameMatcher[tuple[Any, ...]]] = {}
        self._unknown_counts: dict[tuple[LinkDirection, str], int] = {}
        self._out: list[tuple[Any, ...]] = []
        self.counts = {"matched": 0, "ambiguous": 0, "outside": 0, "unrecorded": 0, "lost": 0, "in_flight": 0}
        """Numbers of matched frames, of matches for which another frame with the same bytes was a candidate, of frames
        from outside or from a node whose record of them is lost, and of frames sent but never received."""

    def rows(self) -> Iterator[pa.RecordBatch]:
        """All frames that crossed, nearly in order of sending, with the columns of `ROWS`."""
        swept = -NEVER
        streams = [part.frames(crossing=True) for part in self._parts.values()]
        for table in merge_sorted(streams, "key_ns", ("how", "part", "order")):
            columns = {name: table.column(name).to_pylist() for name in table.column_names}
            rows = zip(*(columns[name] for name in _ROW), strict=True)
            marks = zip(columns["key_ns"], columns["how"], columns["order"], columns["left_ns"], strict=True)
            for row, (key, how, order, left) in zip(rows, marks, strict=True):
                if key - swept >= _SWEEP_NS:
                    swept = key
                    self._sweep(key)
                if how == INCOMING:
                    self._add_received(row)
                else:
                    self._add_sent(row, order, left)
            yield self._take_batch()
        for direction_key, matching in self._matching.items():
            for frame, overtaken in matching.remaining():
                self._add_missing(direction_key, frame, overtaken=overtaken)
            self.counts["ambiguous"] += matching.ambiguous
        yield self._take_batch()

    def _add_sent(self, row: tuple[Any, ...], order: int, left: Time) -> None:
        direction_key = row[:2]
        matching = self._matching.get(direction_key)
        if matching is None:
            matching = self._matching[direction_key] = FrameMatcher(reliable=self._directions[direction_key].reliable)
        number = (row[_INDEX["part"]] << 48) | order  # parts are numbered in order of time
        frame = SentFrame(number, row[_INDEX["sent_ns"]], left, row[_INDEX["payload"]], row)
        if frame.sent_ns <= self._spans.end(self._directions[direction_key].dst) + TOLERANCE_NS:
            matching.add_sent(frame)
        else:
            self._add_missing(direction_key, frame, overtaken=False)

    def _add_received(self, row: tuple[Any, ...]) -> None:
        direction_key = row[:2]
        at = row[_INDEX["sent_ns"]]
        matching = self._matching.get(direction_key)
        sent_frame = matching.match_received(at, row[_INDEX["payload"]]) if matching is not None else None
        if sent_frame is None:
            src = self._directions[direction_key].src
            known = src not in self._spans or self._spans.recorded(src, at - TOLERANCE_NS)
            sender = OUTSIDE if known else UNRECORDED
            serial = self._unknown_counts.get((direction_key, sender), 0)
            self._unknown_counts[direction_key, sender] = serial + 1
            self.counts["outside" if known else "unrecorded"] += 1
            self._emit(row, sender=sender, serial=serial)
        else:
            self.counts["matched"] += 1
            sender, serial = sent_frame.row[_INDEX["sender"]], sent_frame.row[_INDEX["serial"]]
            self._emit(sent_frame.row, arrived_ns=row[_INDEX["arrived_ns"]], fate=row[_INDEX["fate"]])
        self._parts[row[_INDEX["part"]]].id_map.add(direction_key, row[_INDEX["serial"]], sender, serial)

    def _sweep(self, now: Time) -> None:
        for direction_key, matching in self._matching.items():
            for frame in matching.expired(now - TOLERANCE_NS):
                self._add_missing(direction_key, frame, overtaken=False)

    def _add_missing(self, direction_key: LinkDirection, frame: SentFrame[tuple[Any, ...]], *, overtaken: bool) -> None:
        spec = self._directions[direction_key]
        lost = self._spans.recorded(spec.dst, frame.left_ns) and (
            overtaken or self._spans.recorded(spec.dst, frame.left_ns + spec.grace_ns)
        )
        fate = Fate.LOST if lost else Fate.IN_FLIGHT
        self.counts[str(fate)] += 1
        self._emit(frame.row, fate=str(fate))

    def _emit(self, row: tuple[Any, ...], **changed: object) -> None:
        values = list(row)
        for name, value in changed.items():
            values[_INDEX[name]] = value
        self._out.append(tuple(values))

    def _take_batch(self) -> pa.RecordBatch:
        out, self._out = self._out, []
        columns = zip(*out, strict=True) if out else [()] * len(_ROW)
        return pa.RecordBatch.from_arrays(
            [pa.array(column, field.type) for column, field in zip(columns, ROWS, strict=True)], schema=ROWS
        )
