"""Section of a run that flew on a loss table: the map, and how much of the flights the table covers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from skyrange.core.compiled import compiled
from skyrange.core.errors import InputError
from skyrange.figures.coverage_map import draw_coverage_map
from skyrange.radio.propagation.loss_table import LossTable, table_loss_db
from skyrange.radio.propagation.loss_table_file import read_loss_table
from skyrange.record.folder import LOSS_TABLE
from skyrange.report.rendering import render
from skyrange.report.run.contents import RunContents

MAX_AIRCRAFT: Final = 40
SAMPLES: Final = 100
"""Instants, evenly spaced, at which the coverage of positions is counted."""
FLYING_M: Final = 2.0

Floats = NDArray[np.float64]


def coverage_section(run: RunContents) -> Mapping[str, Any] | None:
    """Map, shares of positions with a loss in the table, and provenance; `None` if the run did not fly on a table, or
    if its copy cannot be read.
    """
    path = run.record.path / LOSS_TABLE
    if not path.is_file():
        return None
    try:
        content = read_loss_table(path)
    except InputError:
        return None
    receivers = {str(row["id"]): np.array(row["at_enu_m"], float) for row in run.manifest.get("receivers") or []}
    flown = _positions(run)
    heights = flown[..., 2][flown[..., 2] > FLYING_M]
    first = next(iter(receivers.values()), content.places_enu_m[0])
    nearest = int(np.argmin(((content.places_enu_m - first) ** 2).sum(axis=1)))
    height = float(np.median(heights)) if heights.size else None
    drawing = draw_coverage_map(content, run.subject.city, nearest, height)
    rows = [(name, _share_to(content.table, flown, place)) for name, place in receivers.items()]
    rows.append(("other aircraft", _share_between(content.table, flown)))
    table = render("coverage.html.jinja", rows=[(name, f"{share:.0%}") for name, share in rows if share == share])
    tracer = content.header.tracer
    return {"drawing": drawing, "table": table, "tracer": f"{tracer.get('name')} {tracer.get('version') or ''}".strip()}


def _positions(run: RunContents) -> Floats:
    """(aircraft, samples, 3) true positions, of the first aircraft of a large fleet."""
    times = np.linspace(run.start_ns, run.end_ns, SAMPLES).astype(np.int64)
    tracks = [track for track in run.truth.values() if len(track)][:MAX_AIRCRAFT]
    return np.array([track.at(times) for track in tracks], dtype=np.float64).reshape(-1, SAMPLES, 3)


@compiled
def _share_to(table: LossTable, flown: Floats, place: Floats) -> float:
    found = total = 0
    for k in range(flown.shape[0]):
        for n in range(flown.shape[1]):
            total += 1
            found += _covers(table, flown[k, n], place)
    return found / total if total > 0 else math.nan


@compiled
def _share_between(table: LossTable, flown: Floats) -> float:
    found = total = 0
    for k in range(flown.shape[0]):
        for m in range(k):
            for n in range(flown.shape[1]):
                total += 1
                found += _covers(table, flown[k, n], flown[m, n])
    return found / total if total > 0 else math.nan


@compiled
def _covers(table: LossTable, a: Floats, b: Floats) -> int:
    loss = table_loss_db(table, a[0], a[1], max(a[2], 0.0), b[0], b[1], max(b[2], 0.0), 1.0, 0.1)
    return 1 if loss == loss else 0
