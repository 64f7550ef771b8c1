"""Is the estimated wind that which blew, within the error that the estimate says of itself?"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from skyrange.flightlog import read_log, split_flights
from skyrange.flightlog.wind import ATTITUDE_DEG, WindEstimate, estimate_wind
from tests.written_logs import Moment, write_ulog

GRAVITY = 9.80665


def leaning(
    wind_mps: tuple[float, float],
    drag_per_s: float = 0.25,
    *,
    seed: int = 0,
    noise_deg: float = 0.0,
    still: bool = False,
) -> list[Moment]:
    """A flight around a square at 20 m, with the lean that drag in a wind (east, north) asks for, and errors of it."""
    random = np.random.default_rng(seed)
    trim = random.normal(0.0, math.radians(ATTITUDE_DEG), 2) if noise_deg else np.zeros(2)
    slow = np.zeros(2)
    rate_hz, moments = 4.0, []
    east_m = north_m = 0.0
    before = np.zeros(2)
    for k in range(280):
        time_s = k / rate_hz
        up_m = 20.0 * min(1.0, max(time_s - 2.0, 0.0) / 8.0, max(68.0 - time_s, 0.0) / 8.0)
        angle = 2.0 * math.pi * time_s / 40.0
        velocity = np.zeros(2) if still else 5.0 * np.array([math.cos(angle), math.sin(angle)]) * min(up_m / 20.0, 1.0)
        acceleration, before = (velocity - before) * rate_hz, velocity
        push = acceleration + drag_per_s * (velocity - np.array(wind_mps))
        slow = 0.9 * slow + random.normal(0.0, math.radians(noise_deg), 2) * math.sqrt(1.0 - 0.81)
        yaw_rad = 1.0
        forward = push[1] * math.cos(yaw_rad) + push[0] * math.sin(yaw_rad)
        right = push[0] * math.cos(yaw_rad) - push[1] * math.sin(yaw_rad)
        pitch_rad = -math.atan(forward / GRAVITY) + trim[0] + slow[0]
        roll_rad = math.atan(right / GRAVITY * math.cos(pitch_rad)) + trim[1] + slow[1]
        east_m, north_m = east_m + velocity[0] / rate_hz, north_m + velocity[1] / rate_hz
        moments.append(Moment(time_s, east_m, north_m, up_m, velocity[0], velocity[1], roll_rad, pitch_rad, yaw_rad))
    return moments


def estimate(folder: Path, moments: list[Moment]) -> WindEstimate | str:
    (flight,) = split_flights(read_log(write_ulog(folder / "a.ulg", moments)))
    return estimate_wind(flight)


@pytest.mark.parametrize("from_deg", [0.0, 70.0, 200.0, 330.0])
def test_a_wind_is_found_with_its_direction(from_deg: float, tmp_path: Path) -> None:
    wind = -6.0 * math.sin(math.radians(from_deg)), -6.0 * math.cos(math.radians(from_deg))
    found = estimate(tmp_path, leaning(wind))
    assert isinstance(found, WindEstimate)
    assert found.speed_mps == pytest.approx(6.0, abs=0.4)
    assert (found.from_deg - from_deg + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=5.0)
    assert found.drag_per_s == pytest.approx(0.25, rel=0.1)


def test_the_stated_error_is_that_of_the_estimates(tmp_path: Path) -> None:
    """Attitudes have a constant error, as an autopilot's have, and one that varies within seconds."""
    errors = []
    for seed in range(60):
        angle = 0.7 * seed
        wind = 5.0 * math.cos(angle), 5.0 * math.sin(angle)
        found = estimate(tmp_path, leaning(wind, seed=seed, noise_deg=1.0))
        assert isinstance(found, WindEstimate)
        errors += [(found.east_mps - wind[0]) / found.sd_mps, (found.north_mps - wind[1]) / found.sd_mps]
    assert 0.85 <= np.mean(np.abs(errors) < 1.96) <= 1.0
    assert 0.5 <= np.std(errors) <= 1.25


def test_without_motion_there_is_no_estimate(tmp_path: Path) -> None:
    reason = estimate(tmp_path, leaning((5.0, 0.0), noise_deg=0.5, still=True))
    assert isinstance(reason, str)
    assert "cannot be told apart" in reason


def test_a_short_flight_has_no_estimate(tmp_path: Path) -> None:
    moments = [moment for moment in leaning((5.0, 0.0)) if moment.time_s < 14.0]
    assert "at least 15 s are needed" in str(estimate(tmp_path, moments))
