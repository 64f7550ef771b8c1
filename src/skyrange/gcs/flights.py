"""What is asked of a ground station for one aircraft, and what became of it?"""

from __future__ import annotations

from dataclasses import dataclass

from skyrange.core.time import Time
from skyrange.gcs.plans import FlightPlan


@dataclass(frozen=True, slots=True)
class Flight:
    """One aircraft of an operator and what it is to fly.

    `vehicle` is its range-wide id (`blue/b1`), `system_id` its MAVLink system, 1…250, unique within the
    operator's MAVLink network number `network`. It is armed and started at `depart_s`, or as soon as it is
    ready after that.
    """

    vehicle: str
    system_id: int
    plan: FlightPlan
    depart_s: float = 0.0
    network: int = 0


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a flight ended: `state` complete or failed, why it failed, when."""

    state: str
    reason: str
    finished_ns: Time
