"""Data of a run's page, read from the record once, and the tracks that its charts get of it as JSON.

Numbers are integers in small units (centimetres, centiseconds, centimetres per second), each stored as the difference
from the one before, which halves the file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyrange.core.time import NS_PER_S
from skyrange.figures.palette import ThemeColour, base_colours, theme_colour
from skyrange.figures.subject import Subject, subject_of
from skyrange.figures.track_simplification import select_samples
from skyrange.metrics.approvals import Claim, FlightApprovals, measure_approvals, read_claims
from skyrange.metrics.links import LinkStatistics, ReceptionSummary, link_statistics, reception_summaries
from skyrange.metrics.paths import received_waypoints
from skyrange.metrics.safety import Mishap, find_mishaps
from skyrange.metrics.summary import FlightSummary, summarise_flights
from skyrange.metrics.time_series import (
    EMPTY_TRACK,
    RecordedNote,
    Track,
    Vehicle,
    belief_errors_m,
    belief_tracks,
    end_ns,
    labelled_acts,
    last_activity_ns,
    operators,
    read_notes,
    truth_tracks,
)
from skyrange.record import RunRecord
from skyrange.record.schema import keeps


@dataclass(frozen=True, slots=True)
class RunContents:
    """The contents of one run's record. `operator_colours` are by operator id.

    The page shows the time from `start_ns` to `end_ns`; `recorded_ns` is the end of the record, which is later if the
    last part has no motion and no event. Tracks end at `end_ns`; `flights` cover the whole record.
    """

    record: RunRecord
    subject: Subject
    operator_colours: Mapping[str, ThemeColour]
    truth: Mapping[str, Track]
    belief: Mapping[str, Track]
    waypoints: Mapping[str, NDArray[np.float64]]
    events: Sequence[RecordedNote]
    decisions: Sequence[RecordedNote]
    attacks: Sequence[RecordedNote]
    marks: Sequence[Mishap]
    links: Sequence[LinkStatistics]
    flights: Sequence[FlightSummary]
    reception_summaries: Sequence[ReceptionSummary]
    approvals: Sequence[FlightApprovals]
    claims: Mapping[str, Sequence[Claim]]
    start_ns: int
    end_ns: int
    recorded_ns: int

    @property
    def manifest(self) -> Mapping[str, Any]:
        """The run's manifest."""
        return self.record.manifest

    @property
    def status(self) -> str:
        """`complete`, `interrupted`, `failed` or `running`, which is also the status of a killed run."""
        return str(self.manifest.get("status") or "unknown")

    @property
    def has_frames(self) -> bool:
        """Whether the run kept its frames, and with them belief, waypoints and claims."""
        return keeps(self.manifest, "frames")

    @property
    def fleet(self) -> Sequence[Vehicle]:
        """The aircraft, in the manifest's order."""
        return self.subject.fleet

    @property
    def colours(self) -> Mapping[str, ThemeColour]:
        """By vehicle id, a shade of its operator's colour."""
        return self.subject.colours


def read_run(record: RunRecord) -> RunContents:
    """Read a run."""
    subject = subject_of(record)
    has_frames = keeps(record.manifest, "frames")
    truth = truth_tracks(record)
    belief = belief_tracks(record) if has_frames else dict.fromkeys(truth, EMPTY_TRACK)
    events, decisions, attacks = read_notes(record, "events"), read_notes(record, "decisions"), labelled_acts(record)
    recorded = end_ns(record, [*truth.values(), *belief.values()])
    start = min((int(track.time_ns[0]) for track in truth.values() if len(track)), default=0)
    calm = last_activity_ns(truth.values(), [*events, *decisions, *attacks])
    view = recorded if calm is None else min(recorded, max(calm + (calm - start) // 25 + 2 * NS_PER_S, NS_PER_S))
    return RunContents(
        record=record,
        subject=subject,
        operator_colours={name: theme_colour(colour) for name, colour in base_colours(operators(record)).items()},
        truth={name: track.until(view) for name, track in truth.items()},
        belief={name: track.until(view) for name, track in belief.items()},
        waypoints=received_waypoints(record) if has_frames else {},
        events=events,
        decisions=decisions,
        attacks=attacks,
        marks=find_mishaps(events, truth),
        links=link_statistics(record),
        flights=summarise_flights(record, subject.fleet, truth, belief, events),
        reception_summaries=reception_summaries(record),
        approvals=measure_approvals(decisions),
        claims=read_claims(record) if has_frames else {},
        start_ns=start,
        end_ns=view,
        recorded_ns=recorded,
    )


MAX_TRUTH_POINTS = 20_000
"""Samples of all true tracks."""
MAX_BELIEF_POINTS = 10_000
"""Samples of all believed tracks."""
MAX_PER_TRACK = 3_000
MANY_AIRCRAFT = 60
"""With more aircraft the page draws simpler figures."""
MAX_POINTS_OF_MANY = 12
"""Samples of a track in the figures of many aircraft."""
TOLERANCE_OF_MANY_M = 0.5
TOLERANCE_M = 0.02
"""A dropped sample lies no farther than this from the drawn line, unless a track exceeds the limits above."""
_SPEED_WEIGHT_S = 0.3
"""When tracks are thinned, an error of 1 m/s in speed weighs as much as so many metres in position."""

Floats = NDArray[np.float64]


def draw_simply(tracks: Mapping[str, Track]) -> Mapping[str, Track]:
    """The tracks for a figure: of many aircraft, with few samples each."""
    if len(tracks) <= MANY_AIRCRAFT:
        return tracks
    return {name: track.take(_simplify(track)) for name, track in tracks.items()}


def _simplify(track: Track) -> NDArray[np.int64]:
    return select_samples(track.time_ns, track.enu_m, MAX_POINTS_OF_MANY, TOLERANCE_OF_MANY_M)


def pack_tracks(run: RunContents) -> tuple[dict[str, Any], dict[str, int]]:
    """The data, and counts of the record and the page: `points` and `points_drawn`."""
    fleet = run.fleet
    places = {name: number for number, name in enumerate(run.operator_colours)}
    notes = {"points": 0, "points_drawn": 0}
    aircraft = []
    for vehicle in fleet:
        truth, belief = run.truth[vehicle.id], run.belief[vehicle.id]
        rows = _thinned(truth, truth.speed_mps, _budget(MAX_TRUTH_POINTS, len(fleet)))
        seen_gaps = belief_errors_m(truth, belief)
        belief_rows = _thinned(belief, seen_gaps, _budget(MAX_BELIEF_POINTS, len(fleet)))
        notes["points"] += len(truth) + len(belief)
        notes["points_drawn"] += len(rows) + len(belief_rows)
        aircraft.append(
            {
                "id": vehicle.id,
                "short": vehicle.short,
                "op": places[vehicle.operator],
                "ink": list(run.colours[vehicle.id]),
                "home": [round(value, 2) for value in vehicle.home_enu_m] if vehicle.home_enu_m else None,
                "truth": _packed(truth, truth.speed_mps, rows),
                "belief": _packed(belief, seen_gaps, belief_rows),
            }
        )
    data = {
        "start": run.start_ns * 1e-9,
        "end": run.end_ns * 1e-9,
        "operators": [{"id": name, "ink": list(colour)} for name, colour in run.operator_colours.items()],
        "vehicles": aircraft,
    }
    return data, notes


def _budget(total: int, count: int) -> int:
    return max(40, min(MAX_PER_TRACK, total // max(count, 1)))


def _thinned(track: Track, fourth: Floats, budget: int) -> NDArray[np.int64]:
    values = np.column_stack([track.enu_m, fourth * _SPEED_WEIGHT_S])
    return select_samples(track.time_ns, values, budget, TOLERANCE_M)


def _packed(track: Track, fourth: Floats, rows: NDArray[np.int64]) -> dict[str, list[int]]:
    """`t` in centiseconds; `e`, `n`, `u` and `x` (speed or distance from truth) in hundredths; all as differences."""
    columns = (track.time_ns[rows] * 1e-9, *track.enu_m[rows].T, fourth[rows])
    return {name: _differences(column * 100.0) for name, column in zip("tenux", columns, strict=True)}


def _differences(values: Floats) -> list[int]:
    whole = np.rint(values).astype(np.int64)
    return [int(value) for value in np.diff(whole, prepend=0)]
