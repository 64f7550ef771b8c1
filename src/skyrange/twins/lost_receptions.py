"""Receptions that were lost while a jammer's noise was on the channel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.codec.remote_id import noise_request
from skyrange.core.errors import DecodeError
from skyrange.core.ids import FrameId
from skyrange.core.time import NS_PER_US
from skyrange.record.read.observations import RADIO_LINK
from skyrange.record.read.run import RunRecord
from skyrange.twins.consequences import LostReception

Ints = NDArray[np.int64]

_FRAME = ["link", "direction", "sender", "serial"]


def lost_receptions(record: RunRecord, labels: Sequence[Mapping[str, Any]]) -> list[LostReception]:
    """The receptions that were not decoded and ended during a burst of noise that an attack sent, in order of time.

    A burst occupies the channel from its act for the duration that its request asks for. Whether the frame would have
    been decoded without the burst is what the comparison of runs tells, not this.
    """
    begins_ns, ends_ns, bursts, attacks = _bursts(record, labels)
    found: list[LostReception] = []
    if not len(bursts):
        return found
    for batch in record.batches("receptions", ["time_ns", *_FRAME, "receiver", "outcome"]):
        outcome = batch.column("outcome")
        undecoded = pc.and_(pc.not_equal(outcome, "decoded"), pc.not_equal(outcome, "elsewhere"))
        rows = batch.filter(undecoded)
        time_ns = rows.column("time_ns").to_numpy()
        latest = np.searchsorted(begins_ns, time_ns, side="right") - 1
        during = (latest >= 0) & (time_ns <= ends_ns[np.maximum(latest, 0)])
        for row, burst in zip(rows.filter(pa.array(during)).to_pylist(), latest[during].tolist(), strict=True):
            frame = str(FrameId(row["link"], row["direction"], row["sender"], row["serial"]))
            sender = str(row["link"]).partition(":")[2]
            found.append(LostReception(row["time_ns"], attacks[burst], row["receiver"], sender, frame, bursts[burst]))
    return sorted(found, key=lambda one: one.at_ns)


def _bursts(record: RunRecord, labels: Sequence[Mapping[str, Any]]) -> tuple[Ints, Ints, list[str], list[str]]:
    """Begin, end, frame and attack of each burst of noise, in order of their begin."""
    sent = {row["frame"]: row for row in labels if row["action"] == "send" and row["frame"].startswith(RADIO_LINK)}
    links = sorted({FrameId.parse(frame).link for frame in sent})
    rows: list[tuple[int, int, str, str]] = []
    for table in record.tables.frames_with_payloads([*_FRAME]) if links else ():
        own = table.filter(pc.is_in(table.column("link"), value_set=pa.array(links, pa.string())))
        for row in own.to_pylist():
            frame = str(FrameId(row["link"], row["direction"], row["sender"], row["serial"]))
            if frame not in sent:
                continue
            try:
                burst = noise_request.unpack(row["payload"])
            except DecodeError:  # a broadcast, not noise
                continue
            at_ns = sent[frame]["at_ns"]
            rows.append((at_ns, at_ns + burst.duration_us * NS_PER_US, frame, sent[frame]["attack"]))
    rows.sort()
    begins, ends = (np.array([row[k] for row in rows], dtype=np.int64) for k in (0, 1))
    return begins, ends, [row[2] for row in rows], [row[3] for row in rows]
