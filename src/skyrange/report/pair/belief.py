"""Belief of aircraft with altered sensors: distance from the truth, innovations, and events of their estimators.

Belief is the position that the ground station received.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import pyarrow.compute as pc
from markupsafe import Markup
from numpy.typing import NDArray

from skyrange.core.time import NEVER, NS_PER_S
from skyrange.figures.subject import Subject
from skyrange.figures.time_chart import draw_chart
from skyrange.figures.twins import Span
from skyrange.metrics.safety import mishap_kind
from skyrange.metrics.time_series import Record, Track, belief_errors_m, belief_tracks, labelled_acts, read_notes
from skyrange.report import quantities
from skyrange.report.rendering import render
from skyrange.report.viewer import at_moment

_CHART_PX: Final = (760.0, 300.0)

Line = tuple[NDArray[np.int64], NDArray[np.float64]]

_ESTIMATOR: Final = frozenset({"event.glitch", "event.estimator", "event.ekf_failsafe"})
_RATIOS: Final = ("pos_horiz_variance", "velocity_variance")
"""Fields of EKF_STATUS_REPORT: innovation divided by its rejection threshold, for position and velocity."""
MAX_NOTES: Final = 60
"""Rows of the table of estimator events."""


def with_altered_sensors(run: Record) -> list[str]:
    """The aircraft whose sensors an attack altered, ordered by the first altered reading."""
    return list(dict.fromkeys(act.about for act in labelled_acts(run) if act.kind in ("attack.sensor", "fault.sensor")))


def render_belief(
    runs: tuple[Record, Record],
    tracks: tuple[Mapping[str, Track], Mapping[str, Track]],
    subject: Subject,
    spans: Sequence[Span],
    most: int,
) -> Markup:
    """Render the section on belief; empty if no sensor was altered.

    `runs` are the attacked run and its twin, `tracks` their true tracks. Charts show the first `most` aircraft.
    """
    run, twin = runs
    vehicles = with_altered_sensors(run)
    if not vehicles:
        return Markup()
    drawn = vehicles[:most]
    gaps = [_gaps(each_run, true, drawn) for each_run, true in zip(runs, tracks, strict=True)]
    title = f"Distance of belief from truth in {subject.name}"
    away = draw_chart(
        subject, gaps[0], "metres from where it truly is", title, size_px=_CHART_PX, twins=gaps[1], spans=spans
    )
    run_lines, chart = innovations(run, drawn), None
    if run_lines:
        caption = "innovation over its gate, position or velocity, the larger"
        title = f"Innovations in {subject.name}"
        chart = draw_chart(
            subject, run_lines, caption, title, size_px=_CHART_PX, twins=innovations(twin, drawn), spans=spans
        )
    return render("pair/belief.html.jinja", gaps=away, innovations=chart, notes=_notes(run, subject, vehicles))


def innovations(run: Record, chosen: Sequence[str]) -> dict[str, Line]:
    """By aircraft, the larger of both ratios over time, from the EKF_STATUS_REPORTs that its ground station received.

    Ends at the first collision or crash.
    """
    ends = _ends(run)
    lines: dict[str, Line] = {}
    rows = run.telemetry("EKF_STATUS_REPORT", ["time_ns", "vehicle", *_RATIOS])
    for name in chosen:
        vehicle_rows = rows.filter(pc.equal(rows.column("vehicle"), name))
        times = vehicle_rows.column("time_ns").to_numpy()
        ratios = np.stack([vehicle_rows.column(key).to_numpy().astype(np.float64) for key in _RATIOS]).max(axis=0)
        flying = times <= ends.get(name, NEVER)
        if flying.any():
            lines[name] = times[flying], ratios[flying]
    return lines


def believed_tracks(run: Record, chosen: Sequence[str]) -> dict[str, Track]:
    """Believed tracks of these aircraft up to their first collision or crash; without aircraft that never reported."""
    ends = _ends(run)
    tracks = {name: track.until(ends.get(name, NEVER)) for name, track in belief_tracks(run).items() if name in chosen}
    return {name: track for name, track in tracks.items() if len(track)}


def _ends(run: Record) -> dict[str, int]:
    """Time of each aircraft's first collision or crash, after which its estimator says nothing about an attack."""
    ends: dict[str, int] = {}
    for row in read_notes(run, "events"):
        if mishap_kind(row) in ("collision", "crash"):
            ends.setdefault(row.about, row.time_ns)
    return ends


def _gaps(run: Record, tracks: Mapping[str, Track], chosen: Sequence[str]) -> dict[str, Line]:
    return {
        name: (track.time_ns, belief_errors_m(tracks[name], track))
        for name, track in believed_tracks(run, chosen).items()
    }


def _notes(run: Record, subject: Subject, vehicles: Sequence[str]) -> list[Mapping[str, Any]]:
    """Events of the estimators and estimator failsafes of these aircraft."""
    places = {vehicle.id: index for index, vehicle in enumerate(subject.fleet)}
    rows = [
        row
        for row in read_notes(run, "events")
        if row.about in vehicles and (row.kind in _ESTIMATOR or mishap_kind(row) == "failsafe")
    ]
    return [
        {
            "place": places[row.about],
            "vehicle": row.about,
            "what": row.kind.removeprefix("event.").replace("_", " "),
            "data": row.data,
            "time": at_moment(quantities.quantity(row.time_ns / NS_PER_S, "s", 2), row.time_ns / NS_PER_S, row.about),
        }
        for row in rows[:MAX_NOTES]
    ]
