"""Labels of windows: active, observable here, effect, and who acts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from skyrange.contracts.frames import Ints
from skyrange.core.ids import FrameId
from skyrange.core.time import NS_PER_S
from skyrange.dataset.labels import ATTACK, FAULT, INTRUSION, SHAM, Act, RunActs

Flags = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class WindowLabeller:
    """The acts of a run, and when each aircraft departed from the nominal twin (None if the caller did not say)."""

    acts: RunActs
    effects_s: Mapping[str, float | None] | None = None

    def columns(self, owner: str, begin_ns: Ints, end_ns: Ints, seen_ns: Ints) -> dict[str, pa.Array]:
        """Label columns of the windows [begin, end) of a place of `owner`, where `seen_ns` are the sorted times of
        hostile and derived frames.
        """
        attacks = self.acts.of(ATTACK, owner)
        active = _overlaps(attacks, begin_ns, end_ns)
        shown = np.searchsorted(seen_ns, end_ns) > np.searchsorted(seen_ns, begin_ns)
        every = self.acts.of(ATTACK)
        onset_ns = every[0].at_ns if every else np.iinfo(np.int64).max
        faults = self.acts.of(FAULT, owner)
        last = _last_author(attacks, end_ns)
        faulty = _overlaps(faults, begin_ns, end_ns)
        fault = _last_author(faults, end_ns)
        author = [
            one if is_ours else other if is_faulty else None
            for one, other, is_ours, is_faulty in zip(last, fault, active | shown, faulty, strict=True)
        ]
        return {
            "active": pa.array(active),
            "observable": pa.array(shown),
            "effect": self._effect(owner, end_ns),
            "after_onset": pa.array(end_ns > onset_ns),
            "harmless_intrusion_active": pa.array(_overlaps(self.acts.of(INTRUSION, owner), begin_ns, end_ns)),
            "sham_active": pa.array(_overlaps(self.acts.of(SHAM, owner), begin_ns, end_ns)),
            "fault_active": pa.array(faulty),
            "author": pa.array(author, pa.string()),
            "kind": pa.array([self.acts.kinds.get(one or "") for one in author], pa.string()),
            "family": pa.array([self.acts.families.get(one or "") for one in author], pa.string()),
        }

    def _effect(self, owner: str, end_ns: Ints) -> pa.Array:
        if self.effects_s is None or owner not in self.effects_s:
            return pa.nulls(len(end_ns), pa.bool_())
        effect_s = self.effects_s[owner]
        departed = np.zeros(len(end_ns), dtype=np.bool_) if effect_s is None else end_ns > effect_s * NS_PER_S
        return pa.array(departed)


def dropped_at(acts: RunActs, link: str, direction: str) -> Ints:
    """The times at which an attack dropped frames of one direction of a link, in order."""
    return np.array(
        [act.at_ns for act in acts.of(ATTACK) if act.action == "drop" and _is_of(act.frame, link, direction)],
        dtype=np.int64,
    )


def _is_of(frame: str, link: str, direction: str) -> bool:
    found = FrameId.parse(frame)
    return (found.link, found.direction) == (link, direction)


def _overlaps(acts: list[Act], begin_ns: Ints, end_ns: Ints) -> Flags:
    """(n,) whether an act lasts into the window."""
    found = np.zeros(len(begin_ns), dtype=np.bool_)
    if not acts:
        return found
    starts = np.array([act.at_ns for act in acts], dtype=np.int64)
    latest = np.maximum.accumulate(np.array([act.until_ns for act in acts], dtype=np.int64))
    before = np.searchsorted(starts, end_ns)  # acts that have begun before the window ends
    chosen = before > 0
    found[chosen] = latest[before[chosen] - 1] >= begin_ns[chosen]
    return found


def _last_author(acts: list[Act], end_ns: Ints) -> list[str | None]:
    """(n,) who acted last before the window ended."""
    if not acts:
        return [None] * len(end_ns)
    starts = np.array([act.at_ns for act in acts], dtype=np.int64)
    before = np.searchsorted(starts, end_ns).tolist()
    return [acts[count - 1].author if count else None for count in before]
