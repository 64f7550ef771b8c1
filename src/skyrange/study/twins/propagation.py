"""Propagation of attacks: onset, acts, propagation and effect, read from the record by frame ids.

*Onset* is an attack's first act, and each later one is an *act*. *Propagation* is every frame, decision and event whose
parent or causes lead back to a hostile frame. *Effect* is a departure of an aircraft's truth from the twin. An attack
that acts by omission (a dropped frame, a jammed channel) leaves no frame to lead back to; its effect is found as well.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from skyrange.core.ids import FrameId
from skyrange.core.time import NS_PER_S
from skyrange.record.read.run import RunRecord
from skyrange.record.schema import NAME, TEXT, Column, arrow_schema
from skyrange.study.measures.time_series import vehicles

PHASES: Final = ("onset", "act", "propagation", "effect")

COLUMNS: Final[tuple[Column, ...]] = (
    Column("seed", pa.int64(), "", "seed of the run"),
    Column("phase", NAME, "", "onset, act, propagation or effect"),
    Column("at_ns", pa.int64(), "ns", "when, since the scenario's start"),
    Column(
        "attack",
        NAME,
        "",
        "the attack's id; null for an effect that cannot be traced to one of several",
        True,
    ),
    Column("vehicle", NAME, "", "the aircraft concerned; null if none", True),
    Column(
        "kind", NAME, "", "what was done (inject, send, …), `frame`, the decision's or event's kind, or `departure`"
    ),
    Column("source", NAME, "", "who acted, sent or decided"),
    Column("link", NAME, "", "of a frame: the link that it crossed", True),
    Column("frame", TEXT, "", "of a frame: its id", True),
    Column("origin", TEXT, "", "of a propagation: the frame before it on the path to the hostile act", True),
    Column("depth", pa.int32(), "", "of a propagation: number of steps from the hostile act", True),
    Column("data", TEXT, "", "of a decision or event: its details, a JSON object", True),
    Column("departure_m", pa.float64(), "m", "of an effect: largest distance of the aircraft from the twin", True),
)
"""Columns of `propagation.parquet`: one row per hostile act, per consequence of one, and per departed aircraft."""


class Taint(NamedTuple):
    """The attack to which a frame leads back, and the number of steps."""

    attack: str
    depth: int


def trace(record: RunRecord, seed: int) -> list[dict[str, Any]]:
    """The rows of onset, acts and propagation of all attacks of a run, in order of time."""
    fleet = {vehicle.id for vehicle in vehicles(record)}
    labels = record.table("labels").sort_by([("at_ns", "ascending"), ("frame", "ascending")]).to_pylist()
    rows: list[dict[str, Any]] = []
    known: dict[str, Taint] = {}
    begun: set[str] = set()
    for label in labels:
        for frame in (label["frame"], label["child"]):
            if frame is not None:
                known.setdefault(frame, Taint(label["attack"], 0))
        link = FrameId.parse(label["frame"]).link
        phase = "act" if label["attack"] in begun else "onset"
        begun.add(label["attack"])
        rows.append(
            _row(
                seed, phase, label["at_ns"], label["attack"], _vehicle_of(link, fleet), label["action"], label["actor"],
                link=link, frame=label["frame"],
            )
        )  # fmt: skip
    if not labels:
        return rows
    onset_ns = labels[0]["at_ns"]
    frontier = list(known)
    while frontier:
        found = [hit for hit in _descendants(record, frontier, onset_ns) if hit["frame"] not in known]
        frontier = []
        for hit in found:
            if hit["frame"] in known:  # found twice at this depth
                continue
            before = known[hit["origin"]]
            known[hit["frame"]] = Taint(before.attack, before.depth + 1)
            frontier.append(hit["frame"])
            rows.append(
                _row(
                    seed, "propagation", hit["sent_ns"], before.attack, _vehicle_of(hit["link"], fleet), "frame",
                    hit["sender"], link=hit["link"], frame=hit["frame"], origin=hit["origin"], depth=before.depth + 1,
                )
            )  # fmt: skip
    for table in ("decisions", "events"):
        rows += _notes(record, table, known, seed, fleet)
    return sorted(rows, key=lambda row: (row["at_ns"], PHASES.index(row["phase"]), row["frame"] or ""))


def effects_of(rows: Sequence[Mapping[str, Any]], effects: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The rows of phase `effect`: one for each aircraft that departed in `effects`, the rows against one twin.

    The attack is that of the first propagation to the aircraft before its departure, or the only attack of the run.
    """
    attacks = {str(row["attack"]) for row in rows if row["phase"] == "onset"}
    found = []
    for effect in effects:
        if effect["departed_s"] is None:
            continue
        at_ns = round(effect["departed_s"] * NS_PER_S)
        preceding = [
            row["attack"]
            for row in rows
            if row["phase"] == "propagation" and row["vehicle"] == effect["vehicle"] and row["at_ns"] <= at_ns
        ]
        attack = preceding[0] if preceding else next(iter(attacks)) if len(attacks) == 1 else None
        row = _row(effect["seed"], "effect", at_ns, attack, effect["vehicle"], "departure", "world")
        found.append(row | {"departure_m": effect["departure_m"]})
    return sorted(found, key=lambda row: (row["at_ns"], row["vehicle"]))


def propagation_table(rows: Sequence[Mapping[str, Any]]) -> pa.Table:
    """Rows as the table of `propagation.parquet`."""
    return pa.Table.from_pylist([dict(row) for row in rows], schema=arrow_schema("phases", COLUMNS))


def _row(
    seed: int, phase: str, at_ns: int, attack: str | None, vehicle: str | None, kind: str, source: str, **more: Any
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
    """Frames with a parent or cause in `frontier`; the first of these is the row's `origin`."""
    ids = pa.array(frontier, pa.string())
    for batch in record.batches("frames", _FRAME_COLUMNS):
        batch = batch.filter(pc.greater_equal(batch.column("sent_ns"), onset_ns))
        for row in _rows_referring_to(batch, ids, frozenset(frontier)):
            frame = str(FrameId(row["link"], row["direction"], row["sender"], row["serial"]))
            yield {**row, "frame": frame}


def _rows_referring_to(batch: pa.RecordBatch, ids: pa.Array, wanted: frozenset[str]) -> Iterator[dict[str, Any]]:
    """The rows of a batch that refer to one of `ids`, with that id as `origin`."""
    hits = _has_cause(batch.column("causes"), ids)
    if "parent" in batch.schema.names:
        hits |= pc.is_in(batch.column("parent").cast(pa.string()), value_set=ids).to_numpy(zero_copy_only=False)
    for row in batch.filter(pa.array(hits)).to_pylist() if hits.any() else ():
        origins = [row["parent"]] if row.get("parent") in wanted else []
        origins += [cause for cause in row["causes"] if cause in wanted]
        yield {**row, "origin": origins[0]}


def _has_cause(causes: pa.ListArray, ids: pa.Array) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """(n,) whether a row's causes contain one of `ids`."""
    hits = np.zeros(len(causes), dtype=np.bool_)
    flat = pc.list_flatten(causes)
    if len(flat):
        inside = pc.is_in(flat, value_set=ids).to_numpy(zero_copy_only=False)
        hits[pc.list_parent_indices(causes).to_numpy()[inside]] = True
    return hits


def _notes(
    record: RunRecord, table: str, known: Mapping[str, Taint], seed: int, fleet: set[str]
) -> Iterator[dict[str, Any]]:
    """Rows for decisions or events that hostile frames caused."""
    ids, wanted = pa.array(list(known), pa.string()), frozenset(known)
    for batch in record.batches(table, ["time_ns", "kind", "about", "source", "data", "causes"]):
        for row in _rows_referring_to(batch, ids, wanted):
            before = known[row["origin"]]
            about = row["about"] if row["about"] in fleet else row["about"].split(".", 1)[0]
            yield _row(
                seed, "propagation", row["time_ns"], before.attack, about if about in fleet else None, row["kind"],
                row["source"], origin=row["origin"], depth=before.depth + 1, data=row["data"],
            )  # fmt: skip
