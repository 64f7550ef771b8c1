"""One flight of one aircraft: what the ground station is asked to do, and the outcome."""

from __future__ import annotations

from dataclasses import dataclass

from skyrange.core.time import Time
from skyrange.gcs.plan.plans import FlightPlan


@dataclass(frozen=True, slots=True)
class Flight:
    """One aircraft of an operator and the plan that it flies.

    `vehicle` is the range-wide id (`blue/b1`). `system_id` is the MAVLink system id, 1…250, unique within the
    operator's MAVLink network number `network`. The ground station arms and starts the aircraft at `depart_s`
    (seconds of simulated time), or as soon after that as the aircraft is ready. It asks for approval at `request_s`.
    """

    vehicle: str
    system_id: int
    plan: FlightPlan
    depart_s: float = 0.0
    request_s: float = 0.0
    network: int = 0


@dataclass(frozen=True, slots=True)
class FlightOutcome:
    """How a flight ended: `state` (complete or failed), `reason` of a failure, and when."""

    state: str
    reason: str
    finished_ns: Time
