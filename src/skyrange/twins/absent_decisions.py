"""Decisions of the baseline that were not made in the attacked run, because the reason for them was elsewhere."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import NamedTuple

import pyarrow as pa
import pyarrow.compute as pc

from skyrange.core.ids import FrameId
from skyrange.metrics.time_series import RecordedNote, read_notes
from skyrange.record.read.run import RunRecord

Departed = Mapping[str, Mapping[str, int]]
"""By vehicle and attack, when the vehicle departed from the baseline because of that attack."""

_PREFIX = "decision.avoid"
_COLUMNS = ["link", "direction", "sender", "serial", "parent", "sent_ns"]


class AbsentDecision(NamedTuple):
    """A decision of the baseline that was not made, and the attack because of which its reason was missing."""

    note: RecordedNote
    attack: str
    cause: str
    """The broadcast, in the baseline, on which the decision was made there."""


def find_absent_decisions(attacked: RunRecord, baseline: RunRecord, departed: Departed) -> Iterator[AbsentDecision]:
    """For each departed aircraft, the first avoidance before its departure that it made in the baseline alone.

    Until something differs both runs make the same decisions at the same nanosecond. Only avoidances whose reason, an
    aircraft that was heard, had departed by then are returned.
    """
    made = {(note.about, note.time_ns) for note in _avoidances(attacked)}
    first: dict[str, RecordedNote] = {}
    for note in _avoidances(baseline):
        until_ns = max(departed.get(note.about, {}).values(), default=-1)
        if note.time_ns <= until_ns and (note.about, note.time_ns) not in made:
            first.setdefault(note.about, note)
    senders = senders_of(baseline, {cause for note in first.values() for cause in note.causes})
    for note in first.values():
        for cause in note.causes:
            sender, sent_ns = senders.get(cause, ("", 0))
            for attack, at_ns in departed.get(sender, {}).items():
                if at_ns <= sent_ns and sender != note.about:
                    yield AbsentDecision(note, attack, cause)


def senders_of(record: RunRecord, causes: Collection[str]) -> dict[str, tuple[str, int]]:
    """Of received broadcasts, by their ids: the vehicle that sent it, and when."""
    ids = [FrameId.parse(cause) for cause in causes]
    links = pa.array(sorted({one.link for one in ids if one.link.startswith("rid_down:")}), pa.string())
    serials = pa.array(sorted({one.serial for one in ids}), pa.int64())
    found: dict[str, tuple[str, int]] = {}
    for batch in record.batches("frames", _COLUMNS) if len(links) else ():
        own = pc.and_(
            pc.is_in(batch.column("link"), value_set=links), pc.is_in(batch.column("serial"), value_set=serials)
        )
        for row in batch.filter(own).to_pylist():
            frame = str(FrameId(row["link"], row["direction"], row["sender"], row["serial"]))
            if frame in causes and row["parent"] is not None:
                found[frame] = FrameId.parse(row["parent"]).link.partition(":")[2], row["sent_ns"]
    return found


def _avoidances(record: RunRecord) -> list[RecordedNote]:
    return [note for note in read_notes(record, "decisions") if note.kind.startswith(_PREFIX)]
