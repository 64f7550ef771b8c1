"""Measures of one run by which variants of a scenario are compared."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from skyrange.metrics.aircraft import Measured, measure, read_ticks
from skyrange.metrics.approvals import (
    FlightApprovals,
    delays_by_operator,
    fairness,
    inside_share,
    is_tracked,
    measure_approvals,
    read_claims,
)
from skyrange.metrics.safety import NEAR_M, distinct_mishaps, mishap_kind
from skyrange.metrics.time_series import read_notes, truth_tracks
from skyrange.record.read.run import RunRecord


class Quantity(NamedTuple):
    """One measure of a whole run."""

    name: str
    unit: str
    about: str


QUANTITIES: Final = (
    Quantity("missions complete", "", "aircraft whose mission is complete"),
    Quantity("collisions", "", "collisions with aircraft, once for both, and with buildings"),
    Quantity("near misses", "", f"times that two aircraft in the air came nearer than {NEAR_M:g} m"),
    Quantity("least separation", "m", "least distance of two aircraft in the air, centre to centre"),
    Quantity("way flown", "km", "of all aircraft together"),
    Quantity("last mission ends", "s", "when the last aircraft with a complete mission touched down"),
    Quantity("requests", "", "requests for approval and activation"),
    Quantity("rejections", "", "requests that were rejected, with or without alternatives"),
    Quantity("answer, median", "s", "from a request to its answer at the ground station"),
    Quantity("answer, longest", "s", "the longest of these"),
    Quantity("all approved", "s", "when the last flight was approved"),
    Quantity("time in claimed airspace", "%", "of the time in flight, while an approval tracks the flight"),
    Quantity("delay, mean", "s", "how much later than wanted the approved flights take place"),
    Quantity("delay, longest", "s", "the longest of these"),
    Quantity("climb, mean", "m", "how much higher than planned the approved flights fly"),
    Quantity("fairness", "", "Jain's index of the operators' mean delays: 1 if all are equal"),
)
"""In the order in which they are reported."""


class RunMeasures(NamedTuple):
    """The measures of one run."""

    values: dict[str, float]
    """By name of the quantity; what a run does not have is missing."""
    delays_s: dict[str, float]
    """Mean delay of the approved flights of each operator."""


def measure_run(record: RunRecord, measured: Sequence[Measured] | None = None) -> RunMeasures:
    """Measure a run; `measured` are the measures of its aircraft, if they are known."""
    if measured is None:
        measured = measure(record, read_ticks(record), NEAR_M)
    flights = measure_approvals(read_notes(record, "decisions"))
    delays_s = delays_by_operator(flights)
    values = {
        **_of_aircraft(measured),
        "collisions": float(_count_collisions(record)),
        **_of_approvals(flights, delays_s),
        "time in claimed airspace": _inside(record),
    }
    return RunMeasures({name: value for name, value in values.items() if value is not None}, delays_s)


def _inside(record: RunRecord) -> float | None:
    """The share of the flight time in claimed airspace, in percent, over all flights that an approval tracks."""
    if not record.keeps("frames"):  # in which claims are
        return None
    claims = {
        vehicle: vehicle_claims for vehicle, vehicle_claims in read_claims(record).items() if is_tracked(vehicle_claims)
    }
    tracks = truth_tracks(record) if claims else {}
    shares = [
        inside_share(vehicle_claims, tracks[vehicle]) for vehicle, vehicle_claims in claims.items() if vehicle in tracks
    ]
    known = [share for share in shares if share is not None]
    return 100.0 * float(np.mean(known)) if known else None


def _count_collisions(record: RunRecord) -> int:
    """The collisions of a run; the two events of two aircraft are one."""
    return sum(mishap_kind(row) == "collision" for row in distinct_mishaps(read_notes(record, "events")))


def _of_aircraft(measured: Sequence[Measured]) -> dict[str, float | None]:
    ends = [
        aircraft.landed_s for aircraft in measured if aircraft.outcome == "complete" and aircraft.landed_s is not None
    ]
    apart = [aircraft.min_separation_m for aircraft in measured if aircraft.min_separation_m is not None]
    return {
        "missions complete": float(sum(aircraft.outcome == "complete" for aircraft in measured)),
        "near misses": sum(aircraft.near_misses for aircraft in measured) / 2.0,
        "least separation": min(apart, default=None),
        "way flown": math.fsum(aircraft.distance_m for aircraft in measured) / 1e3,
        "last mission ends": max(ends, default=None),
    }


def _of_approvals(flights: list[FlightApprovals], delays_s: dict[str, float]) -> dict[str, float | None]:
    answers = [second for flight in flights for second in flight.answers_s]
    delays = [flight.delay_s for flight in flights if flight.delay_s is not None]
    approved = [flight.approved_s for flight in flights if flight.approved_s is not None]
    return {
        "requests": float(sum(flight.requests for flight in flights)),
        "rejections": float(sum(flight.rejections for flight in flights)),
        "answer, median": float(np.median(answers)) if answers else None,
        "answer, longest": max(answers, default=None),
        "all approved": max(approved, default=None),
        "delay, mean": float(np.mean(delays)) if delays else None,
        "delay, longest": max(delays, default=None),
        "climb, mean": float(np.mean([flight.climb_m for flight in flights if flight.delay_s is not None]))
        if delays
        else None,
        "fairness": fairness(list(delays_s.values())),
    }
