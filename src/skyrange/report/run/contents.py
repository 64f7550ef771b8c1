"""Data of a run's page, read from the record once before anything is drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyrange.core.time import NS_PER_S
from skyrange.figures.palette import ThemeColour, base_colours, theme_colour
from skyrange.figures.subject import Subject, subject_of
from skyrange.metrics.approvals import FlightApprovals, measure_approvals
from skyrange.metrics.claims import Claim, read_claims
from skyrange.metrics.flight_summary import FlightSummary, summarise_flights
from skyrange.metrics.link_statistics import LinkStatistics, link_statistics
from skyrange.metrics.mishaps import Mishap, find_mishaps
from skyrange.metrics.receptions import ReceptionSummary, reception_summaries
from skyrange.metrics.time_series import (
    EMPTY_TRACK,
    Record,
    RecordedNote,
    Track,
    Vehicle,
    belief_tracks,
    end_ns,
    labelled_acts,
    last_activity_ns,
    operators,
    read_notes,
    truth_tracks,
)
from skyrange.metrics.waypoints import received_waypoints
from skyrange.record.schema import keeps


@dataclass(frozen=True, slots=True)
class RunContents:
    """The contents of one run's record. `operator_colours` are by operator id.

    The page shows the time from `start_ns` to `end_ns`; `recorded_ns` is the end of the record, which is later if the
    last part has no motion and no event. Tracks end at `end_ns`; `flights` cover the whole record.
    """

    record: Record
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


def read_run(record: Record) -> RunContents:
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
