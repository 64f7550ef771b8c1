"""Sections of a run's page: links, receptions, flight approval, and coverage of a loss table."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from skyrange.contracts.frames import Fate
from skyrange.core.compiled import compiled
from skyrange.core.errors import InputError
from skyrange.core.ids import owner_of
from skyrange.figures.maps import draw_coverage_map
from skyrange.figures.svg import format_number
from skyrange.metrics.approvals import inside_share, is_tracked
from skyrange.metrics.links import MAX_AIRCRAFT, LinkStatistics, ReceptionSummary, sum_by_kind
from skyrange.radio.propagation.loss_table import LossTable, table_loss_db
from skyrange.radio.propagation.loss_table_file import read_loss_table
from skyrange.record.folder import LOSS_TABLE
from skyrange.report import quantities
from skyrange.report.rendering import render
from skyrange.report.run.contents import RunContents


def render_airspace(run: RunContents) -> Markup | None:
    """Render a row for each flight; `None` where every flight was approved at once and nobody tracked it."""
    tracked = {vehicle for vehicle, vehicle_claims in run.claims.items() if is_tracked(vehicle_claims)}
    if not tracked and not any(flight.rejections for flight in run.approvals):
        return None
    places = {vehicle.id: place for place, vehicle in enumerate(run.fleet)}
    rows: list[dict[str, Any]] = []
    span_s = max(run.end_ns * 1e-9, 1e-9)
    for flight in run.approvals:
        if flight.vehicle not in places:
            continue
        claims = run.claims.get(flight.vehicle, ())
        share = inside_share(claims, run.truth[flight.vehicle]) if flight.vehicle in tracked else None
        volumes = claims[-1].volumes if claims else ()
        begins_s = min((volume.start_ns for volume in volumes), default=0) * 1e-9
        ends_s = max((volume.end_ns for volume in volumes), default=0) * 1e-9
        delay_s = flight.delay_s
        rows.append(
            {
                "index": places[flight.vehicle],
                "vehicle": flight.vehicle,
                "wanted": round(100.0 * max(flight.wanted_s or 0.0, 0.0) / span_s, 2),
                "from": round(100.0 * max(begins_s, 0.0) / span_s, 2),
                "wide": round(100.0 * max(min(ends_s, span_s) - max(begins_s, 0.0), 0.0) / span_s, 2),
                "numbers": [
                    quantities.count(flight.requests),
                    quantities.count(flight.rejections),
                    quantities.quantity(delay_s, "s", 0),
                    quantities.quantity(flight.climb_m if delay_s is not None else None, "m", 0),
                    quantities.quantity(100.0 * share if share is not None else None, "%", 1),
                ],
            }
        )
    return render("run/airspace.html.jinja", rows=rows)


def render_links(run: RunContents) -> Markup:
    """Render the totals by kind of link, then a folded table of link instances per operator."""
    seconds = max(run.recorded_ns - min(run.start_ns, 0), 1) * 1e-9
    roles = _roles(run.manifest)
    folds = []
    for place, operator in enumerate(run.operator_colours):
        operator_links = [stats for stats in run.links if stats.operator == operator]
        if not operator_links:
            continue
        sent, delivered = sum(stats.sent for stats in operator_links), sum(stats.delivered for stats in operator_links)
        folds.append(
            {
                "place": place,
                "operator": operator,
                "count": len({(stats.kind, stats.owner) for stats in operator_links}),
                "sent": sent,
                "share": f"{100 * delivered / sent:.2f} % delivered" if sent else "silent",
                "rows": [
                    _row(stats, f"{stats.kind}:{stats.owner}", roles, seconds) for stats in operator_links if stats.sent
                ],
            }
        )
    kinds = [_row(stats, stats.kind, roles, seconds) for stats in sum_by_kind(run.links)]
    return render("run/links.html.jinja", kinds=kinds, folds=folds)


def _row(stats: LinkStatistics, name: str, roles: Mapping[tuple[str, str], str], seconds: float) -> Mapping[str, Any]:
    """One direction of one link, or the sum of several. A delivered share below 100 % is not rounded up to 100 %."""
    lost, overflow = stats.fates.get(Fate.LOST, 0), stats.fates.get(Fate.OVERFLOW, 0)
    part = 100 * stats.delivered / stats.sent if stats.sent else 0.0
    return {
        "name": name,
        "ends": roles.get((stats.kind, stats.direction), stats.direction),
        "sent": stats.sent,
        "delivered": quantities.quantity(part, "%", 2 if 99 < part < 100 else 1) if stats.sent else quantities.MISSING,
        "bar": format_number(part * 0.48),
        "lost": lost,
        "overflow": overflow,
        "other": stats.sent - stats.delivered - lost - overflow,
        "size": quantities.size(stats.size_bytes),
        "mean": quantities.latency(stats.mean_latency_s),
        "p95": quantities.latency(stats.p95_latency_s),
        "frame_rate": quantities.quantity(stats.sent / seconds, ""),
        "byte_rate": quantities.size(stats.size_bytes / seconds),
    }


def _roles(manifest: Any) -> dict[tuple[str, str], str]:
    """For each kind and direction of link its ends, as `gcs → companion`, from the manifest."""
    roles = {}
    for row in manifest.get("links") or []:
        kind = str(row.get("name", "")).split(":", 1)[0]
        first, second = (_role(str(row.get(end, ""))) for end in "ab")
        roles[kind, "fwd"], roles[kind, "rev"] = f"{first} → {second}", f"{second} → {first}"
    return roles


def _role(name: str) -> str:
    owner = owner_of(name)
    return name[len(owner) + 1 :] if owner != name else name


MAX_TRACKS: Final = 40
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
    tracks = [track for track in run.truth.values() if len(track)][:MAX_TRACKS]
    return np.array([track.at(times) for track in tracks], dtype=np.float64).reshape(-1, SAMPLES, 3)


@compiled
def _share_to(table: LossTable, flown: Floats, place: Floats) -> float:
    covered = total = 0
    for k in range(flown.shape[0]):
        for n in range(flown.shape[1]):
            total += 1
            covered += _covers(table, flown[k, n], place)
    return covered / total if total > 0 else math.nan


@compiled
def _share_between(table: LossTable, flown: Floats) -> float:
    covered = total = 0
    for k in range(flown.shape[0]):
        for m in range(k):
            for n in range(flown.shape[1]):
                total += 1
                covered += _covers(table, flown[k, n], flown[m, n])
    return covered / total if total > 0 else math.nan


@compiled
def _covers(table: LossTable, a: Floats, b: Floats) -> int:
    loss = table_loss_db(table, a[0], a[1], max(a[2], 0.0), b[0], b[1], max(b[2], 0.0), 1.0, 0.1)
    return 1 if loss == loss else 0


MAX_PAIRS = 300
"""Rows of one table."""


def render_receptions(rows: Sequence[ReceptionSummary]) -> Markup:
    """Render the receptions of a pair's attacked run, decoded or not, by sender and receiver."""
    return render(
        "receptions.html.jinja",
        texts=["sender", "receiver"],
        numbers=["decoded", "of", "median", "strongest"],
        rows=[
            {
                "first": row.sender,
                "second": row.receiver,
                "numbers": (
                    quantities.count(row.decoded),
                    quantities.count(row.of) if row.of is not None else quantities.MISSING,
                    quantities.quantity(row.median_dbm, "dBm", 0),
                    quantities.quantity(row.most_dbm, "dBm", 0),
                ),
            }
            for row in rows[:MAX_PAIRS]
        ],
        total=len(rows),
    )


def reception_section(rows: Sequence[ReceptionSummary], fleet: int, end_s: float) -> Mapping[str, Any] | None:
    """Table of the senders that each receiver of a run decoded, and which receivers it lists; `None` if there is none.

    `fleet` is the number of aircraft; the age of the last reception is taken at `end_s`.
    """
    if not rows:
        return None
    table = render(
        "receptions.html.jinja",
        texts=["receiver", "hears"],
        numbers=["decoded", "median", "strongest", "longest silence", "age at the end"],
        rows=[
            {
                "first": row.receiver,
                "second": row.sender,
                "numbers": (
                    quantities.count(row.decoded),
                    quantities.quantity(row.median_dbm, "dBm", 0),
                    quantities.quantity(row.most_dbm, "dBm", 0),
                    quantities.quantity(row.silence_s, "s", 1),
                    quantities.quantity(None if row.last_s is None else max(end_s - row.last_s, 0.0), "s", 1),
                ),
            }
            for row in rows[:MAX_PAIRS]
        ],
        total=len(rows),
    )
    whose = "each receiver on the ground and each aircraft" if fleet <= MAX_AIRCRAFT else "each receiver on the ground"
    return {"receivers": whose, "table": table}
