"""Did the autopilots notice that their sensors lied? Belief against truth, innovations, and what estimators said.

Only aircraft whose sensors were altered are told of. Belief is what their ground station received, as everywhere.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Final

import numpy as np
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.core.time import NEVER, NS_PER_S
from skyrange.study.chart import over_time
from skyrange.study.marks import alarming
from skyrange.study.report import words
from skyrange.study.series import Record, Track, belief_tracks, gaps_m, happenings, hostile_acts
from skyrange.study.subject import Subject
from skyrange.study.twins import Span

Line = tuple[NDArray[np.int64], NDArray[np.float64]]

_ESTIMATOR: Final = frozenset({"event.glitch", "event.estimator", "event.ekf_failsafe"})
_RATIOS: Final = ("pos_horiz_variance", "velocity_variance")
"""EKF_STATUS_REPORT: innovations over what they are rejected at, of position and of velocity."""
MOST_SAID: Final = 60
"""Rows of the table of what estimators said."""


def deceived(run: Record) -> list[str]:
    """The aircraft whose sensors an attack altered, in the order in which it began to."""
    return list(dict.fromkeys(act.about for act in hostile_acts(run) if act.kind == "attack.sensor"))


def belief(
    runs: tuple[Record, Record],
    tracks: tuple[Mapping[str, Track], Mapping[str, Track]],
    subject: Subject,
    spans: Sequence[Span],
    most: int,
) -> str:
    """The section as HTML, "" where no sensor was altered; of the attacked run and its twin, with their true tracks.

    Charts show the first `most` aircraft.
    """
    run, twin = runs
    whom = deceived(run)
    if not whom:
        return ""
    drawn = whom[:most]
    gaps = [_gaps(each, true, drawn) for each, true in zip(runs, tracks, strict=True)]
    title = f"Distance of belief from truth in {subject.name}"
    away = over_time(subject, gaps[0], "metres from where it truly is", title, 760.0, 300.0, gaps[1], spans)
    found = innovations(run, drawn)
    if found:
        said = "innovation over its gate, position or velocity, the larger"
        title = f"Innovations in {subject.name}"
        chart = over_time(subject, found, said, title, 760.0, 300.0, innovations(twin, drawn), spans).svg
    else:
        chart = words.nothing("The ground stations did not ask for EKF_STATUS_REPORT; streams = “operator” does.")
    return (
        '<section id="belief"><h2>Belief</h2><p class="lead">Of aircraft whose sensors were altered: how far from the '
        "truth their ground station saw them, which is what they believe, and how well what GNSS says fits what the "
        "estimator expected: above 1 it is rejected. Until a collision or crash; dashed in the twin.</p>"
        '<div class="cols"><figure class="card"><figcaption><b>Belief and truth</b> <span class="dim">how far apart'
        f'</span></figcaption><div class="still">{away.svg}</div></figure><figure class="card"><figcaption>'
        '<b>Innovations</b> <span class="dim">as the autopilot reports them</span></figcaption>'
        f'<div class="still">{chart}</div></figure></div><div class="card later">{_said(run, subject, whom)}</div>'
        "</section>"
    )


def innovations(run: Record, chosen: Sequence[str]) -> dict[str, Line]:
    """The larger of both ratios of each aircraft over time, as far as its ground station was told."""
    ends = _ends(run)
    found: dict[str, Line] = {}
    try:
        rows = run.table("telemetry", ["time_ns", "vehicle", "message", *_RATIOS])
    except KeyError:  # telemetry has a column for each field that was received, and these never were
        return found
    rows = rows.filter(pc.equal(rows.column("message"), "EKF_STATUS_REPORT"))
    for name in chosen:
        own = rows.filter(pc.equal(rows.column("vehicle"), name))
        times = own.column("time_ns").to_numpy()
        ratios = np.stack([own.column(key).to_numpy().astype(np.float64) for key in _RATIOS]).max(axis=0)
        flying = times <= ends.get(name, NEVER)
        if flying.any():
            found[name] = times[flying], ratios[flying]
    return found


def beliefs(run: Record, chosen: Sequence[str]) -> dict[str, Track]:
    """Where these aircraft were believed to be until they collided or crashed; without those never reported."""
    ends = _ends(run)
    found = {name: track.until(ends.get(name, NEVER)) for name, track in belief_tracks(run).items() if name in chosen}
    return {name: track for name, track in found.items() if len(track)}


def _ends(run: Record) -> dict[str, int]:
    """When each aircraft first collided or crashed: what its estimator says later is of no attack."""
    found: dict[str, int] = {}
    for row in happenings(run, "events"):
        if alarming(row) in ("collision", "crash"):
            found.setdefault(row.about, row.time_ns)
    return found


def _gaps(run: Record, tracks: Mapping[str, Track], chosen: Sequence[str]) -> dict[str, Line]:
    return {name: (track.time_ns, gaps_m(tracks[name], track)) for name, track in beliefs(run, chosen).items()}


def _said(run: Record, subject: Subject, whom: Sequence[str]) -> str:
    """What estimators and their failsafes noted about these aircraft."""
    places = {vehicle.id: index for index, vehicle in enumerate(subject.fleet)}
    rows = [
        row
        for row in happenings(run, "events")
        if row.about in whom and (row.kind in _ESTIMATOR or alarming(row) == "failsafe")
    ]
    if not rows:
        return words.nothing("No estimator noted anything: no fix was rejected, no belief reset.")
    cells = (
        f"<tr><td>{words.named(places[row.about], row.about)}</td>"
        f"<td>{escape(row.kind.removeprefix('event.').replace('_', ' '))}</td>"
        f"<td class=wrapped>{words.details(row.data)}</td>"
        f"{words.cells(words.quantity(row.time_ns / NS_PER_S, 's', 2))}</tr>"
        for row in rows[:MOST_SAID]
    )
    return words.table("What the estimators noted", ["aircraft", "what", "details"], ["time"], cells, "tall")
