"""CS-EMA detector: its charts against the published formulas, and hand-made telemetry with small lasting errors."""

from __future__ import annotations

from collections.abc import Callable
from math import ceil, log, sin, sqrt
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from skyrange.codec.mavlink import dialect
from skyrange.contracts.monitors import DetectorPlugin, ObservedFrame
from skyrange.core.time import NS_PER_S
from skyrange.detect.navigation.cs_ema import Chart, CsEma, FieldReference, turns_to_earth
from skyrange.detect.sensor_values import fix_errors
from skyrange.scenario.shipped import load as load_scenario
from skyrange.study.runs import run
from tests.unit.telemetry_sample import (
    alerts,
    attitude,
    fix,
    north,
    position,
    pressure,
    replayed,
    residuals,
    seen,
    times,
)

pytestmark = pytest.mark.rotating

CS_EMA = DetectorPlugin.find("navigation.cs_ema")

PUBLISHED = {
    "position": Chart(weight=0.01, cap=0.85, ema_limit=0.45, shift=0.5, cusum_limit=3.0),
    "barometer": Chart(weight=0.05, cap=0.52, ema_limit=0.15, shift=0.25, cusum_limit=3.0),
    "magnetometer": Chart(weight=0.01, cap=0.52, ema_limit=0.3, shift=0.25, cusum_limit=3.0),
    "gyroscope": Chart(weight=0.01, cap=0.85, ema_limit=0.25, shift=0.5, cusum_limit=3.0),
}
"""The values that the authors of VIMU set for their evaluation."""
SPREAD_M = 1.5 * sqrt(2.0)
"""Standard deviation of an innovation at a claimed accuracy of 1.5 m, with as much for the reference."""


def first_alarms(chart: Chart, ratios: NDArray[np.float64]) -> tuple[int | None, int | None]:
    """The number of the first value with an alarm of the CUSUM and of the EMA, by the published formulas."""
    total = mean = 0.0
    by_sum = by_mean = None
    for number, ratio in enumerate(ratios.tolist(), 1):
        total = max(0.0, total + abs(ratio) - chart.shift)
        mean = (1.0 - chart.weight) * mean + chart.weight * min(max(ratio, -chart.cap), chart.cap)
        if total > chart.cusum_limit and by_sum is None:
            by_sum = number
        if abs(mean) > chart.ema_limit and by_mean is None:
            by_mean = number
    return by_sum, by_mean


def first_above(statistics: NDArray[np.float64]) -> int | None:
    found = np.flatnonzero(statistics > 1.0)
    return int(found[0]) + 1 if len(found) else None


@pytest.mark.parametrize("name", PUBLISHED)
def test_the_charts_alarm_when_the_published_formulas_do(name: str) -> None:
    chart, random = PUBLISHED[name], np.random.default_rng(1)
    outcomes = set()
    for number in range(60):
        ratios = random.normal(random.uniform(-0.6, 0.6), random.uniform(0.05, 0.5), 600)
        ratios[300] += 30.0 * (number % 4 == 0)
        charts = CsEma(chart, 1)
        sums, means = charts.add(np.zeros(600, dtype=np.int64), ratios[:, None])
        expected = first_alarms(chart, ratios)
        assert (first_above(sums[:, 0]), first_above(means[:, 0])) == expected
        outcomes.add(tuple(alarm is not None for alarm in expected))
    alone = chart.ema_limit < chart.shift
    assert outcomes == {(False, False), (True, False), (True, True)} | ({(False, True)} if alone else set())


@pytest.mark.parametrize(("name", "bias"), [("position", 0.48), ("barometer", 0.2), ("gyroscope", 0.4)])
def test_a_bias_below_b_is_found_by_the_moving_average_alone(name: str, bias: float) -> None:
    """The purpose of CS-EMA: a CUSUM tolerates every bias up to b for ever, the EMA only up to its limit."""
    chart, places = PUBLISHED[name], np.zeros(1000, dtype=np.int64)
    sums, means = CsEma(chart, 1).add(places, np.full((1000, 1), bias))
    assert first_above(means[:, 0]) == ceil(log(1.0 - chart.ema_limit / bias) / log(1.0 - chart.weight))
    assert not sums.any()
    _, tolerated = CsEma(chart, 1).add(places, np.full((1000, 1), -0.99 * chart.ema_limit))
    assert 0.98 < tolerated.max() < 1.0


def test_charts_of_ends_and_axes_are_apart_in_one_batch_and_in_many() -> None:
    random = np.random.default_rng(2)
    places, ratios = random.integers(0, 3, 50), random.normal(0.0, 1.0, (50, 2))
    whole, single = CsEma(PUBLISHED["position"], 2), CsEma(PUBLISHED["position"], 2)
    sums, means = whole.add(places, ratios)
    each = [single.add(places[[row]], ratios[[row]]) for row in range(50)]
    assert sums.tolist() == [found[0][0].tolist() for found in each]
    assert means.tolist() == [found[1][0].tolist() for found in each]
    left_out = CsEma(PUBLISHED["position"]._replace(cusum_limit=0.0, ema_limit=0.0), 2)
    assert not np.any(left_out.add(places, 100.0 * ratios))


def flown(until_s: float, shift_m: Callable[[float], float]) -> list[ObservedFrame]:
    fixes = [fix(at, north, shift_m(at)) for at in times(until_s, 2)]
    return [position(at, north) for at in times(until_s, 4)] + fixes


def test_a_jump_is_found_by_the_second_fix_and_a_small_offset_after_minutes() -> None:
    assert alerts(CS_EMA, flown(300.0, lambda at: 0.9 * sin(at)), 300.0) == []
    (jump,) = alerts(CS_EMA, flown(31.0, lambda at: 5.0 if at >= 30 else 0.0), 31.0)
    assert (jump.subject, jump.data["residual"], jump.at / NS_PER_S) == ("blue/b1", "position_cusum", 30.55)
    assert jump.score == pytest.approx(2 * (5.0 / SPREAD_M - 0.5) / 3.0, rel=0.02)
    assert jump.data["ratio"] == pytest.approx(5.0 / SPREAD_M, rel=0.03)
    bias = 0.48
    slow = alerts(CS_EMA, flown(300.0, lambda at: bias * SPREAD_M if at >= 60 else 0.0), 300.0)
    assert residuals(slow) == {("blue/b1", "position_ema")}
    count = log(1.0 - 0.45 / bias) / log(0.99)
    assert slow[0].at / NS_PER_S == pytest.approx(60.0 + count / 2, abs=8.0)
    assert alerts(CS_EMA, flown(300.0, lambda at: bias * SPREAD_M), 300.0, position_ema=0.0) == []


def test_an_accuracy_that_a_receiver_claims_widens_its_charts() -> None:
    away = [fix(at, north, 20.0 if at >= 30 else 0.0, h_acc_mm=40_000) for at in times(60, 2)]
    assert alerts(CS_EMA, [*flown(0.0, lambda at: 0.0), *(position(at, north) for at in times(60, 4)), *away], 60) == []


def test_heights_of_fixes_count_on_request_from_the_first_on() -> None:
    def climbing(at_s: float) -> tuple[float, float, float]:
        east, nrth, up = north(at_s)
        return east, nrth, up + 100.0 + (8.0 if at_s >= 20 else 0.0)

    frames = [*(position(at, north) for at in times(60, 4)), *(fix(at, climbing) for at in times(60, 2))]
    assert alerts(CS_EMA, frames, 60.0) == []
    (found,) = alerts(CS_EMA, frames, 22.0, heights=True)
    assert found.data["residual"] == "position_cusum"
    assert found.at / NS_PER_S == pytest.approx(21.5, abs=0.6)
    assert found.data["ratio"] == pytest.approx(8.0 / (1.5 * 2.5 * sqrt(2.0)), rel=0.01)


def test_a_velocity_that_differs_for_long_is_found() -> None:
    def fast(at_s: float, speed: float = 5.4) -> tuple[float, float, float]:
        return 0.0, speed * at_s, 30.0

    frames = [*(position(at, fast) for at in times(200, 4)), *(fix(at, fast) for at in times(200, 2))]
    found = alerts(CS_EMA, frames, 200.0)
    assert residuals(found) == {("blue/b1", "velocity_ema")}
    ratio = 0.4 / (0.3 * sqrt(2.0))
    count = log(1.0 - 0.5 / ratio) / log(0.99)
    assert found[0].at / NS_PER_S == pytest.approx(count / 2, abs=4.0)
    assert alerts(CS_EMA, frames, 60.0, velocity_cusum=0.1, velocity_ema=0.0) == []  # the ratio is below b, 1
    faster = [position(at, lambda at: fast(at, 6.0)) for at in times(3, 4)] + [fix(at, fast) for at in times(3, 2)]
    (quick,) = alerts(CS_EMA, faster, 1.5, velocity_cusum=3.0, position_cusum=0.0)
    assert (quick.data["residual"], quick.at / NS_PER_S) == ("velocity_cusum", 1.05)
    assert alerts(CS_EMA, [fix(at, fast, 99.0) for at in times(60, 2)], 60.0) == []  # there is no estimate


def test_a_barometer_that_leaves_the_estimate_is_found() -> None:
    frames = [position(at, north) for at in times(60, 4)]
    assert alerts(CS_EMA, frames + [pressure(at, 27.0) for at in times(60, 2)], 60.0) == []
    false = [pressure(at, 27.0 + (4.0 if at >= 30 else 0.0)) for at in times(60, 2)]
    found = alerts(CS_EMA, frames + false, 60.0)
    assert residuals(found) == {("blue/b1", "barometer_cusum"), ("blue/b1", "barometer_ema")}
    assert min(alert.at for alert in found) / NS_PER_S == pytest.approx(32.5, abs=1.0)


def turn(roll: float, pitch: float, yaw: float) -> NDArray[np.float64]:
    """The matrix from the body frame to north, east, down."""
    (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    found: NDArray[np.float64] = about_z @ about_y @ about_x
    return found


def leaning(at_s: float) -> tuple[float, float, float]:
    return 0.3 * sin(at_s), 0.2 * sin(0.7 * at_s), 0.4 * at_s


def field(at_s: float, magnet_mgauss: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> ObservedFrame:
    body = turn(*leaning(at_s)).T @ (182.0, -37.0, 465.0) + magnet_mgauss
    x, y, z = (round(value) for value in body)
    return seen(at_s, dialect.MAVLink_raw_imu_message(round(at_s * 1e6), 0, 0, 0, 0, 0, 0, x, y, z))


def test_a_field_that_does_not_turn_with_the_attitude_is_found() -> None:
    attitudes = [attitude(at, *leaning(at)) for at in times(60, 10)]
    assert alerts(CS_EMA, attitudes + [field(at) for at in times(60, 2)], 60.0) == []
    magnet = [field(at, (-100.0, 60.0, 0.0) if at >= 30 else (0.0, 0.0, 0.0)) for at in times(60, 2)]
    found = alerts(CS_EMA, attitudes + magnet, 60.0)
    assert residuals(found) >= {("blue/b1", "magnetometer_cusum")}
    assert 30.0 < found[0].at / NS_PER_S < 32.0
    assert found[0].data["ratio"] == pytest.approx(-100.0 / 50.0, rel=0.1)
    false = [attitude(at, *leaning(at if at < 30 else at + 1.0)) for at in times(60, 10)]
    assert ("blue/b1", "magnetometer_cusum") in residuals(
        alerts(CS_EMA, false + [field(at) for at in times(60, 2)], 60)
    )
    rare = [attitude(at, *leaning(at)) for at in times(60, 1)]
    assert alerts(CS_EMA, rare + [field(at + 0.5) for at in times(59, 1)], 60.0) == []


def test_the_field_of_the_earth_and_the_bias_of_a_compass_are_told_apart() -> None:
    """Against the batch least squares of all fields with the same beginnings, and no growth of the variances."""
    random, reference = np.random.default_rng(3), FieldReference()
    earth, bias = np.array([0.18, -0.04, 0.46]), np.array([0.02, -0.01, 0.03])
    angles = random.uniform(-1.0, 1.0, (40, 3)) * (0.3, 0.3, 3.0)
    turns = turns_to_earth(*angles.T)
    assert turns == pytest.approx(np.array([turn(*each) for each in angles]))
    fields = turns.transpose(0, 2, 1) @ earth + bias + random.normal(0.0, 0.003, (40, 3))
    rows = np.concatenate([turns.transpose(0, 2, 1), np.broadcast_to(np.eye(3), (40, 3, 3))], axis=2)
    start = np.concatenate([turns[0] @ fields[0], np.zeros(3)])
    place = np.zeros(1, dtype=np.int64)
    for number in range(40):
        ratios = reference.predict(place, fields[[number]], turns[[number]], np.zeros(1))[0]
        used = rows[:number].reshape(-1, 6)
        covariance = np.linalg.inv(np.eye(6) + used.T @ used)
        residual = fields[:number].ravel() - used @ start
        expected = fields[number] - rows[number] @ (start + covariance @ used.T @ residual)
        spread = 0.05 * np.sqrt(np.diag(rows[number] @ covariance @ rows[number].T) + 1.0)
        assert ratios == pytest.approx(expected / spread, abs=1e-9)
        reference.update(place, fields[[number]], turns[[number]])
    assert np.abs(ratios).max() < 0.3
    widened = reference.predict(place, fields[[39]] + 0.1, turns[[39]], np.array([1e9]))[0]
    assert 1.0 < widened.max() < (0.1 + 0.015) / 0.05


def test_differences_are_taken_at_the_time_of_the_fix() -> None:
    fused = np.array([[407_780_000.0, -739_550_000.0, 300.0, -400.0]])
    stale = np.array([[407_780_000.0, -739_550_000.0, 500.0, 0.0]])
    away, slip = fix_errors(stale, fused, np.array([0.5]))
    assert away[0] == pytest.approx([2.0, -1.5])
    assert slip[0] == pytest.approx([4.0, 2.0])


@pytest.mark.catalogue
@pytest.mark.parametrize(
    ("name", "attack", "duration_s", "residual", "first_s", "last_s"),
    [
        ("gnss.meacon", "repeater", 32, "position_cusum", 25, 32),
        ("telemetry.attitude", "attitude", 33, "magnetometer_cusum", 30, 32),
    ],
)
def test_shipped_attacks_are_found_and_their_nominal_runs_are_silent(
    tmp_path: Path, name: str, attack: str, duration_s: int, residual: str, first_s: float, last_s: float
) -> None:
    changes = [f"duration_s={duration_s}", 'operators.0.streams="operator"']
    attacked = run(load_scenario(name, changes), tmp_path / "attacked")
    nominal = run(load_scenario(name, [*changes, f"attacks.{attack}.muted=true"]), tmp_path / "nominal")
    found = [alert for alert in replayed(attacked, CS_EMA) if alert.data["residual"] == residual]
    assert first_s < found[0].at / NS_PER_S < last_s
    assert replayed(nominal, CS_EMA) == []
