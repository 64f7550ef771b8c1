"""Evidence of sight about one claimed position: a sequential test, over scans, of whether something flies there.

Each scan is a look. Under the hypothesis *honest*, an aircraft is at the claimed position, up to an error with the
standard deviation `sigma_m` on every axis; under *nothing there*, only noise and clutter return. A look sees something
if a pulse returns from within the gate, a sphere of `GATE_SIGMAS` around the claimed position. The logarithm of the
ratio of likelihoods adds up from look to look (Wald, "Sequential Tests of Statistical Hypotheses", Ann. Math. Statist.
16, 1945), between limits that the two allowed rates of error set.

The error of the position hardly changes from scan to scan, so an aircraft may stay in a part of the gate that no beam
reaches: outside the field, behind something near, or before a wall of the map. The share of the gate that was looked
at limits how strong the evidence of absence can become.

How often an aircraft returns a pulse depends on rain and fog. So there is a ratio for each of several extinctions of
the air, and a verdict takes those that the returns of the map do not contradict (`sight.air`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import StrEnum
from typing import Final, NamedTuple

import numpy as np

from skyrange.core import elementary_python
from skyrange.core.arrays import Floats
from skyrange.core.elementwise import exp
from skyrange.optics.mounted_sensors import MountedSensor
from skyrange.optics.ray_index import RayIndex
from skyrange.vehicle.sight.beams import (
    BODY_M,
    WALL_M,
    Beams,
    SensorView,
    find_field,
    find_map_distances,
    find_near_surfaces,
)

GATE_SIGMAS: Final = 3.5
"""A position with an independent normal error on three axes is within 3.5 standard deviations in 99.3 %."""
CLUTTER: Final = 0.01
"""Probability that a look returns something else from the gate: birds, drops, wires, leaves (assumed)."""
_FADE: Final = 0.1
"""Weight of a new look in the mean share of the gate that was looked at."""


class Verdict(StrEnum):
    """What sight says of a claim."""

    SEEN = "seen"
    NOT_SEEN = "not-seen"
    """Looked, and not seen."""
    COULD_NOT_LOOK = "could-not-look"


class Rates(NamedTuple):
    """The rates of error that a verdict may have."""

    missed: float = 0.01
    """Probability that an honest aircraft is called not seen."""
    false: float = 0.01
    """Probability that a claim without an aircraft is called seen."""


DEFAULT_RATES: Final = Rates()


class Look(NamedTuple):
    """One scan at one claimed position."""

    looked: float
    """Share of the gate, weighted by where an honest aircraft would be, that beams passed through; 0 to 1."""
    honest: Sequence[float]
    """Probability that an honest aircraft in that share returns a pulse, by extinction of the air."""
    nothing: float
    """Probability that noise or clutter does."""
    is_hit: bool


NO_LOOK: Final = Look(0.0, (), 0.0, is_hit=False)


def can_reject(sensor: MountedSensor, rates: Rates, sigma_m: float) -> bool:
    """Whether the sensor can look at so much of a gate that a claim is *not seen*: the field is widest at its reach."""
    low, high = 0.0, GATE_SIGMAS
    while high - low > 1e-6:  # within so many standard deviations on one axis an honest aircraft is, but for `missed`
        middle = 0.5 * (low + high)
        low, high = (middle, high) if elementary_python.erfc(middle * math.sqrt(0.5)) > rates.missed else (low, middle)
    widest = min(0.5 * min(find_field(sensor.model.pattern)), 1.5)
    return sensor.model.reach_m * elementary_python.tan(widest) >= high * sigma_m


def look_at(  # noqa: PLR0917
    view: SensorView, beams: Beams, claimed: Floats, sigma_m: float, city: RayIndex, extinctions: Sequence[float]
) -> Look:
    """Look at a claimed position (3,) with the beams of a scan, through air of each of `extinctions` in 1/m."""
    toward = claimed - beams.origin
    away2 = float(toward[0] * toward[0] + toward[1] * toward[1] + toward[2] * toward[2])
    gate = GATE_SIGMAS * sigma_m
    away = math.sqrt(away2)
    if away > view.reach_m + gate:
        return NO_LOOK
    x, y, z = beams.direction.T
    along = toward[0] * x + toward[1] * y + toward[2] * z
    beside2 = away2 - along * along
    rows = np.flatnonzero((along > 0.0) & (beside2 < gate * gate))
    if not rows.size:
        return NO_LOOK
    half = np.sqrt(gate * gate - np.maximum(beside2[rows], 0.0))
    begin, end = np.maximum(along[rows] - half, 0.0), along[rows] + half
    mapped = find_map_distances(city, beams, rows, away + 2.0 * gate)
    distance = beams.distance_m[rows]
    returned = distance > 0.0
    # beams that end at something nearer, and beams to a surface of the map in the gate, say nothing
    clear = ~(returned & (distance < begin)) & (mapped > end + WALL_M)
    if not clear.any():
        return NO_LOOK
    hits = clear & returned & (distance <= end)
    points = beams.origin + beams.direction[rows[hits]] * distance[hits, None]
    is_hit = bool((~find_near_surfaces(city, points, WALL_M)).any())
    weight = exp(-0.5 * beside2[rows[clear]] / (sigma_m * sigma_m))
    across, up = view.spacing_rad
    cell = across * up * away2
    total = 0.0
    for one in weight.tolist():
        total += one
    looked = min(total * cell / (2.0 * math.pi * sigma_m * sigma_m), 1.0)
    area = BODY_M[0] * BODY_M[1]
    # pulses that meet a body come together: a row meets it with several, or passes it by
    together = max(1.0, BODY_M[0] / (across * away)) * max(1.0, BODY_M[1] / (up * away))
    groups = area / cell / together
    honest = [1.0 - elementary_python.exp(-groups * view.find_probability(away, one)) for one in extinctions]
    noise = view.false_alarm_per_m * 2.0 * gate * int(clear.sum())
    return Look(looked, honest, 1.0 - elementary_python.exp(-noise) * (1.0 - CLUTTER), is_hit)


class Evidence:
    """What the looks at one claim have said so far."""

    __slots__ = ("_looked", "_ratios", "looks")

    def __init__(self, extinctions: int) -> None:
        """`extinctions` is the number of those that are thought possible."""
        self._ratios = [0.0] * extinctions
        """By extinction: logarithm of the ratio of likelihoods, honest over nothing there, of an aircraft where was
        looked.
        """
        self._looked = 0.0
        self.looks = 0

    def add(self, look: Look, rates: Rates, weight: float) -> None:
        """Take in a look; `weight` is less than 1 for looks that repeat what the last one saw."""
        if look.looked <= 0.0 or look.honest[0] <= 0.0:  # the first air is the clearest
            return
        self.looks += 1
        self._looked = look.looked if self.looks == 1 else self._looked + _FADE * (look.looked - self._looked)
        # beyond its limits evidence is not kept, so that a change is noticed
        low = 2.0 * elementary_python.log(rates.missed)
        high = elementary_python.log(len(self._ratios) / rates.false)
        for number, honest in enumerate(look.honest):
            either = 1.0 - (1.0 - honest) * (1.0 - look.nothing)
            if look.is_hit:
                step = elementary_python.log(either / look.nothing)
            else:
                step = elementary_python.log((1.0 - either) / (1.0 - look.nothing))
            self._ratios[number] = min(max(self._ratios[number] + weight * step, low), high)

    def judge(self, rates: Rates, allowed: int) -> Verdict:
        """The verdict, if the air is one of the first `allowed` extinctions: an aircraft is seen if it is more likely
        on the mean of these, and not seen if it is less likely through each.
        """
        ratios = self._ratios[:allowed]
        likely = elementary_python.add_up(map(elementary_python.exp, ratios)) / allowed
        if likely >= 1.0 / rates.false:
            return Verdict.SEEN
        absent = (1.0 - self._looked) + self._looked * elementary_python.exp(max(ratios))
        return Verdict.NOT_SEEN if absent <= rates.missed else Verdict.COULD_NOT_LOOK
