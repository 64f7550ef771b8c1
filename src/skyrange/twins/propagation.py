"""Propagation of attacks: onset, acts, propagation and effect, read from the record.

*Onset* is an attack's first act, and each later one is an *act*. *Propagation* is every frame, decision and event that
leads back to a hostile act: by the ids of its parent and causes, or as `consequences` finds it. What several attacks
formed has a row for each. *Effect* is a departure of an aircraft's truth from the baseline.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from skyrange.core.ids import FrameId, link_name
from skyrange.core.time import NS_PER_S
from skyrange.metrics.aircraft import near_misses
from skyrange.metrics.safety import NEAR_M
from skyrange.metrics.time_series import RecordedNote, read_notes, vehicles
from skyrange.record.read.run import RunRecord
from skyrange.record.schema import arrow_schema
from skyrange.twins.columns import PAIR_TABLES
from skyrange.twins.consequences import (
    Departed,
    Origin,
    act_of,
    find_absent_decisions,
    follow,
    lost_receptions,
    senders_of,
)

PHASES: Final = ("onset", "act", "propagation", "effect")

COLUMNS: Final = PAIR_TABLES["propagation"]
"""Columns of `propagation.parquet`: one row per hostile act, per consequence of one, and per departed aircraft."""


Known = dict[str, dict[str, Origin]]
"""By frame and attack, where the frame leads back to: the frame before it, and the number of steps."""


def trace(
    record: RunRecord, seed: int, near_m: float = NEAR_M, departed: Departed = MappingProxyType({})
) -> list[dict[str, Any]]:
    """The rows of onset, acts and propagation of all attacks of a run, in order of time.

    With `departed`, decisions that others make on the honest broadcasts of an aircraft after it departed lead back too.
    """
    fleet = {vehicle.id for vehicle in vehicles(record)}
    table = record.table("labels").sort_by([("at_ns", "ascending"), ("frame", "ascending")])
    labels = [label for label in table.to_pylist() if not label["benign"]]
    if not labels:
        return []
    known: Known = {}
    rows = list(_acts(labels, known, seed, fleet))
    onset_ns = labels[0]["at_ns"]
    frontier = list(known)
    while frontier:
        reached: dict[str, None] = {}
        for hit in _descendants(record, frontier, onset_ns):
            leads = known.setdefault(hit["frame"], {})
            for origin, attack, depth in _contributors(hit["origins"], known):
                if attack in leads:
                    continue
                leads[attack] = Origin(origin, depth + 1)
                reached[hit["frame"]] = None
                rows.append(
                    _row(
                        seed, "propagation", hit["sent_ns"], attack=attack, vehicle=_vehicle_of(hit["link"], fleet),
                        kind="frame", source=hit["sender"], link=hit["link"], frame=hit["frame"], origin=origin,
                        depth=depth + 1, way="frame",
                    )
                )  # fmt: skip
        frontier = list(reached)
    rows += _lost_and_noted(record, labels, known, seed, fleet, near_m=near_m, departed=departed)
    return sorted(rows, key=lambda row: (row["at_ns"], PHASES.index(row["phase"]), row["frame"] or ""))


def _acts(labels: Sequence[Mapping[str, Any]], known: Known, seed: int, fleet: set[str]) -> Iterator[dict[str, Any]]:
    """The rows of onset and acts; fills `known` with the hostile frames."""
    begun: set[str] = set()
    for label in labels:
        for frame in (label["frame"], label["child"]):
            if frame is not None:
                known.setdefault(frame, {}).setdefault(label["attack"], Origin(frame, 0))
        link = FrameId.parse(label["frame"]).link
        phase = "act" if label["attack"] in begun else "onset"
        begun.add(label["attack"])
        yield _row(
            seed, phase, label["at_ns"], attack=label["attack"], vehicle=_vehicle_of(link, fleet),
            kind=label["action"], source=label["actor"], link=link, frame=label["frame"],
        )  # fmt: skip


def _lost_and_noted(
    record: RunRecord,
    labels: Sequence[Mapping[str, Any]],
    known: Known,
    seed: int,
    fleet: set[str],
    *,
    near_m: float,
    departed: Departed,
) -> Iterator[dict[str, Any]]:
    """The rows of receptions that were lost to load, and of decisions and events that lead back to an act."""
    lost = lost_receptions(record, labels)
    first: set[tuple[str, str, str]] = set()
    for loss in lost:
        if (loss.attack, loss.receiver, loss.sender) not in first:
            first.add((loss.attack, loss.receiver, loss.sender))
            yield _row(
                seed, "propagation", loss.at_ns, attack=loss.attack,
                vehicle=loss.receiver if loss.receiver in fleet else None,
                kind="reception_lost", source=loss.receiver, link=link_name("rid_up", loss.sender), frame=loss.frame,
                origin=loss.burst, depth=1, way="silence",
            )  # fmt: skip
    decisions = read_notes(record, "decisions")
    displaced = _displaced(record, {cause for note in decisions for cause in note.causes} - known.keys(), departed)
    notes = [*decisions, *read_notes(record, "events"), *near_misses(record, near_m)]
    led_back = []
    for note in sorted(notes, key=lambda note: note.time_ns):
        origins: dict[str, Origin] = {}
        for origin, attack, depth in _contributors([cause for cause in note.causes if cause in known], known):
            if attack not in origins or depth + 1 < origins[attack].depth:
                origins[attack] = Origin(origin, depth + 1)
        for attack, source in origins.items():
            yield _note_row(note, attack, source, "frame", seed, fleet)
        for cause in note.causes:
            for attack in displaced.get(cause, ()):
                if attack not in origins:
                    origins[attack] = Origin(cause, 1)
                    yield _note_row(note, attack, origins[attack], "position", seed, fleet)
        led_back.append((note, origins))
    acts = [act_of(label["at_ns"], label["attack"], label["action"], label["frame"]) for label in labels]
    owners = {str(row.get("uas_id")): str(row["id"]) for row in record.manifest.get("vehicles") or []}
    for consequence in follow(led_back, acts, lost, owners):
        yield _note_row(consequence.note, consequence.attack, consequence.origin, consequence.way, seed, fleet)


def _displaced(record: RunRecord, causes: Collection[str], departed: Departed) -> dict[str, list[str]]:
    """Of received broadcasts: the attacks because of which the sender was not where it would have been."""
    if not departed:
        return {}
    return {
        frame: [attack for attack, at_ns in departed.get(sender, {}).items() if at_ns <= sent_ns]
        for frame, (sender, sent_ns) in senders_of(record, causes).items()
    }


def absent_rows(attacked: RunRecord, baseline: RunRecord, seed: int, departed: Departed) -> list[dict[str, Any]]:
    """The rows of decisions that were made in `baseline` only, because in the attacked run somebody had departed."""
    fleet = {vehicle.id for vehicle in vehicles(attacked)}
    return [
        _note_row(absent.note, absent.attack, Origin(absent.cause, 1), "absent", seed, fleet)
        for absent in find_absent_decisions(attacked, baseline, departed)
    ]


def _contributors(origins: Sequence[str], known: Known) -> Iterator[tuple[str, str, int]]:
    """Of the frames that caused something: frame, attack that it leads back to, and number of steps."""
    for origin in origins:
        for attack, before in known[origin].items():
            yield origin, attack, before.depth


def _note_row(note: RecordedNote, attack: str, origin: Origin, way: str, seed: int, fleet: set[str]) -> dict[str, Any]:
    about = note.about if note.about in fleet else note.about.split(".", 1)[0]
    return _row(
        seed, "propagation", note.time_ns, attack=attack, vehicle=about if about in fleet else None, kind=note.kind,
        source=note.source, origin=origin.frame, depth=origin.depth,
        data=json.dumps(note.data, ensure_ascii=False), way=way,
    )  # fmt: skip


def effects_of(
    rows: Sequence[Mapping[str, Any]], attributed: Sequence[Mapping[str, Any]], seed: int
) -> list[dict[str, Any]]:
    """The rows of phase `effect`: one for each departed aircraft and each attack that `attributed` names for it.

    Which attack it is follows from the runs, never from the record; the record says by what way (`path`). A departure
    without an author has one row without an attack.
    """
    effects: list[dict[str, Any]] = []
    departures: dict[str, list[Mapping[str, Any]]] = {}
    for row in attributed:
        if row["seed"] == seed and row["outcome"] == "departure":
            departures.setdefault(row["vehicle"], []).append(row)
    for vehicle, departed in departures.items():
        at_ns = round(departed[0]["departed_s"] * NS_PER_S)
        named = [row for row in departed if row["relation"] not in ("none", "unknown")]
        for cause in named or departed[:1]:
            attack = cause["attack"] if named else None
            steps = [
                row
                for row in rows
                if row["vehicle"] == vehicle and row["attack"] == attack and row["at_ns"] <= at_ns and _moves(row)
            ]
            last = max(steps, key=_time_ns, default=None)
            effect = _row(seed, "effect", at_ns, attack=attack, vehicle=vehicle, kind="departure", source="world")
            effects.append(
                effect
                | {
                    "departure_m": cause["difference"],
                    "relation": cause["relation"],
                    "path": last is not None,
                    "origin": None if last is None else last["frame"] or last["origin"],
                    "depth": None if last is None else last["depth"] or 0,
                }
            )
    return sorted(effects, key=lambda row: (row["at_ns"], row["vehicle"], row["attack"] or ""))


def _time_ns(row: Mapping[str, Any]) -> int:
    return int(row["at_ns"])


def _moves(row: Mapping[str, Any]) -> bool:
    """Whether a step can move an aircraft: a decision, an event, a command, a lost frame, a falsified reading.

    That it received a broadcast is none.
    """
    if row["kind"] == "frame":
        return str(row["link"]).startswith(("gcs:", "log:", "autopilot:"))
    if row["phase"] == "propagation":
        return True
    return bool(row["kind"] != "send")


def mark_faults(rows: Sequence[Mapping[str, Any]], faults: Collection[str]) -> list[dict[str, Any]]:
    """The rows with `fault`: whether the id in `attack` is among `faults`, null without an id."""
    return [{**row, "fault": None if row["attack"] is None else row["attack"] in faults} for row in rows]


def propagation_table(rows: Sequence[Mapping[str, Any]]) -> pa.Table:
    """Rows as the table of `propagation.parquet`."""
    return pa.Table.from_pylist([dict(row) for row in rows], schema=arrow_schema("phases", COLUMNS))


def _row(
    seed: int,
    phase: str,
    at_ns: int,
    *,
    attack: str | None,
    vehicle: str | None,
    kind: str,
    source: str,
    **more: Any,
) -> dict[str, Any]:
    row = {column.name: None for column in COLUMNS}
    return row | {
        "seed": seed, "phase": phase, "at_ns": at_ns, "attack": attack, "vehicle": vehicle, "kind": kind,
        "source": source,
    } | more  # fmt: skip


def _vehicle_of(link: str, fleet: set[str]) -> str | None:
    owner = link.partition(":")[2]
    return owner if owner in fleet else None


_FRAME_COLUMNS = ["link", "direction", "sender", "serial", "sent_ns", "parent", "causes"]


def _descendants(record: RunRecord, frontier: Sequence[str], onset_ns: int) -> Iterator[dict[str, Any]]:
    """Frames with a parent or causes in `frontier`; these are the row's `origins`."""
    ids = pa.array(frontier, pa.string())
    for batch in record.batches("frames", _FRAME_COLUMNS):
        batch = batch.filter(pc.greater_equal(batch.column("sent_ns"), onset_ns))
        for row in _rows_referring_to(batch, ids, frozenset(frontier)):
            frame = str(FrameId(row["link"], row["direction"], row["sender"], row["serial"]))
            yield {**row, "frame": frame}


def _rows_referring_to(batch: pa.RecordBatch, ids: pa.Array, wanted: frozenset[str]) -> Iterator[dict[str, Any]]:
    """The rows of a batch that refer to some of `ids`, with those as `origins`."""
    hits = _has_cause(batch.column("causes"), ids)
    if "parent" in batch.schema.names:
        hits |= pc.is_in(batch.column("parent").cast(pa.string()), value_set=ids).to_numpy(zero_copy_only=False)
    for row in batch.filter(pa.array(hits)).to_pylist() if hits.any() else ():
        origins = [row["parent"]] if row.get("parent") in wanted else []
        origins += [cause for cause in row["causes"] if cause in wanted]
        yield {**row, "origins": list(dict.fromkeys(origins))}


def _has_cause(causes: pa.ListArray, ids: pa.Array) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """(n,) whether a row's causes contain one of `ids`."""
    hits = np.zeros(len(causes), dtype=np.bool_)
    flat = pc.list_flatten(causes)
    if len(flat):
        inside = pc.is_in(flat, value_set=ids).to_numpy(zero_copy_only=False)
        hits[pc.list_parent_indices(causes).to_numpy()[inside]] = True
    return hits
