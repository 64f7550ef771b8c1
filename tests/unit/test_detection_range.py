"""Does the study of detection range count all returns, apply its rules, and calculate what avoidance needs?"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree

from skyrange.core.arrays import Floats
from skyrange.optics.scan_patterns import Firing, RotatingPattern
from skyrange.optics.sensor_models import MID_360, VLP_16, LidarModel
from skyrange.world.airframes import IRIS
from tools.detection_range.encounters import (
    BODY,
    OUTLINE,
    RULE,
    WIRE,
    Approach,
    Encounter,
    Rule,
    approach,
    count_at,
)
from tools.detection_range.needs import count_false_per_hour, find_speed_mps, find_swerve_s, list_needs
from tools.detection_range.page import PART, find_lean_rad, find_share_m

PAGE = Path(__file__).parents[2] / "docs" / "explanation" / "detection-range.md"
COARSE = RotatingPattern(tuple(range(-15, 16, 2)), 1.0 / 3600.0, 0.0, 10.0)
"""One degree from azimuth to azimuth: few rays, so that all can be cast."""


@pytest.mark.parametrize(
    ("encounter", "distance_m"),
    [
        (Encounter(replace(VLP_16, pattern=COARSE), BODY), 4.0),
        (Encounter(replace(VLP_16, pattern=COARSE), OUTLINE), 12.0),
        (Encounter(replace(VLP_16, pattern=COARSE), OUTLINE, tilt_rad=0.1), 8.0),
        (Encounter(replace(VLP_16, pattern=COARSE), WIRE), 10.0),
        (Encounter(replace(VLP_16, pattern=COARSE), WIRE, level=True), 10.0),
    ],
)
def test_no_ray_that_meets_the_target_is_left_out(
    encounter: Encounter, distance_m: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    trials = 12
    chosen = [encounter.count_returns(distance_m, 20.0, k, k, 0.5) for k in range(trials)]

    def choose_all(self: Encounter, attitude: Floats, to_target: Floats, scan: int) -> Firing:
        return self.model.pattern.list_rays(scan)

    monkeypatch.setattr(Encounter, "_choose", choose_all)
    every = [encounter.count_returns(distance_m, 20.0, k, k, 0.5) for k in range(trials)]
    assert chosen == every
    assert sum(every) > 0


def test_returns_are_those_of_the_solid_angle() -> None:
    """Pulses in the part of the field that the outline covers: its side, and its top or bottom if seen aslant."""
    wide = replace(MID_360, divergence_rad=(0.0, 0.0), aperture_m=(0.0, 0.0), false_alarm=1e-9)
    distance_m = 12.0
    counts = count_at(Encounter(wide, OUTLINE._replace(reflectivity=0.9)), distance_m, 200)
    aslant = 0.5 / distance_m  # heights are evenly spread from -1 to 1 m
    high_m = OUTLINE.height_m + 0.25 * math.pi * 2.0 * OUTLINE.radius_m * aslant
    angle = math.degrees(2.0 * OUTLINE.radius_m / distance_m) * math.degrees(high_m / distance_m)
    assert counts.mean() == pytest.approx(20_000 / (360.0 * 59.0) * angle, rel=0.1)


def test_a_rule_is_met_at_the_end_of_the_scan_that_meets_it() -> None:
    flown = Approach(np.arange(9.0, 0.0, -1.0), np.array([0, 2, 0, 0, 3, 1, 2, 5, 0]))
    assert flown.find_detection_m(Rule(1, 1, 1)) == 8.0
    assert flown.find_detection_m(Rule(3, 1, 1)) == 5.0
    assert flown.find_detection_m(RULE) == 3.0, "scans 5 and 7; scan 2 is too long ago"
    assert flown.find_detection_m(Rule(6, 1, 1)) == 0.0
    assert find_share_m(np.array([5.0, 0.0, 9.0, 7.0]), 0.5) == 7.0
    assert find_share_m(np.array([5.0, 0.0, 9.0, 7.0]), 0.9) == 0.0


def test_an_approach_ends_before_contact() -> None:
    flown = approach(Encounter(VLP_16, OUTLINE), 20.0, 12.0, 3)
    assert np.diff(flown.left_m) == pytest.approx(-2.0)
    assert 2.0 * IRIS.radius_m < flown.left_m[-1] < 2.0 * IRIS.radius_m + 2.0
    assert 12.0 <= flown.left_m[0] + 2.0 <= 14.0


def test_needs_are_those_of_the_closed_forms() -> None:
    needs = [need.distance_m for need in list_needs(10.0)]
    assert needs[:3] == pytest.approx([20.0 + 240.0, 20.0 + 20.0 + 40.0 + 5.0, 20.0 + 40.0 + 5.0])
    assert needs[3] == pytest.approx(20.0 * math.sqrt(6.4) + 5.0)
    assert find_swerve_s(5.0) == 2.0, "½ · 2.5 m/s² · (2 s)²"
    assert find_speed_mps(needs[3], 8.0) == pytest.approx(20.0)
    assert BODY.height_m == pytest.approx(0.11, abs=1e-3), "the box of the airframe table"
    assert 15.0 < math.degrees(find_lean_rad(10.0)) < 30.0


@pytest.mark.parametrize(
    "model", [replace(MID_360, false_alarm=0.05), replace(VLP_16, pattern=COARSE, false_alarm=0.3)]
)
def test_false_detections_are_counted(model: LidarModel) -> None:
    """Against drawn noise: scans in which a return has so many others within a metre."""
    rng = np.random.default_rng(1)
    direction = model.pattern.list_rays(0).direction
    drawn = {2: 0, 3: 0}
    scans = 40
    for _ in range(scans):
        rows = np.flatnonzero(rng.random(len(direction)) < model.false_alarm)
        away = rng.uniform(model.near_m, model.reach_m, len(rows))
        places = direction[rows] * away[:, None]
        others = KDTree(places).query_ball_point(places, 1.0, return_length=True) - 1
        for count in drawn:
            drawn[count] += int((others[away >= 5.0] >= count - 1).sum())
    for count, number in drawn.items():
        rate = count_false_per_hour(model, Rule(count, 1, 1)) / 36_000.0
        assert number > 20
        assert 0.8 * number / scans < rate < 3.0 * number / scans, "at most, and not far from it"
    assert count_false_per_hour(VLP_16, Rule(2, 2, 3)) < count_false_per_hour(VLP_16, Rule(2, 1, 1))


def test_the_page_has_the_tables() -> None:
    assert "Approaches at 20 m/s" in PART.read(PAGE)
