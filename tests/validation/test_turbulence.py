"""Are the gusts Dryden's? Variance, correlation and spectrum against MIL-F-8785C, tolerance by sample size."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from skyrange.core.ids import hash64
from skyrange.world import Body, Wind, World, turbulence

STEP_S = 0.02
HEIGHT_M, SPEED_MPS, W20_MPS = 30.48, 12.0, 15.43  # 100 ft, and the standard's moderate turbulence, 30 knots


def _sample(n: int, steps: int, speed_mps: float = SPEED_MPS, height_m: float = HEIGHT_M, every: int = 1) -> np.ndarray:
    """Gusts (time, n, 3) of n aircraft flying east at a speed, from the kernel's own steady state on."""
    air, heard = np.zeros((n, 3)), []
    gusts = turbulence.Gusts(
        seeds=np.full(n, 7, dtype=np.uint64),
        stream=np.uint64(hash64(turbulence.STREAM)),
        who=np.array([hash64(f"blue/b{i}") for i in range(n)], dtype=np.uint64),
        steady_enu_mps=np.zeros(3),
        w20_mps=W20_MPS,
        state=np.zeros((n, turbulence.STATES)),
    )
    velocity, height = np.tile([speed_mps, 0.0, 0.0], (n, 1)), np.full(n, height_m)
    for step in range(steps):
        since_s = STEP_S if step else -1.0
        turbulence.gust(np.uint64(step * 20_000_000), since_s, gusts, velocity, height, air)
        if step % every == 0:
            heard.append(air.copy())
    return np.array(heard)


def test_scales_are_the_standards_at_its_ends() -> None:
    """3.7.3.4: at 10 ft σ_u = 0.1·W20/(0.18523)^0.4; at 1000 ft turbulence is isotropic with L = 1000 ft. 1e-9."""
    su, sw, lu, lw = turbulence.scales(3.048, 10.0)
    assert (sw, lw) == pytest.approx((1.0, 3.048), rel=1e-9)
    assert su == pytest.approx(1.0 / 0.18523**0.4, rel=1e-9)
    assert lu == pytest.approx(3.048 / 0.18523**1.2, rel=1e-9)
    assert turbulence.scales(304.8, 10.0) == pytest.approx((1.0, 1.0, 304.8, 304.8), rel=1e-9)
    assert turbulence.scales(0.0, 10.0) == pytest.approx(turbulence.scales(3.048, 10.0))
    assert turbulence.scales(2000.0, 10.0) == pytest.approx(turbulence.scales(304.8, 10.0))


@pytest.mark.parametrize(
    ("speed_mps", "height_m"),
    [(12.0, 30.48), (20.0, 3.0), *(pytest.param(*one, marks=pytest.mark.slow) for one in ((0.0, 30.48), (3.0, 300.0)))],
)
def test_variance(speed_mps: float, height_m: float) -> None:
    """σ² of each component at the start and after 4 s: 20,000 aircraft tell it to 1 %; four of those allowed."""
    su, sw, _, _ = turbulence.scales(height_m, W20_MPS)
    for gusts in _sample(20_000, 201, speed_mps, height_m, every=200):
        assert gusts.std(axis=0) == pytest.approx([su, su, sw], rel=0.02)
        assert np.abs(gusts.mean(axis=0) / [su, su, sw]).max() < 4.0 / math.sqrt(20_000)


@pytest.mark.slow
def test_autocorrelation() -> None:
    """e^(-t/T) along, e^(-t/T)·(1 - t/2T) across and up, T = L/V, over 0.1 to 4 T: 0.03 from 20,000 pairs."""
    _, _, lu, lw = turbulence.scales(HEIGHT_M, W20_MPS)
    gusts = _sample(20_000, 1001, every=10)
    first = gusts[0]
    for k in range(1, len(gusts)):
        t = 10 * k * STEP_S
        found = (first * gusts[k]).mean(axis=0) / (first * first).mean(axis=0)
        u, w = t * SPEED_MPS / lu, t * SPEED_MPS / lw
        assert found == pytest.approx(
            [math.exp(-u), math.exp(-u) * (1 - u / 2), math.exp(-w) * (1 - w / 2)], abs=0.03
        ), t


@pytest.mark.slow
def test_spectrum() -> None:
    """Φ_u = σ²·2L/(πV)/(1 + (ωT)²), Φ_w = σ²·L/(πV)·(1 + 3(ωT)²)/(1 + (ωT)²)², one-sided over ω: 8 %.

    Averaged over 1,200 aircraft's periodograms and eighths of a decade, 0.5 to 20 rad/s; the window leaks below and the
    50 Hz sampling folds above.
    """
    su, sw, lu, lw = turbulence.scales(HEIGHT_M, W20_MPS)
    steps = 4096
    gusts = _sample(1200, steps)
    window = np.hanning(steps)[:, None, None]
    power = np.abs(np.fft.rfft(gusts * window, axis=0)) ** 2 * STEP_S / (math.pi * (window**2).sum())
    omega = 2.0 * math.pi * np.fft.rfftfreq(steps, STEP_S)
    edges = np.geomspace(0.5, 20.0, 14)
    for low, high in pairwise(edges):
        band = (omega >= low) & (omega < high)
        found = power[band].mean(axis=(0, 1))
        u, w = omega[band] * lu / SPEED_MPS, omega[band] * lw / SPEED_MPS
        along = su**2 * 2 * lu / (math.pi * SPEED_MPS) / (1 + u**2)
        across = su**2 * lu / (math.pi * SPEED_MPS) * (1 + 3 * u**2) / (1 + u**2) ** 2
        up = sw**2 * lw / (math.pi * SPEED_MPS) * (1 + 3 * w**2) / (1 + w**2) ** 2
        assert found == pytest.approx([along.mean(), across.mean(), up.mean()], rel=0.08), (low, high)


def test_components_and_aircraft_are_unrelated() -> None:
    """Correlation below 4/√n for 20,000 aircraft."""
    gusts = _sample(20_000, 1)[0]
    seen = np.corrcoef(np.hstack((gusts[:-1], gusts[1:])).T)
    assert np.abs(seen - np.eye(6)).max() < 4.0 / math.sqrt(20_000)


def test_a_long_step_is_exact_too() -> None:
    """A step of half a time constant keeps the variance, and the state's covariance with the one before is theory's."""
    n = 20_000
    a, d = math.exp(-0.5), 0.5
    rng = np.random.default_rng(3)
    one = rng.standard_normal((n, 4))
    first, second = one[:, 0], 0.5 * one[:, 0] + 0.5 * one[:, 1]
    stepped = np.array(
        [turbulence._step_chain(p, q, a, d, x, y) for p, q, (_, _, x, y) in zip(first, second, one, strict=True)]
    )
    assert np.cov(stepped.T) == pytest.approx(np.array([[1.0, 0.5], [0.5, 0.5]]), abs=0.03)
    # cov(p+, p) = a, cov(q+, p) = a·(1/2 + d)
    assert (stepped * first[:, None]).mean(axis=0) == pytest.approx([a, a * (0.5 + d)], abs=0.03)


@pytest.mark.slow
def test_a_hover_in_still_air_still_gusts() -> None:
    """The speed floor: the eddies' own speed σ_u, so a gust is forgotten after some L/σ_u."""
    su, _, lu, _ = turbulence.scales(HEIGHT_M, W20_MPS)
    steps = round(lu / su / STEP_S)
    gusts = _sample(5_000, steps + 1, 0.0, every=steps)
    found = (gusts[0, :, 0] * gusts[1, :, 0]).mean() / (gusts[0, :, 0] ** 2).mean()
    assert found == pytest.approx(math.exp(-1.0), abs=0.06)


def test_gusts_ride_on_the_steady_wind_and_push() -> None:
    wind = Wind((6.0, 0.0, 0.0), W20_MPS)
    world = World([Body(f"blue/b{i}", "iris", 20.0 * i, 0.0, 500.0, seed=3) for i in range(400)], wind=wind)
    heard = []
    for tick in range(401):
        world.advance(tick * 2_500_000)
        heard.append(world.truth()["wind_east_mps"])
    su, _, _, _ = turbulence.scales(500.0, W20_MPS)
    assert np.mean(heard[-1]) == pytest.approx(6.0, abs=4.0 * su / 20.0)
    assert np.std(heard[-1]) == pytest.approx(su, rel=0.15)
    changes = [k for k in range(1, 401) if (heard[k] != heard[k - 1]).any()]
    assert {b - a for a, b in pairwise(changes)} == {8}  # every 20 ms, held between
    assert np.ptp(world.truth()["vel_east_mps"]) > 0.05


def test_company_and_order_change_no_gust() -> None:
    bodies = [Body(f"blue/b{i}", "iris", 50.0 * i, 0.0, 300.0, seed=5) for i in range(5)]
    wind = Wind((3.0, -2.0, 0.0), 10.0)
    worlds = [World(b, wind=wind) for b in (bodies[2:3], bodies, bodies[::-1])]
    for tick in range(401):
        for world in worlds:
            world.advance(tick * 2_500_000)
    for row, world in zip((0, 2, 2), worlds, strict=True):
        for name, column in world.truth().items():
            assert column[row].tobytes() == worlds[0].truth()[name][0].tobytes(), name


def test_another_seed_is_another_air() -> None:
    wind = Wind(turbulence_mps=10.0)
    seen = []
    for seed in (1, 2, 1):
        world = World([Body("blue/b1", "iris", 0.0, 0.0, 300.0, seed=seed)], wind=wind)
        world.advance(0)
        world.advance(2_500_000)
        seen.append(float(world.truth()["wind_up_mps"][0]))
    assert seen[0] == seen[2] != seen[1]
