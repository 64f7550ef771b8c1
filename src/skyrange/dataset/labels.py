"""Labels of frames that lead back to acts (by parents, causes or falsified estimates), and labels of windows."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.codec.mavlink.frames import LAYOUTS
from skyrange.codec.mavlink.message_columns import message_ids
from skyrange.contracts.frames import Ints
from skyrange.core.ids import FrameId, endpoint, link_name
from skyrange.core.time import NS_PER_S, from_seconds
from skyrange.dataset.columns import ESTIMATES
from skyrange.dataset.families import family_of
from skyrange.record.manifest import fleet_of, require_entry
from skyrange.record.read.observations import frame_ids
from skyrange.record.read.run import RunRecord
from skyrange.record.read.station_frames import payload_column

ATTACK, INTRUSION, SHAM, FAULT = "attack", "harmless_intrusion", "sham", "fault"
"""What an act is. A harmless intrusion puts a frame of somebody unauthorised on a link or in the air, and harms nobody.
"""
_ORDER: Final = (ATTACK, FAULT, INTRUSION, SHAM)
_ID: Final = ("link", "direction", "sender", "serial")


@dataclass(frozen=True, slots=True)
class Act:
    """One act of an attack, an intrusion, a sham or a fault, which lasts from `at_ns` to `until_ns`."""

    author: str
    role: str
    action: str
    frame: str
    child: str | None
    at_ns: int
    until_ns: int
    owner: str
    """The vehicle or operator whose link or sensor it concerns; "" if nobody's in particular."""


@dataclass(slots=True)
class RunActs:
    """The acts of a run in order of time, and the kinds and families of their authors."""

    acts: list[Act]
    kinds: dict[str, str]
    families: dict[str, str | None]

    def of(self, role: str, owner: str | None = None) -> list[Act]:
        """The acts of a role, and with `owner` only those on it or on nobody in particular."""
        return [act for act in self.acts if act.role == role and owner in (None, act.owner or owner)]


def read_acts(record: RunRecord, family_of: Callable[[Mapping[str, Any]], str] = family_of) -> RunActs:
    """The acts of a run. An act on a sensor lasts until its attack stops, or to the end of the run.

    `family_of` gives the family of an attack. The default raises `InputError` for a kind without one.
    """
    manifest = record.manifest
    declared = [*(manifest.get("attacks") or ()), *(manifest.get("faults") or ())]
    attacks = {row["id"] for row in manifest.get("attacks") or ()}
    kinds = {row["id"]: str(row["kind"]) for row in declared}
    rows = record.table("labels").sort_by([("at_ns", "ascending"), ("frame", "ascending")]).to_pylist()
    operators = require_entry(manifest, "operators", str(record.path))
    owners = {*fleet_of(manifest, str(record.path)), *(row["id"] for row in operators)}
    ends = {row["id"]: row for row in declared}
    first: dict[str, int] = {}
    acts = []
    for row in rows:
        author, at_ns = row["attack"], int(row["at_ns"])
        first.setdefault(author, at_ns)
        until_ns = at_ns if row["until_ns"] is None else int(row["until_ns"])
        if row["action"] in ("sensor", "body"):
            until_ns = _stop_ns(ends.get(author, {}), first[author], from_seconds(record.duration))
        owner = FrameId.parse(row["frame"]).link.partition(":")[2]
        role = _role_of(row)
        acts.append(
            Act(author, role, row["action"], row["frame"], row["child"], at_ns, max(at_ns, until_ns),
                owner if owner in owners else "")
        )  # fmt: skip
    families_by_id: dict[str, str | None] = {
        row["id"]: family_of(row) if row["id"] in attacks else None for row in declared
    }
    return RunActs(acts, kinds, families_by_id)


def _role_of(row: Mapping[str, Any]) -> str:
    """What a row of `labels` is."""
    if row["fault"]:
        return FAULT
    return INTRUSION if row["harmless_intrusion"] else SHAM if row["benign"] else ATTACK


def _stop_ns(declared: Mapping[str, Any], first_ns: int, end_ns: int) -> int:
    stops = [end_ns]
    if declared.get("stop_s") is not None:
        stops.append(from_seconds(float(declared["stop_s"])))
    if declared.get("for_s") is not None:
        stops.append(first_ns + from_seconds(float(declared["for_s"])))
    return min(stops)


@dataclass(slots=True)
class FrameLabels:
    """The frames of a run that lead back to acts, one row each."""

    acts: RunActs
    ids: pa.Array = field(default_factory=lambda: pa.array([], pa.string()))
    author: list[str] = field(default_factory=list)
    role: list[str] = field(default_factory=list)
    steps: list[int] = field(default_factory=list)
    way: list[str] = field(default_factory=list)

    def columns(self, ids: pa.Array | None, count: int) -> dict[str, pa.Array]:
        """The label columns of `count` frames with these ids; `ids` may be None if no frame is labelled."""
        if not len(self.ids) or ids is None:
            none: NDArray[np.bool_] = np.zeros(count, dtype=np.bool_)
            empty = {name: pa.nulls(count, pa.string()) for name in ("way", "author", "kind", "family")}
            flags = {name: pa.array(none) for name in ("hostile", "derived", INTRUSION, SHAM, FAULT)}
            return flags | empty | {"steps": pa.nulls(count, pa.int32())}
        places = pc.index_in(ids, value_set=self.ids)
        role, steps = pa.array(self.role), pa.array(self.steps, pa.int32())
        author = pa.array(self.author)
        attack, first = pc.equal(role, ATTACK), pc.equal(steps, 0)
        columns = {
            "hostile": pc.and_(attack, first),
            "derived": pc.and_(attack, pc.invert(first)),
            **{name: pc.equal(role, name) for name in (INTRUSION, SHAM, FAULT)},
        }
        label_flags = {name: pc.fill_null(column.take(places), fill_value=False) for name, column in columns.items()}
        way = pc.if_else(columns["derived"], pa.array(self.way), pa.scalar(None, pa.string()))
        kind = pa.array([self.acts.kinds.get(name) for name in self.author], pa.string())
        family = pa.array([self.acts.families.get(name) for name in self.author], pa.string())
        texts = {"way": way, "author": author, "kind": kind, "family": family, "steps": steps}
        return label_flags | {name: column.take(places) for name, column in texts.items()}


def trace_frames(record: RunRecord, acts: RunActs) -> FrameLabels:
    """Every frame that leads back to an act: by ids of parents and causes, or as it tells a falsified estimate.

    A frame that leads back to several is labelled with the nearest act, and of equally near ones with that of an
    attack before that of a fault, an intrusion and a sham. Memory: the ids of the frames found, and one batch.
    """
    labels = FrameLabels(acts)
    if not acts.acts:
        return labels
    known: set[str] = set()
    start: dict[str, tuple[str, str, int, str]] = {}
    for act in sorted(acts.acts, key=lambda acting: _ORDER.index(acting.role)):
        # of a replacement the child is hostile, and a dropped frame is honest, and missing
        ids = [act.child] if act.action == "replace" else [act.frame] if act.action != "drop" else []
        for frame in ids:
            if frame is not None:
                start.setdefault(frame, (act.author, act.role, 0, "ids"))
    for frame, origin in _estimates(record, acts):
        start.setdefault(frame, origin)
    frontier, onset_ns = start, acts.acts[0].at_ns
    parts: list[dict[str, tuple[str, str, int, str]]] = []
    while frontier:
        parts.append(frontier)
        known.update(frontier)
        frontier = {
            frame: (*before[:2], before[2] + 1, before[3])
            for frame, before in _children(record, frontier, onset_ns)
            if frame not in known
        }
    labels.ids = pa.array([frame for part in parts for frame in part], pa.string())
    rows = [row for part in parts for row in part.values()]
    labels.author, labels.role = [row[0] for row in rows], [row[1] for row in rows]
    labels.steps, labels.way = [row[2] for row in rows], [row[3] for row in rows]
    return labels


def _children(
    record: RunRecord, frontier: Mapping[str, tuple[str, str, int, str]], onset_ns: int
) -> Iterator[tuple[str, tuple[str, str, int, str]]]:
    """Frames with a parent or cause in `frontier`, with what is known of that."""
    wanted, known_origins = pa.array(list(frontier), pa.string()), list(frontier.values())
    for batch in record.batches("frames", [*_ID, "sent_ns", "parent", "causes"]):
        batch = batch.filter(pc.greater_equal(batch.column("sent_ns"), onset_ns))
        origin = pc.index_in(batch.column("parent"), value_set=wanted).fill_null(-1).to_numpy().copy()
        causes = batch.column("causes")
        flat = pc.list_flatten(causes)
        if len(flat):
            places = pc.index_in(flat, value_set=wanted).fill_null(-1).to_numpy()
            rows = pc.list_parent_indices(causes).to_numpy()
            for row in np.flatnonzero(places >= 0).tolist():  # a parent counts before the first cause
                if origin[rows[row]] < 0:
                    origin[rows[row]] = places[row]
        hits = np.flatnonzero(origin >= 0)
        if len(hits):
            ids = frame_ids(pa.Table.from_batches([batch]).take(pa.array(hits))).to_pylist()
            yield from zip(ids, (known_origins[place] for place in origin[hits].tolist()), strict=True)


def _estimates(record: RunRecord, acts: RunActs) -> Iterator[tuple[str, tuple[str, str, int, str]]]:
    """The frames in which an aircraft tells its estimate while an act falsifies its sensors."""
    falsified: dict[str, list[Act]] = {}
    for act in acts.acts:
        if act.action == "sensor" and act.owner:
            falsified.setdefault(act.owner, []).append(act)
    if not falsified:
        return
    senders = {(link_name("autopilot", owner), endpoint(owner, "autopilot")): owner for owner in falsified}
    senders |= {(link_name("rid_up", owner), endpoint(owner, "companion")): owner for owner in falsified}
    links = pa.array([link for link, _ in senders], pa.string())
    telling = np.array([number for number, layout in LAYOUTS.items() if str(layout.cls.msgname) in ESTIMATES])
    for batch in record.tables.frames_with_payloads([*_ID, "sent_ns"]):
        batch = batch.filter(pc.is_in(batch.column("link"), value_set=links))
        if not batch.num_rows:
            continue
        is_telling = np.isin(message_ids(payload_column(batch.column("payload"))), telling)
        ids = frame_ids(batch).to_pylist()
        names = [batch.column(name).to_pylist() for name in ("link", "sender", "sent_ns")]
        for row, (link, sender, sent_ns) in enumerate(zip(*names, strict=True)):
            owner = senders.get((link, sender))
            if owner is None or not (is_telling[row] or link.startswith("rid_up:")):
                continue
            for act in falsified[owner]:
                if act.at_ns <= sent_ns <= act.until_ns:
                    yield ids[row], (act.author, act.role, 1, "estimate")
                    break


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
            attack_author if is_ours else fault_author if is_faulty else None
            for attack_author, fault_author, is_ours, is_faulty in zip(last, fault, active | shown, faulty, strict=True)
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
            "kind": pa.array([self.acts.kinds.get(author_id or "") for author_id in author], pa.string()),
            "family": pa.array([self.acts.families.get(author_id or "") for author_id in author], pa.string()),
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
    frame_id = FrameId.parse(frame)
    return (frame_id.link, frame_id.direction) == (link, direction)


def _overlaps(acts: list[Act], begin_ns: Ints, end_ns: Ints) -> Flags:
    """(n,) whether an act lasts into the window."""
    overlaps = np.zeros(len(begin_ns), dtype=np.bool_)
    if not acts:
        return overlaps
    starts = np.array([act.at_ns for act in acts], dtype=np.int64)
    latest = np.maximum.accumulate(np.array([act.until_ns for act in acts], dtype=np.int64))
    before = np.searchsorted(starts, end_ns)  # acts that have begun before the window ends
    chosen = before > 0
    overlaps[chosen] = latest[before[chosen] - 1] >= begin_ns[chosen]
    return overlaps


def _last_author(acts: list[Act], end_ns: Ints) -> list[str | None]:
    """(n,) who acted last before the window ended."""
    if not acts:
        return [None] * len(end_ns)
    starts = np.array([act.at_ns for act in acts], dtype=np.int64)
    before = np.searchsorted(starts, end_ns).tolist()
    return [acts[count - 1].author if count else None for count in before]
