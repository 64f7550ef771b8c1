"""Measures of flight approval: requests and rejections, how long answers took, and how much later and higher flights
took place than their operators wanted.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from skyrange.core.ids import operator_of
from skyrange.core.time import NS_PER_S, Time
from skyrange.metrics.time_series import RecordedNote

_ASKED: Final = frozenset({"decision.approval_requested", "decision.activation_requested"})
_ANSWERED: Final = frozenset(
    {"decision.approved", "decision.activated", "decision.alternative_chosen", "decision.rejected"}
)


@dataclass(slots=True)
class FlightApprovals:
    """The approval of one flight, as its ground station saw it."""

    vehicle: str
    requests: int = 0
    rejections: int = 0
    answers_s: list[float] = field(default_factory=list)
    """From each request to its answer."""
    approved_s: float | None = None
    """When the flight was approved first, before its activation."""
    wanted_s: float | None = None
    """When the airspace of the first request begins."""
    given_s: float | None = None
    """When that of the request begins which was approved last."""
    climb_m: float = 0.0
    """By how much higher than planned it flies."""

    @property
    def delay_s(self) -> float | None:
        """How much later than wanted the flight may take place; `None` if it was not approved."""
        if self.wanted_s is None or self.given_s is None:
            return None
        return self.given_s - self.wanted_s


def measure_approvals(decisions: Iterable[RecordedNote]) -> list[FlightApprovals]:
    """The approvals of all flights that were requested, in the order of their first requests."""
    flights: dict[str, FlightApprovals] = {}
    asked: dict[str, tuple[Time, float]] = {}
    climbs: dict[str, float] = {}
    for note in decisions:
        vehicle = note.about
        if note.kind in _ASKED:
            flight = flights.setdefault(vehicle, FlightApprovals(vehicle))
            flight.requests += 1
            begins_s = float(note.data.get("from_s", 0.0))
            flight.wanted_s = begins_s if flight.wanted_s is None else flight.wanted_s
            asked[vehicle] = note.time_ns, begins_s
        elif note.kind in _ANSWERED and vehicle in asked:
            flight = flights[vehicle]
            since, begins_s = asked.pop(vehicle)
            flight.answers_s.append((note.time_ns - since) / NS_PER_S)
            if note.kind == "decision.alternative_chosen":
                flight.rejections += 1
                climbs[vehicle] = float(note.data.get("climb_m", 0.0))
            elif note.kind == "decision.rejected":
                flight.rejections += 1
            else:
                flight.given_s, flight.climb_m = begins_s, climbs.get(vehicle, 0.0)
                if flight.approved_s is None:
                    flight.approved_s = note.time_ns / NS_PER_S
    return list(flights.values())


def delays_by_operator(flights: Sequence[FlightApprovals]) -> dict[str, float]:
    """The mean delay of the approved flights of each operator, in seconds."""
    found: dict[str, list[float]] = {}
    for flight in flights:
        if flight.delay_s is not None:
            found.setdefault(operator_of(flight.vehicle), []).append(flight.delay_s)
    return {operator: float(np.mean(delays)) for operator, delays in found.items()}


def fairness(delays_s: Sequence[float]) -> float | None:
    """Jain's index of mean delays: 1 if all are equal, 1/n if one operator has all of the delay.

    Jain, Chiu & Hawe, "A Quantitative Measure of Fairness and Discrimination" (DEC TR-301, 1984). `None` without
    operators.
    """
    values = np.maximum(np.array(delays_s, dtype=np.float64), 0.0)
    if not len(values):
        return None
    squares = float((values**2).sum())
    return 1.0 if squares == 0.0 else float(values.sum()) ** 2 / (len(values) * squares)
