"""Distances that avoidance needs at a closing speed, and how often noise alone makes a detection."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from skyrange.core.arrays import Floats
from skyrange.optics.sensor_models import LidarModel
from skyrange.vehicle.avoidance.contract import AvoidanceLimits
from skyrange.vehicle.companion.companion import CHECK_NS
from skyrange.world.airframes import IRIS
from tools.detection_range.encounters import Rule

ACCELERATION_MPS2: Final = 2.5
"""WPNAV_ACCEL of ArduCopter, its default."""
CHECK_S: Final = CHECK_NS * 1e-9
"""The longest time until a detection is considered: conflicts are computed that often."""
GATE_M: Final = 1.0
"""Returns within this distance of each other are of one target."""
MOVES_M: Final = 6.0
"""How much farther two returns of one target in two of three scans may be apart: it moves 3 m from scan to scan."""
NEAREST_M: Final = 5.0
"""Nearer returns are no target in the count of false detections."""


class Need(NamedTuple):
    """A manoeuvre and the distance between both aircraft that it needs."""

    name: str
    distance_m: float


def list_needs(speed_mps: float) -> list[Need]:
    """What manoeuvres need if two aircraft fly at each other at `speed_mps` each, in the order of the distance."""
    limits = AvoidanceLimits()
    closing = 2.0 * speed_mps
    brake_s = speed_mps / ACCELERATION_MPS2
    brake_m = 0.5 * speed_mps * brake_s
    late_m = closing * CHECK_S
    return [
        Need(f"to plan {limits.look_ahead_s:g} s ahead, as now", limits.protected_m + closing * limits.look_ahead_s),
        Need(
            f"to stop {limits.protected_m:g} m apart, alone",
            limits.protected_m + brake_m + speed_mps * brake_s + late_m,
        ),
        Need(f"to stop {limits.protected_m:g} m apart, both", limits.protected_m + 2.0 * brake_m + late_m),
        Need(f"to swerve by {limits.least_m:g} m, alone", closing * find_swerve_s(limits.least_m) + late_m),
        Need("to swerve past contact, alone", closing * find_swerve_s(2.0 * IRIS.radius_m) + late_m),
    ]


def find_swerve_s(aside_m: float) -> float:
    """The time in which an aircraft moves aside by a distance from rest."""
    return math.sqrt(2.0 * aside_m / ACCELERATION_MPS2)


def find_speed_mps(distance_m: float, aside_m: float) -> float:
    """The greatest closing speed at which a detection at a distance leaves the time to move aside."""
    return distance_m / (find_swerve_s(aside_m) + CHECK_S)


def count_false_per_hour(model: LidarModel, rule: Rule) -> float:
    """How often an hour noise alone meets a rule in an empty sky, at most.

    Noise returns are independent and evenly spread over pulses and distances. A scan meets `returns` if so many lie
    within `GATE_M` of one of them. A rule over several scans needs as many within `GATE_M` + `MOVES_M` of that one.
    """
    firing = model.pattern.list_rays(0)
    odds = model.false_alarm
    pulses = len(firing.number)
    span_m = model.reach_m - model.near_m
    # neighbours of a false return: the mean number of others within the gate, over distances and some pulses
    distances = np.linspace(max(model.near_m, NEAREST_M), model.reach_m, 200)
    chosen = firing.direction[:: max(pulses // 50, 1)]
    cosines = chosen @ firing.direction.T
    around, wider = (
        np.array([_count_within(cosines, gate_m / away) for away in distances]) * min(2.0 * gate_m / span_m, 1.0) * odds
        for gate_m in (GATE_M, GATE_M + MOVES_M)
    )
    first = odds * pulses * (model.reach_m - distances[0]) / span_m
    others = rule.returns - 1
    meets = first * np.mean([_at_least(float(value), others) for value in around])
    if rule.of == 1:
        return float(meets * model.pattern.rate_hz * 3600.0)
    # in another scan at the same place: so many false returns around a fixed point
    again = float(np.mean([_at_least(float(value), rule.returns) for value in wider]))
    pairs = math.comb(rule.of - 1, rule.scans - 1)
    return float(meets * pairs * again ** (rule.scans - 1) * model.pattern.rate_hz * 3600.0)


def _count_within(cosines: Floats, angle: float) -> float:
    """The mean number of pulses within an angle of a pulse."""
    return float((cosines > math.cos(min(angle, math.pi))).sum(axis=1).mean())


def _at_least(mean: float, count: int) -> float:
    """The probability that a Poisson variable is `count` or more."""
    below = math.fsum(math.exp(-mean) * mean**k / math.factorial(k) for k in range(count))
    return 1.0 - below if below < 1.0 - 1e-9 else mean**count / math.factorial(count)
