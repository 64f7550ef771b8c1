"""Section on flight approval: what each flight asked for, what it was given, and whether it kept to it."""

from __future__ import annotations

from typing import Any

from markupsafe import Markup

from skyrange.metrics.claims import inside_share, is_tracked
from skyrange.report import quantities
from skyrange.report.rendering import render
from skyrange.report.run.contents import RunContents


def render_airspace(run: RunContents) -> Markup | None:
    """Render a row for each flight; `None` where every flight was approved at once and nobody tracked it."""
    tracked = {vehicle for vehicle, own in run.claims.items() if is_tracked(own)}
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
        begins_s = min((one.start_ns for one in volumes), default=0) * 1e-9
        ends_s = max((one.end_ns for one in volumes), default=0) * 1e-9
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
