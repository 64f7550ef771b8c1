"""View `episodes`: onset, end, first observation and effect of each attack, sham and fault on each aircraft."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from skyrange.contracts.frames import Ints
from skyrange.core.ids import link_name
from skyrange.core.time import from_seconds
from skyrange.dataset.columns import RUN_COLUMNS, view_schema
from skyrange.dataset.labels import ATTACK
from skyrange.dataset.views.observed import SeenActs
from skyrange.dataset.views.window_labels import WindowLabeller, dropped_at
from skyrange.record.read.run import RunRecord


def describe_episodes(record: RunRecord, labeller: WindowLabeller, seen: SeenActs) -> pa.Table:
    """One row for each author that acted and each aircraft that it acted on or touches, without the run's columns."""
    fleet = [str(row["id"]) for row in record.manifest["vehicles"]]
    declared = {
        row["id"]: row for row in (*(record.manifest.get("attacks") or ()), *(record.manifest.get("faults") or ()))
    }
    acts = labeller.acts
    authors = dict.fromkeys((act.author, act.role) for act in acts.acts)
    rows = []
    for author, role in authors:
        own = [act for act in acts.acts if act.author == author and act.role == role]
        touched = {str(name).partition(":")[2] or str(name) for name in declared.get(author, {}).get("touches", ())}
        touched |= {act.owner for act in own}
        vehicles: list[str | None] = [name for name in fleet if name in touched]
        for vehicle in vehicles or [None]:
            link = link_name("gcs", vehicle or "")
            times = [seen.authors.get((link, author)), _first(dropped_at(acts, link, "rev"))]
            found = [time_ns for time_ns in times if time_ns is not None]
            effect_s = (labeller.effects_s or {}).get(vehicle or "")
            rows.append(
                {
                    "vehicle": vehicle, "author": author, "role": role, "kind": acts.kinds.get(author, "unknown"),
                    "family": acts.families.get(author), "onset_ns": own[0].at_ns,
                    "end_ns": max(act.until_ns for act in own), "acts": len(own),
                    "observable_ns": min(found) if found and role == ATTACK else None,
                    "effect_ns": None if effect_s is None or role != ATTACK else from_seconds(effect_s),
                }
            )  # fmt: skip
    schema = view_schema("episodes")
    return pa.Table.from_pylist(rows, schema=pa.schema(list(schema)[len(RUN_COLUMNS) :]))


def _first(times: Ints) -> int | None:
    return int(np.min(times)) if len(times) else None
