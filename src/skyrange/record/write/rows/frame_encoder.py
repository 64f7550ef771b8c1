"""Encoding of frames and frame blocks into Arrow batches and rows of hash words.

Names and parents' origins are numbered once and then looked up. Blocks already consist of columns; single frames are
gathered into columns with a few list comprehensions. There is no per-frame work for blocks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from operator import attrgetter
from typing import NamedTuple, cast

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from skyrange.contracts.frames import Fate, Frame, FrameBlock, Ints, LinkTable, Payloads
from skyrange.core.ids import FrameId, hash64
from skyrange.record.digests import Words
from skyrange.record.message_groups import group_messages
from skyrange.record.write.rows.payloads import PayloadDeduplicator

_FATES = {fate: number for number, fate in enumerate(Fate)}
_FLOW = attrgetter("link", "direction", "sender", "src", "dst")
_CAUSES = attrgetter("causes")
_FATE_NAMES = pa.array([str(fate) for fate in Fate], pa.string())
_FATE_HASHES = np.array([hash64(str(fate)) for fate in Fate], dtype=np.uint64)
_NEVER_ARRIVED = np.uint64(0xFFFFFFFFFFFFFFFF)  # hashed as the arrival time of a frame that did not arrive


_NAMES = pa.dictionary(pa.int32(), pa.string())
FRAME_SPOOL = pa.schema(
    [
        ("link", _NAMES),
        ("direction", _NAMES),
        ("sender", _NAMES),
        ("serial", pa.int64()),
        ("src", _NAMES),
        ("dst", _NAMES),
        ("sent_ns", pa.int64()),
        ("arrived_ns", pa.int64()),
        ("fate", _NAMES),
        ("payload_id", pa.int64()),
        ("size", pa.int32()),
        ("parent_before", _NAMES),
        ("parent_serial", pa.int64()),
        ("causes", pa.list_(pa.string())),
    ]
)
"""Spooled frames: the schema of the table with dictionary-encoded names and a parent's id in two columns."""


class _Numbers(dict[tuple[str, ...], int]):
    """Numbers keys in the order of their first lookup."""

    def __missing__(self, key: tuple[str, ...]) -> int:
        number = len(self)
        self[key] = number
        return number


class EncodedFrames(NamedTuple):
    """One batch: Arrow rows of frames, Arrow rows of new payloads, and the digest's words (n, 10).

    `last_ns` is the latest sending time.
    """

    frames: pa.RecordBatch
    payloads: pa.RecordBatch
    words: Words
    last_ns: int


class FrameColumns(NamedTuple):
    """Columns of some frames, arrays with one row per frame. `origin` is -1 without a parent.

    `group` is that of `message_groups`, and has no rows unless it is wanted.
    """

    flow: Ints
    serial: Ints
    sent: Ints
    arrived: Ints
    fate: NDArray[np.int32]
    size: NDArray[np.int32]
    payload_id: Ints
    hashes: Words
    origin: Ints
    parent_serial: Ints
    group: NDArray[np.uint8]


class _NumberedPayloads(NamedTuple):
    """A column of payloads: the start of the window of their ids, and columns of `FrameColumns`."""

    window: int
    ids: Ints
    hashes: Words
    sizes: Ints
    groups: NDArray[np.uint8]


class GatheredFrames(NamedTuple):
    """Some frames in columns. `causes` has the ids of the frames that commanded a row, in order of rows."""

    columns: FrameColumns
    causes: Mapping[int, Sequence[str]]

    @property
    def rows(self) -> int:
        """How many frames these are."""
        return len(self.columns.flow)

    @property
    def last_ns(self) -> int:
        """The latest time of sending."""
        return int(self.columns.sent.max())


_NO_GROUP = np.zeros(0, dtype=np.uint8)


class FrameEncoder:
    """Encodes frames as columns. Its state is the numbering so far. Deep-copyable."""

    def __init__(self, window_bytes: int, first_payload: int = 0, *, with_groups: bool = False) -> None:
        """`window_bytes` of distinct payloads are de-duplicated together and kept in memory; their ids count from
        `first_payload`, a multiple of `PAYLOAD_WINDOW`. `with_groups` gives frames a `group`.
        """
        self._payloads = PayloadDeduplicator(window_bytes, first_payload)
        self._with_groups = with_groups
        self._flows = _Numbers()  # (link, direction, sender, src, dst)
        self._origins = _Numbers()  # (link, direction, sender) of parents
        self._names = _Numbers()  # (name,)
        self._flow_names = np.zeros((0, 5), dtype=np.int32)
        self._flow_hashes = np.zeros(0, dtype=np.uint64)
        self._origin_hashes = np.zeros(0, dtype=np.uint64)
        self._id_prefixes = pa.array([], pa.string())  # of each origin, the text of an id before its serial
        self._dictionary = pa.array([], pa.string())
        self._link_table: LinkTable | None = None
        self._link_flows = np.zeros((0, 2), dtype=np.int64)  # flow and origin of each directed link; -1 if unused

    def encode(self, observed: Sequence[Frame | FrameBlock]) -> EncodedFrames:
        """Encode what was observed, in that order; the frames are not changed."""
        gathered = self.gather(observed)
        return EncodedFrames(self.table(gathered), self.take_payloads(), self.words(gathered), gathered.last_ns)

    def gather(self, observed: Sequence[Frame | FrameBlock]) -> GatheredFrames:
        """What was observed as columns, in that order."""
        gathered = []
        numbered: dict[int, _NumberedPayloads] = {}
        causes: dict[int, list[str]] = {}
        rows = 0
        for link_table, run in groupby(observed, _link_table_of):
            if link_table is not None:
                blocks = cast("list[FrameBlock]", list(run))
                gathered.append(self._block_columns(blocks, numbered))
                for block in blocks:
                    commanded = enumerate(block.causes or ())
                    causes |= {rows + row: [str(c) for c in known] for row, known in commanded if known}
                    rows += len(block)
                continue
            frames = cast("list[Frame]", list(run))
            if any(map(_CAUSES, frames)):
                causes |= {rows + row: [str(c) for c in f.causes] for row, f in enumerate(frames) if f.causes}
            gathered.append(self._frame_columns(frames))
            rows += len(frames)
        self._extend_lookup()
        return GatheredFrames(FrameColumns(*map(np.concatenate, zip(*gathered, strict=True))), causes)

    @property
    def flows(self) -> list[tuple[str, ...]]:
        """Link, direction, sender, source and destination of each flow, by its number."""
        return list(self._flows)

    def take_payloads(self) -> pa.RecordBatch:
        """Rows of `payloads`: those that are new since the last call."""
        return self._payloads.take_new()

    def forget_payloads(self) -> None:
        """Leave out the payloads that are new since the last call, as if they had been taken."""
        self._payloads.skip_new()

    def table(self, gathered: GatheredFrames, chosen: Ints | None = None) -> pa.RecordBatch:
        """Rows of `frames` as in the spool; with `chosen`, these rows without causes."""
        table, causes = gathered
        if chosen is not None:
            kept = {name: getattr(table, name)[chosen] for name in FrameColumns._fields if name != "group"}
            table, causes = FrameColumns(**kept, group=_NO_GROUP), {}
        lost = table.fate != _FATES[Fate.DELIVERED]
        codes = self._flow_names[table.flow]
        columns = [pa.DictionaryArray.from_arrays(pa.array(codes[:, place]), self._dictionary) for place in range(5)]
        return pa.RecordBatch.from_arrays(
            [
                columns[0],
                columns[1],
                columns[2],
                pa.array(table.serial),
                columns[3],
                columns[4],
                pa.array(table.sent),
                pa.array(table.arrived, mask=lost),
                pa.DictionaryArray.from_arrays(pa.array(table.fate), _FATE_NAMES),
                pa.array(table.payload_id),
                pa.array(table.size),
                pa.DictionaryArray.from_arrays(
                    pa.array(table.origin.astype(np.int32), mask=table.origin < 0), self._id_prefixes
                ),
                pa.array(table.parent_serial),
                _lists(causes, len(table.flow)),
            ],
            schema=FRAME_SPOOL,
        )

    def words(self, gathered: GatheredFrames) -> Words:
        """The words of the digest of frames, (n, 10)."""
        table = gathered.columns
        lost = table.fate != _FATES[Fate.DELIVERED]
        words = np.empty((gathered.rows, 10), dtype=np.uint64)
        words[:, 0] = self._flow_hashes[table.flow]
        words[:, 1] = table.serial.view(np.uint64)
        words[:, 2] = table.sent.view(np.uint64)
        words[:, 3] = np.where(lost, _NEVER_ARRIVED, table.arrived.view(np.uint64))
        words[:, 4] = _FATE_HASHES[table.fate]
        words[:, 5:7] = table.hashes
        words[:, 7] = self._origin_hashes[table.origin] if len(self._origin_hashes) else 0
        words[table.origin < 0, 7] = 0  # no parent; the serial beside it is then -1
        words[:, 8] = table.parent_serial.view(np.uint64)
        words[:, 9] = 0
        for row, ids in gathered.causes.items():
            words[row, 9] = hash64("\n".join(ids))
        return words

    def _frame_columns(self, frames: Sequence[Frame]) -> FrameColumns:
        rows = len(frames)
        payloads = Payloads.of([f.payload for f in frames])
        payload_id, hashes = self._payloads.assign_ids(payloads)
        parents = [f.parent for f in frames]
        origins = self._origins
        return FrameColumns(
            # keys are made and dropped one by one: many live containers would trigger the garbage collector
            flow=np.fromiter(map(self._flows.__getitem__, map(_FLOW, frames)), np.int64, rows),
            serial=np.fromiter([f.serial for f in frames], np.int64, rows),
            sent=np.fromiter([f.sent_ns for f in frames], np.int64, rows),
            arrived=np.fromiter([f.arrived_ns for f in frames], np.int64, rows),
            fate=np.fromiter(map(_FATES.__getitem__, [f.fate for f in frames]), np.int32, rows),
            size=payloads.sizes.astype(np.int32),
            payload_id=payload_id,
            hashes=hashes,
            origin=np.fromiter([-1 if p is None else origins[p[:3]] for p in parents], np.int64, rows),
            parent_serial=np.fromiter([-1 if p is None else p[3] for p in parents], np.int64, rows),
            group=self._groups(payloads),
        )

    def _groups(self, payloads: Payloads) -> NDArray[np.uint8]:
        return group_messages(payloads) if self._with_groups else _NO_GROUP

    def _block_columns(self, blocks: Sequence[FrameBlock], numbered: dict[int, _NumberedPayloads]) -> FrameColumns:
        """`numbered` caches what the hops of one block share."""
        carried = [self._number_block(block, numbered) for block in blocks]
        rows = np.array([len(block) for block in blocks])
        link_table = blocks[0].link_table
        above = np.concatenate([_or_none(block.parent_link_numbers, len(block)) for block in blocks])
        origin, children = np.full(len(above), -1, dtype=np.int64), above >= 0
        origin[children] = self._look_up(link_table, above[children], 1)
        return FrameColumns(
            flow=self._look_up(link_table, np.concatenate([block.link_numbers for block in blocks]), 0),
            serial=np.concatenate([block.serial for block in blocks]),
            sent=np.repeat([block.sent_ns for block in blocks], rows),
            arrived=np.repeat([block.arrived_ns for block in blocks], rows),
            fate=np.repeat(np.array([_FATES[block.fate] for block in blocks], dtype=np.int32), rows),
            size=np.concatenate([numbered_payloads.sizes for numbered_payloads in carried]).astype(np.int32),
            payload_id=np.concatenate([numbered_payloads.ids for numbered_payloads in carried]),
            hashes=np.concatenate([numbered_payloads.hashes for numbered_payloads in carried]),
            origin=origin,
            parent_serial=np.concatenate([_or_none(block.parent_serial, len(block)) for block in blocks]),
            group=np.concatenate([numbered_payloads.groups for numbered_payloads in carried]),
        )

    def _number_block(self, block: FrameBlock, numbered: dict[int, _NumberedPayloads]) -> _NumberedPayloads:
        payloads = block.payloads
        known = numbered.get(id(payloads))
        if known is None or known.window != self._payloads.start:
            window = self._payloads.start
            known = _NumberedPayloads(
                window, *self._payloads.assign_ids(payloads), payloads.sizes, self._groups(payloads)
            )
            if self._payloads.start == window:  # otherwise the next hop's rows must be numbered in the new window
                numbered[id(payloads)] = known
        if block.rows is None:
            return known
        groups = known.groups[block.rows] if self._with_groups else _NO_GROUP
        return _NumberedPayloads(
            known.window, known.ids[block.rows], known.hashes[block.rows], payloads.sizes[block.rows], groups
        )

    def _look_up(self, link_table: LinkTable, link_numbers: Ints, which: int) -> Ints:
        """The number of each row's flow (`which` 0) or origin (1); directed links that are new get one."""
        if link_table is not self._link_table:
            self._link_table = link_table
            self._link_flows = np.full((len(link_table.names), 2), -1, dtype=np.int64)
        numbers = self._link_flows[link_numbers, which]
        if numbers.min(initial=0) < 0:
            for number in np.unique(link_numbers[numbers < 0]).tolist():
                link, direction, src, dst = link_table.names[number]
                key = (link, direction, src)
                self._link_flows[number, which] = self._origins[key] if which else self._flows[(*key, src, dst)]
            numbers = self._link_flows[link_numbers, which]
        looked_up: Ints = numbers
        return looked_up

    def _extend_lookup(self) -> None:
        """Extend the lookup arrays by the flows and parents' origins that are new in the last batch."""
        known = len(self._flow_hashes)
        if known < len(self._flows):
            new = list(self._flows)[known:]
            numbers = [[self._names[(name,)] for name in key] for key in new]
            self._flow_names = np.concatenate([self._flow_names, np.array(numbers, dtype=np.int32)])
            self._flow_hashes = np.concatenate([self._flow_hashes, _hashes(new)])
            self._dictionary = pa.array([name for (name,) in self._names], pa.string())
        known = len(self._origin_hashes)
        if known < len(self._origins):
            new = list(self._origins)[known:]
            self._origin_hashes = np.concatenate([self._origin_hashes, _hashes(new)])
            new_before = [str(FrameId(key[0], key[1], key[2], 0)).removesuffix("0") for key in new]
            self._id_prefixes = pa.concat_arrays([self._id_prefixes, pa.array(new_before, pa.string())])


def _lists(items: Mapping[int, Sequence[str]], rows: int) -> pa.Array:
    """A list column of `rows` rows, empty except for the rows in `items`, which are in ascending order."""
    offsets = np.zeros(rows + 1, dtype=np.int32)
    for row, texts in items.items():
        offsets[row + 1] = len(texts)
    flat = [text for texts in items.values() for text in texts]
    return pa.ListArray.from_arrays(pa.array(np.cumsum(offsets, dtype=np.int32)), pa.array(flat, pa.string()))


def _link_table_of(item: Frame | FrameBlock) -> LinkTable | None:
    """The key by which consecutive blocks are encoded together; `None` for a single frame."""
    return None if isinstance(item, Frame) else item.link_table


def _or_none(column: Ints | None, rows: int) -> Ints:
    return np.full(rows, -1, dtype=np.int64) if column is None else column


def _hashes(keys: Sequence[tuple[str, ...]]) -> NDArray[np.uint64]:
    return np.array([hash64("\n".join(key)) for key in keys], dtype=np.uint64)
