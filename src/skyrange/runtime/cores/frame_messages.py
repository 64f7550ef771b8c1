"""Bytes of frames that go from one core to another: single frames as JSON and payloads, blocks as columns."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Final

import numpy as np
import pyarrow as pa

from skyrange.contracts.frames import Fate, Frame, FrameBlock, LinkTable, Payloads
from skyrange.contracts.mailboxes import Arrival, Inbox
from skyrange.core.ids import FrameId, Port
from skyrange.kernel import Transit

_SIZE: Final = struct.Struct("<q")
_TRANSMISSIONS: Final = pa.schema(
    [(name, pa.string()) for name in ("link", "direction", "sender")]
    + [(name, pa.int64()) for name in ("serial", "sent_ns", "arrived_ns")]
    + [("payload", pa.binary())]
)


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
            name, direction, sender, serial, src, dst, sent_ns=sent_ns, payload=payload,
            parent=None if parent is None else FrameId(*parent), causes=tuple(FrameId(*cause) for cause in causes),
        )  # fmt: skip
        yield Transit(arrival, link, frame)


def pack_inbox(inbox: Inbox) -> bytes:
    """What arrived: single frames, then the rows of all blocks."""
    rows = [
        [arrival.port.endpoint, arrival.port.link, arrival.at, len(arrival.payload), arrival.src, arrival.ref]
        for arrival in inbox.singles
    ]
    singles = _pack_rows(rows, [arrival.payload for arrival in inbox.singles]) if rows else b""
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
        for (endpoint, link, when, _, src, ref), payload in (_unpack_rows(data[_SIZE.size : at], 3) if size else ())
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
    singles = [arrival for inbox in inboxes for arrival in inbox.singles]
    blocks = [block for inbox in inboxes for block in inbox.blocks]
    parts = []
    if singles:
        rows = [(*arrival.ref, arrival.at, arrival.at, arrival.payload) for arrival in singles]
        columns = [
            pa.array(column, field.type) for column, field in zip(zip(*rows, strict=True), _TRANSMISSIONS, strict=True)
        ]
        parts.append(pa.Table.from_arrays(columns, schema=_TRANSMISSIONS))
    if blocks:
        parts.append(_list_rows(blocks))
    if not parts:
        return None
    table = pa.concat_tables(parts).combine_chunks()
    return table.set_column(0, "link", table.column("link").dictionary_encode())


def _list_rows(blocks: Sequence[FrameBlock]) -> pa.Table:
    """The frames of blocks of one table of links."""
    names = blocks[0].link_table.names
    numbers = np.concatenate([block.link_numbers for block in blocks])
    used, place = np.unique(numbers, return_inverse=True)
    ends = [names[number] for number in used.tolist()]
    sizes = [len(block) for block in blocks]
    payloads = Payloads.join(block.carried() for block in blocks)
    offsets = np.zeros(len(numbers) + 1, dtype=np.int32)
    np.cumsum(payloads.sizes, out=offsets[1:])
    columns = [
        *(pa.array([end[field] for end in ends], pa.string()).take(pa.array(place)) for field in range(3)),
        pa.array(np.concatenate([block.serial for block in blocks])),
        pa.array(np.repeat([block.sent_ns for block in blocks], sizes)),
        pa.array(np.repeat([block.arrived_ns for block in blocks], sizes)),
        pa.BinaryArray.from_buffers(
            pa.binary(), len(numbers), [None, pa.py_buffer(offsets), pa.py_buffer(payloads.data)]
        ),
    ]
    return pa.Table.from_arrays(columns, schema=_TRANSMISSIONS)


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
            links,
            numbers[chosen],
            serials[chosen],
            int(sent[chosen[0]]),
            when,
            Fate.DELIVERED,
            payloads=payloads,
            rows=chosen,
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
