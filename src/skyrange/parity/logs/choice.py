"""Flights of logs that are held against simulated ones, with the wind and the loss that other flights say."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from skyrange.core.errors import InputError, nearest
from skyrange.flightlog.conversion import Conversion, Estimates, convert_flight
from skyrange.flightlog.flights import Flight, split_flights
from skyrange.flightlog.model import FlightLog
from skyrange.flightlog.wind import WindEstimate, estimate_wind

_FIRST_PART = 0.5
"""Of a log with one flight: the part in the air from which the wind and the loss are estimated."""


@dataclass(frozen=True, slots=True)
class JudgedFlight:
    """A flight that is held against simulated ones."""

    name: str
    flight: Flight
    conversion: Conversion
    judged_from_s: float
    """Only what begins later in the log is judged."""


@dataclass(frozen=True, slots=True)
class UnjudgedFlight:
    """A flight that is not, and why."""

    name: str
    reason: str


def choose_flights(
    logs: Sequence[FlightLog], without: Collection[str] = ()
) -> tuple[list[JudgedFlight], list[UnjudgedFlight]]:
    """The flights of logs in the mode of missions, but those named in `without`, and the others.

    What is estimated of a flight comes from the other flights of its log, or from the first half of its time in the air
    if there are none; then only what begins in the second half is judged.

    Raises `InputError` if there is nothing to judge, for logs with the same name, and for an unknown name in `without`.
    """
    judged, others, names = [], [], []
    stems: set[str] = set()
    for log in logs:
        stem = "".join(letter if letter.isalnum() else "-" for letter in log.path.stem).strip("-").lower() or "flight"
        if stem in stems:
            raise InputError.one(str(log.path), "name", stem, "logs whose names differ", "Copy or rename one of them.")
        stems.add(stem)
        flights = split_flights(log)
        for flight in flights:
            name = f"{stem[:40]}-{flight.number}"
            names.append(name)
            if name in without:
                others.append(UnjudgedFlight(name, "left out by --without"))
            elif flight.mission is None:
                others.append(UnjudgedFlight(name, "it was not flown in the mode of missions"))
            else:
                estimates, from_s = _estimate(flight, flights)
                judged.append(JudgedFlight(name, flight, convert_flight(flight, name, estimates), from_s))
    for name in without:
        if name not in names:
            known = f"one of {', '.join(names)}" if names else "none: the logs have no flights"
            raise InputError.one("parity log", "--without", name, known, nearest(name, names))
    if not judged:
        reasons = "; ".join(f"{other.name}: {other.reason}" for other in others)
        found = f"{len(others)}, none in a mission" if others else "none"
        who = ", ".join(str(log.path) for log in logs)
        raise InputError.one(who, "flights", found, "a flight in the mode of missions", reasons)
    return judged, others


def _estimate(flight: Flight, flights: Sequence[Flight]) -> tuple[Estimates, float]:
    """What is estimated of a flight, and the time of the log from which on the flight is judged."""
    others = [other for other in flights if other is not flight]
    if others:
        winds = [wind for other in others if isinstance(wind := estimate_wind(other), WindEstimate)]
        received, lost = 0, 0
        for other in others:
            rows = other.rows("link", other.armed_s, other.disarmed_s)
            received, lost = received + int(rows["received"].sum()), lost + int(rows["lost"].sum())
        wind = combine_winds(winds) if winds else "no other flight of the log tells it"
        return Estimates(wind, received, lost, f"{len(winds)} other flights of the log"), -math.inf
    half_s = flight.take_off_s + _FIRST_PART * (flight.landing_s - flight.take_off_s)
    rows = flight.rows("link", flight.armed_s, half_s)
    own = estimate_wind(flight, 0.0, _FIRST_PART)
    return Estimates(own, int(rows["received"].sum()), int(rows["lost"].sum()), "the flight's first half"), half_s


def combine_winds(winds: Sequence[WindEstimate]) -> WindEstimate:
    """The mean of estimates, weighted by their variances.

    Its standard deviation is that of one estimate, the root of their mean variance: the error of the attitude, which is
    most of it, is the same in all flights of an aircraft and does not average out.
    """
    weights = np.array([1.0 / (wind.sd_mps * wind.sd_mps) for wind in winds])
    values = np.array([[wind.east_mps, wind.north_mps, wind.drag_per_s] for wind in winds])
    east_mps, north_mps, drag_per_s = (weights @ values / weights.sum()).tolist()
    sd_mps = math.sqrt(float(np.mean([wind.sd_mps * wind.sd_mps for wind in winds])))
    return WindEstimate(east_mps, north_mps, sd_mps, drag_per_s, float(np.sum([wind.used_s for wind in winds])))
