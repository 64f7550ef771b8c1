"""How do frames become columns? A batch of frame objects into Arrow batches and rows of hash words.

Per-frame work is a few list comprehensions; names, payloads and frame ids are numbered once and looked up.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from operator import attrgetter
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.agent.frames import Fate, Frame
from skyrange.core.ids import FrameId, hash64
from skyrange.record.digests import Words, payload_hash
from skyrange.record.schema import PAYLOAD_WINDOW

_FATES = {fate: number for number, fate in enumerate(Fate)}
_FLOW = attrgetter("link", "direction", "sender", "src", "dst")
_CAUSES = attrgetter("causes")
_FATE_NAMES = pa.array([str(fate) for fate in Fate], pa.string())
_FATE_HASHES = np.array([hash64(str(fate)) for fate in Fate], dtype=np.uint64)
_NOWHERE = np.uint64(0xFFFFFFFFFFFFFFFF)  # hashed as the arrival of a frame that never arrived


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
        ("parent", pa.string()),
        ("causes", pa.list_(pa.string())),
    ]
)
"""Frames as they are spooled: the schema of the table, its names dictionary-encoded."""

PAYLOAD_SPOOL = pa.schema([("payload_id", pa.int64()), ("payload", pa.binary())])


class _Numbers(dict[tuple[str, ...], int]):
    """Numbers keys in the order in which they are first asked for."""

    def __missing__(self, key: tuple[str, ...]) -> int:
        number = len(self)
        self[key] = number
        return number


class _Payloads:
    """Numbers the payloads of the current window and keeps their hashes; those not yet handed over are `fresh`.

    A window ends after `PAYLOAD_WINDOW` payloads or `window_bytes`, counted on payloads alone, so that ids do
    not depend on when the recorder flushes.
    """

    def __init__(self, window_bytes: int) -> None:
        self.window_bytes = window_bytes
        self.fresh: list[tuple[NDArray[np.int64], list[bytes]]] = []
        self._numbers: dict[bytes, int] = {}
        self._start = 0
        self._held_bytes = 0
        self._hashes = np.empty((PAYLOAD_WINDOW, 2), dtype=np.uint64)

    def number(self, payloads: list[bytes]) -> tuple[NDArray[np.int64], Words]:
        """Ids (n,) and hashes (n, 2) of payloads, those not seen in this window getting the next ids."""
        numbers = self._numbers
        new = list(dict.fromkeys([payload for payload in payloads if payload not in numbers]))
        room = self._room(new)
        if room < len(new):
            cut = payloads.index(new[room])
            before = self.number(payloads[:cut])
            self._numbers.clear()
            self._held_bytes = 0
            self._start += PAYLOAD_WINDOW
            after = self.number(payloads[cut:])
            return np.concatenate([before[0], after[0]]), np.concatenate([before[1], after[1]])
        if new:
            first = len(numbers)
            numbers.update(zip(new, range(first, first + len(new)), strict=True))
            hashes = b"".join([payload_hash(payload) for payload in new])
            self._hashes[first : first + len(new)] = np.frombuffer(hashes, dtype="<u8").reshape(-1, 2)
            self._held_bytes += sum(map(len, new))
            self.fresh.append((np.arange(first, first + len(new)) + self._start, new))
        places = np.fromiter(map(numbers.__getitem__, payloads), np.int64, len(payloads))
        return places + self._start, self._hashes[places]

    def _room(self, new: list[bytes]) -> int:
        """How many of the new payloads still belong to this window."""
        room = min(len(new), PAYLOAD_WINDOW - len(self._numbers))
        before = self._held_bytes + np.cumsum([0, *map(len, new[: max(room - 1, 0)])])
        return min(room, int(np.searchsorted(before, self.window_bytes)))


class EncodedFrames(NamedTuple):
    """One batch: Arrow rows of frames and of the payloads first seen in them, and the digest's words (n, 10).

    `last_ns` is when the last of them was sent.
    """

    frames: pa.RecordBatch
    payloads: pa.RecordBatch
    words: Words
    last_ns: int


class FrameEncoder:
    """Turns frames into columns; its state is what has been numbered so far, and deep-copyable."""

    def __init__(self, window_bytes: int) -> None:
        """`window_bytes` of distinct payloads are de-duplicated together and held in memory."""
        self._payloads = _Payloads(window_bytes)
        self._flows = _Numbers()  # (link, direction, sender, src, dst)
        self._origins = _Numbers()  # (link, direction, sender) of parents
        self._names = _Numbers()  # (name,)
        self._flow_names = np.zeros((0, 5), dtype=np.int32)
        self._flow_hashes = np.zeros(0, dtype=np.uint64)
        self._origin_hashes = np.zeros(0, dtype=np.uint64)
        self._prefixes: list[str] = []
        self._dictionary = pa.array([], pa.string())

    def encode(self, frames: Sequence[Frame]) -> EncodedFrames:
        """Columns of `frames`, in their order; the frames are only read."""
        rows = len(frames)
        # keys are made and dropped one by one: containers that pile up would set off the garbage collector
        flow = np.fromiter(map(self._flows.__getitem__, map(_FLOW, frames)), np.int64, rows)
        serial = np.fromiter([f.serial for f in frames], np.int64, rows)
        sent = np.fromiter([f.sent_ns for f in frames], np.int64, rows)
        arrived = np.fromiter([f.arrived_ns for f in frames], np.int64, rows)
        fate = np.fromiter(map(_FATES.__getitem__, [f.fate for f in frames]), np.int32, rows)
        size = np.fromiter([len(f.payload) for f in frames], np.int32, rows)
        payload_id, hashes = self._payloads.number([f.payload for f in frames])
        parents = [f.parent for f in frames]
        origins = self._origins
        origin = np.fromiter([-1 if p is None else origins[p[:3]] for p in parents], np.int64, rows)
        parent_serial = np.fromiter([-1 if p is None else p[3] for p in parents], np.int64, rows)
        causes = {}
        if any(map(_CAUSES, frames)):
            causes = {row: [str(cause) for cause in f.causes] for row, f in enumerate(frames) if f.causes}
        self._learn()

        lost = fate != _FATES[Fate.DELIVERED]
        codes = self._flow_names[flow]
        columns = [pa.DictionaryArray.from_arrays(pa.array(codes[:, place]), self._dictionary) for place in range(5)]
        batch = pa.RecordBatch.from_arrays(
            [
                columns[0],
                columns[1],
                columns[2],
                pa.array(serial),
                columns[3],
                columns[4],
                pa.array(sent),
                pa.array(arrived, mask=lost),
                pa.DictionaryArray.from_arrays(pa.array(fate), _FATE_NAMES),
                pa.array(payload_id),
                pa.array(size),
                self._parents(origin, parent_serial),
                _lists(causes, rows),
            ],
            schema=FRAME_SPOOL,
        )
        words = np.empty((rows, 10), dtype=np.uint64)
        words[:, 0] = self._flow_hashes[flow]
        words[:, 1] = serial.view(np.uint64)
        words[:, 2] = sent.view(np.uint64)
        words[:, 3] = np.where(lost, _NOWHERE, arrived.view(np.uint64))
        words[:, 4] = _FATE_HASHES[fate]
        words[:, 5:7] = hashes
        words[:, 7] = self._origin_hashes[origin] if len(self._origin_hashes) else 0
        words[origin < 0, 7] = 0  # no parent; the serial beside it is then -1
        words[:, 8] = parent_serial.view(np.uint64)
        words[:, 9] = 0
        for row, ids in causes.items():
            words[row, 9] = hash64("\n".join(ids))
        return EncodedFrames(batch, self._new_payloads(), words, int(sent.max()))

    def _learn(self) -> None:
        """Extend the lookup arrays by the flows and parents' origins that the last batch brought."""
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
            self._prefixes += [str(FrameId(key[0], key[1], key[2], 0)).removesuffix("0") for key in new]

    def _parents(self, origin: NDArray[np.int64], serial: NDArray[np.int64]) -> pa.Array:
        """Ids as `FrameId` spells them, the serial last; null where `origin` is -1."""
        prefixes = pa.array(self._prefixes, pa.string()).take(pa.array(origin, mask=origin < 0))
        return pc.binary_join_element_wise(prefixes, pa.array(serial).cast(pa.string()), "")

    def _new_payloads(self) -> pa.RecordBatch:
        fresh, self._payloads.fresh = self._payloads.fresh, []
        ids = pa.array(np.concatenate([numbers for numbers, _ in fresh]) if fresh else [], pa.int64())
        payloads = pa.array([payload for _, payloads in fresh for payload in payloads], pa.binary())
        return pa.RecordBatch.from_arrays([ids, payloads], schema=PAYLOAD_SPOOL)


def _lists(items: Mapping[int, Sequence[str]], rows: int) -> pa.Array:
    """A list column of `rows` rows that is empty but for `items`, given in order of row."""
    offsets = np.zeros(rows + 1, dtype=np.int32)
    for row, texts in items.items():
        offsets[row + 1] = len(texts)
    flat = [text for texts in items.values() for text in texts]
    return pa.ListArray.from_arrays(pa.array(np.cumsum(offsets, dtype=np.int32)), pa.array(flat, pa.string()))


def _hashes(keys: Sequence[tuple[str, ...]]) -> NDArray[np.uint64]:
    return np.array([hash64("\n".join(key)) for key in keys], dtype=np.uint64)
