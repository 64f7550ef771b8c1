"""Bytes of frames that go from one core to another: single frames as JSON and payloads, blocks as columns."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Final

import numpy as np
import pyarrow as pa

from skyrange.contracts.frames.blocks import FrameBlock, LinkTable
from skyrange.contracts.frames.frame import Fate, Frame
from skyrange.contracts.frames.payloads import Payloads
from skyrange.contracts.mailboxes import Arrival, Inbox
from skyrange.core.ids import FrameId, Port
from skyrange.kernel import Transit

_SIZE: Final = struct.Struct("<q")


def pack_transits(transits: Iterable[Transit]) -> bytes:
    """Frames under way."""
    rows, payloads = [], []
    for arrival, link, frame in transits:
        rows.append(
            [arrival, link, frame.link, frame.direction, frame.sender, frame.serial, frame.src, frame.dst,
             frame.sent_ns, len(frame.payload), frame.parent, frame.causes]
        )  # fmt: skip
        payloads.append(frame.payload)
    return _pack_rows(rows, payloads) if rows else b""


def unpack_transits(data: bytes) -> Iterator[Transit]:
    """What `pack_transits` packed."""
    for row, payload in _unpack_rows(data, 9) if data else ():
        arrival, link, name, direction, sender, serial, src, dst, sent_ns, _, parent, causes = row
        frame = Frame(
            name, direction, sender, serial, src, dst, sent_ns, payload,
            None if parent is None else FrameId(*parent), tuple(FrameId(*cause) for cause in causes),
        )  # fmt: skip
        yield Transit(arrival, link, frame)


def pack_inbox(inbox: Inbox) -> bytes:
    """What arrived: single frames, then the rows of all blocks."""
    rows = [[*arrival.port, arrival.at, len(arrival.payload), arrival.src, arrival.ref] for arrival in inbox.singles]
    singles = _pack_rows(rows, [arrival.payload for arrival in inbox.singles])
    blocks = inbox.blocks
    if not blocks:
        return _SIZE.pack(len(singles)) + singles
    payloads = Payloads.join(block.carried() for block in blocks)
    columns = np.stack(
        [
            np.concatenate([block.link_numbers for block in blocks]),
            np.concatenate([block.serial for block in blocks]),
            np.concatenate([np.full(len(block), block.sent_ns) for block in blocks]),
            np.concatenate([np.full(len(block), block.arrived_ns) for block in blocks]),
            payloads.sizes,
        ]
    )
    return b"".join(
        [_SIZE.pack(len(singles)), singles, _SIZE.pack(columns.shape[1]), columns.tobytes(), payloads.data.tobytes()]
    )


def unpack_inbox(data: bytes, links: LinkTable) -> Inbox:
    """What `pack_inbox` packed in any process, whose links have the numbers of `links`."""
    (size,) = _SIZE.unpack_from(data)
    at = _SIZE.size + size
    singles = [
        Arrival(Port(endpoint, link), when, payload, src, FrameId(*ref))
        for (endpoint, link, when, _, src, ref), payload in _unpack_rows(data[_SIZE.size : at], 3)
    ]
    return Inbox(singles, list(_unpack_blocks(data, at, links)) if at < len(data) else [])


def merge_inboxes(parts: Sequence[Inbox]) -> Inbox:
    """One inbox of several."""
    singles = sorted((arrival for part in parts for arrival in part.singles), key=_order)
    return Inbox(singles, [block for part in parts for block in part.blocks])


def list_transmissions(inboxes: Iterable[Inbox]) -> pa.Table | None:
    """The frames in some inboxes as `frames` has them: link, direction, sender, serial, times and payload; None without
    any. Of a single frame the time of sending is not known, and that of its arrival taken.
    """
    rows: list[tuple[str, str, str, int, int, int, bytes]] = []
    for inbox in inboxes:
        rows += [(*arrival.ref, arrival.at, arrival.at, arrival.payload) for arrival in inbox.singles]
        for block in inbox.blocks:
            for row in range(len(block)):
                rows.append((*block.id(row), block.sent_ns, block.arrived_ns, block.payload(row)))
    if not rows:
        return None
    names = ("link", "direction", "sender", "serial", "sent_ns", "arrived_ns", "payload")
    kinds = (*[pa.string()] * 3, *[pa.int64()] * 3, pa.binary())
    columns = [pa.array(column, kind) for column, kind in zip(zip(*rows, strict=True), kinds, strict=True)]
    table = pa.table(dict(zip(names, columns, strict=True)))
    link = table.column("link").dictionary_encode()
    return table.set_column(0, "link", link)


def _unpack_blocks(data: bytes, at: int, links: LinkTable) -> Iterator[FrameBlock]:
    """The rows as blocks of one arrival time each."""
    (rows,) = _SIZE.unpack_from(data, at)
    at += _SIZE.size
    columns = np.frombuffer(data, dtype=np.int64, count=5 * rows, offset=at).reshape(5, rows)
    numbers, serials, sent, arrived, sizes = columns
    bodies = np.frombuffer(data, dtype=np.uint8, offset=at + columns.nbytes)
    payloads = Payloads(bodies, np.cumsum(sizes) - sizes, sizes)
    for when in np.unique(arrived).tolist():
        chosen = np.flatnonzero(arrived == when)
        yield FrameBlock(
            links, numbers[chosen], serials[chosen], int(sent[chosen[0]]), when, Fate.DELIVERED, payloads, chosen
        )


def _order(arrival: Arrival) -> tuple[int, str, str, int]:
    ref = arrival.ref
    return arrival.at, f"{ref.link}:{ref.direction}", ref.sender, ref.serial


def _pack_rows(rows: Sequence[Any], payloads: Sequence[bytes]) -> bytes:
    head = json.dumps(rows, separators=(",", ":")).encode()
    return b"".join([_SIZE.pack(len(head)), head, *payloads])


def _unpack_rows(data: bytes, size_at: int) -> Iterator[tuple[list[Any], bytes]]:
    """Each row, whose element `size_at` is the size of its payload, and the payload."""
    (size,) = _SIZE.unpack_from(data)
    at = _SIZE.size + size
    for row in json.loads(data[_SIZE.size : at]):
        end = at + row[size_at]
        yield row, data[at:end]
        at = end
