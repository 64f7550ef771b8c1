"""What each defence of a run did: its acts, its alarms, and when the first one was."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from skyrange.core.time import NS_PER_S
from skyrange.metrics.time_series import read_notes
from skyrange.record.read.run import RunRecord


@dataclass(frozen=True, slots=True)
class DefenceActs:
    """What one defence did in one run."""

    id: str
    kind: str
    params: Mapping[str, Any]
    touches: Sequence[str]
    acts: Mapping[str, int]
    """Number of acts by action: drop, delay, replace, inject, sensor and so on."""
    alarms: int
    first_alarm_s: float | None


def read_defences(run: RunRecord) -> list[DefenceActs]:
    """Each defence that is not muted, as declared in the manifest."""
    declared = [row for row in run.manifest.get("defences") or () if not row.get("muted")]
    if not declared:
        return []
    acts: dict[str, Counter[str]] = {}
    for note in read_notes(run, "events"):
        if note.kind == "event.defence_act":
            acts.setdefault(note.about, Counter())[str(note.data["action"])] += 1
    raised: dict[str, list[int]] = {}
    for row in run.table("alerts", ["time_ns", "detector"]).to_pylist():
        raised.setdefault(row["detector"], []).append(row["time_ns"])
    return [
        DefenceActs(
            row["id"],
            row["kind"],
            row.get("params", {}),
            row.get("touches", []),
            acts.get(row["id"], Counter()),
            len(raised.get(row["id"], ())),
            min(raised[row["id"]]) / NS_PER_S if row["id"] in raised else None,
        )
        for row in declared
    ]
