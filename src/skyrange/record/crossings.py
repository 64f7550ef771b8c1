"""What became of the frames that went from one node to another? One row each, made of its sender's and receiver's."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pyarrow as pa

from skyrange.agent.frames import Fate
from skyrange.core.time import NEVER, NS_PER_S, Time
from skyrange.record.matching import TOLERANCE_NS, LaneMatching, Sent
from skyrange.record.order import interleaved
from skyrange.record.parts import FRAME_COLUMNS, INCOMING, Part
from skyrange.record.renames import UNRECORDED, Lane

OUTSIDE = "outside"
"""The sender of a frame that came in and that no node of the range sent."""

_RETRANSMITTED_NS = 60 * NS_PER_S  # a lossy reliable channel may hold a frame so long, and longer if it fails again
_SWEEP_NS = NS_PER_S
_ROW = (*FRAME_COLUMNS, "payload", "part")
_PLACE = {name: place for place, name in enumerate(_ROW)}

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
"""Frames as they are passed on: `parent` and `causes` are ids as part number `part` has them."""


@dataclass(frozen=True, slots=True)
class Border:
    """One lane between nodes."""

    src: str
    dst: str
    reliable: bool
    grace_ns: Time
    """How long a frame may be under way as far as the channel goes."""


def borders(header: Mapping[str, Any]) -> dict[Lane, Border]:
    """Both lanes of every link that the header declares, by (link, direction)."""
    found = {}
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
            found[link["name"], direction] = Border(src, dst, reliable, grace)
    return found


class Spans:
    """When was each endpoint recorded?"""

    def __init__(self, parts: Sequence[Part]) -> None:
        """`parts` in order of time; a complete one lasted as long as any."""
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
        """Until when it was recorded; before all times if it was not."""
        return max((until for _, until in self._spans.get(endpoint, ())), default=-NEVER)

    def recorded(self, endpoint: str, at: Time) -> bool:
        """Whether its node was recording then; from the run's start on if it had but one."""
        return any(start <= at <= until for start, until in self._spans.get(endpoint, ()))


class Crossings:
    """Matches the frames that crossed, and tells each part the true ids of what came in."""

    def __init__(self, parts: Sequence[Part], lanes: Mapping[Lane, Border], spans: Spans) -> None:
        self._parts = {part.number: part for part in parts}
        self._lanes = lanes
        self._spans = spans
        self._matching: dict[Lane, LaneMatching[tuple[Any, ...]]] = {}
        self._strangers: dict[tuple[Lane, str], int] = {}
        self._out: list[tuple[Any, ...]] = []
        self.counts = {"matched": 0, "ambiguous": 0, "outside": 0, "unrecorded": 0, "lost": 0, "in_flight": 0}
        """Frames that were matched, those of them that another frame of the same bytes could have been, frames from
        outside or from a node whose record of them is lost, and frames sent that never came in."""

    def rows(self) -> Iterator[pa.RecordBatch]:
        """All frames that crossed, nearly in order of sending, in the columns of `ROWS`."""
        swept = -NEVER
        streams = [part.frames(crossing=True) for part in self._parts.values()]
        for table in interleaved(streams, "key_ns", ("how", "part", "order")):
            columns = {name: table.column(name).to_pylist() for name in table.column_names}
            rows = zip(*(columns[name] for name in _ROW), strict=True)
            marks = zip(columns["key_ns"], columns["how"], columns["order"], columns["left_ns"], strict=True)
            for row, (key, how, order, left) in zip(rows, marks, strict=True):
                if key - swept >= _SWEEP_NS:
                    swept = key
                    self._sweep(key)
                if how == INCOMING:
                    self._received(row)
                else:
                    self._sent(row, order, left)
            yield self._take()
        for lane, matching in self._matching.items():
            for frame, overtaken in matching.rest():
                self._missing(lane, frame, overtaken)
            self.counts["ambiguous"] += matching.ambiguous
        yield self._take()

    def _sent(self, row: tuple[Any, ...], order: int, left: Time) -> None:
        lane = row[:2]
        matching = self._matching.get(lane)
        if matching is None:
            matching = self._matching[lane] = LaneMatching(self._lanes[lane].reliable)
        number = (row[_PLACE["part"]] << 48) | order  # parts are numbered in order of time
        frame = Sent(number, row[_PLACE["sent_ns"]], left, row[_PLACE["payload"]], row)
        if frame.sent_ns <= self._spans.end(self._lanes[lane].dst) + TOLERANCE_NS:
            matching.sent(frame)
        else:
            self._missing(lane, frame, False)

    def _received(self, row: tuple[Any, ...]) -> None:
        lane = row[:2]
        at = row[_PLACE["sent_ns"]]
        matching = self._matching.get(lane)
        found = matching.received(at, row[_PLACE["payload"]]) if matching is not None else None
        if found is None:
            src = self._lanes[lane].src
            known = src not in self._spans or self._spans.recorded(src, at - TOLERANCE_NS)
            sender = OUTSIDE if known else UNRECORDED
            serial = self._strangers.get((lane, sender), 0)
            self._strangers[lane, sender] = serial + 1
            self.counts["outside" if known else "unrecorded"] += 1
            self._emit(row, sender=sender, serial=serial)
        else:
            self.counts["matched"] += 1
            sender, serial = found.row[_PLACE["sender"]], found.row[_PLACE["serial"]]
            self._emit(found.row, arrived_ns=row[_PLACE["arrived_ns"]], fate=row[_PLACE["fate"]])
        self._parts[row[_PLACE["part"]]].renames.put(lane, row[_PLACE["serial"]], sender, serial)

    def _sweep(self, now: Time) -> None:
        for lane, matching in self._matching.items():
            for frame in matching.expired(now - TOLERANCE_NS):
                self._missing(lane, frame, False)

    def _missing(self, lane: Lane, frame: Sent[tuple[Any, ...]], overtaken: bool) -> None:
        border = self._lanes[lane]
        lost = self._spans.recorded(border.dst, frame.left_ns) and (
            overtaken or self._spans.recorded(border.dst, frame.left_ns + border.grace_ns)
        )
        fate = Fate.LOST if lost else Fate.IN_FLIGHT
        self.counts[str(fate)] += 1
        self._emit(frame.row, fate=str(fate))

    def _emit(self, row: tuple[Any, ...], **changed: object) -> None:
        values = list(row)
        for name, value in changed.items():
            values[_PLACE[name]] = value
        self._out.append(tuple(values))

    def _take(self) -> pa.RecordBatch:
        out, self._out = self._out, []
        columns = zip(*out, strict=True) if out else [()] * len(_ROW)
        return pa.RecordBatch.from_arrays(
            [pa.array(column, field.type) for column, field in zip(columns, ROWS, strict=True)], schema=ROWS
        )
