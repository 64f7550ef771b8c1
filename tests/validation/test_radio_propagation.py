"""Do signals arrive as P.525, P.526 and P.1411 say, and do chance's numbers have their distributions?"""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely

from skyrange.city.buildings import Building
from skyrange.city.city import City
from skyrange.core.ids import hash64
from skyrange.radio.propagation import fading
from skyrange.radio.propagation.obstruction import BLOCKED, has_line_of_sight, obstacle_index, obstruction_db
from skyrange.radio.propagation.path_loss import (
    bullington_nu,
    dipole_dbi,
    free_space_db,
    knife_edge_db,
    noise_dbm,
    open_ground_db,
    wavelength_m,
)

LAMBDA = wavelength_m(2437.0)
SEED = np.uint64(7)


def test_free_space_is_p525s() -> None:
    """P.525-4 eq. 4: 32.4 + 20·log10(f MHz) + 20·log10(d km), rounded to 0.05 dB there."""
    for distance_m in (1.0, 100.0, 2500.0):
        expected = 32.4 + 20.0 * math.log10(2437.0) + 20.0 * math.log10(distance_m / 1000.0)
        assert free_space_db(distance_m, LAMBDA) == pytest.approx(expected, abs=0.06)


def test_two_rays_over_ground() -> None:
    """P.1411-12 4.1.2's median to 0.02 dB; far out that is 20·log10(π) above the plane-earth loss of two ideal rays."""
    h1, h2 = 1.5, 2.0
    far = 5_000.0
    assert open_ground_db(far, h1, h2, LAMBDA) == pytest.approx(
        40.0 * math.log10(far) - 20.0 * math.log10(h1 * h2 / math.pi), abs=0.1
    )
    rbp = 4.0 * h1 * h2 / LAMBDA
    lbp = abs(20.0 * math.log10(LAMBDA**2 / (8.0 * math.pi * h1 * h2)))
    for share in (0.1, 0.9, 1.1, 20.0):
        slope = 20.0 if share <= 1.0 else 40.0
        expected = lbp + 6.02 + slope * math.log10(share)
        assert open_ground_db(share * rbp, h1, h2, LAMBDA) == pytest.approx(expected, abs=0.02)


def test_high_up_it_is_free_space() -> None:
    assert open_ground_db(2_000.0, 60.0, 40.0, LAMBDA) == free_space_db(2_000.0, LAMBDA)


@pytest.mark.parametrize(("nu", "loss_db"), [(-0.78, 0.0), (0.0, 6.03), (1.0, 13.93), (2.4, 20.54), (10.0, 32.9)])
def test_knife_edge(nu: float, loss_db: float) -> None:
    """P.526-15 fig. 9 and eq. 31 are within 0.1 dB of the Fresnel integrals for ν > -0.7; these are the integrals'."""
    assert knife_edge_db(nu) == pytest.approx(loss_db, abs=0.15)


def _fresnel_db(nu: float) -> float:
    """The loss behind a half plane by P.526-15 eq. 30, its Fresnel integrals summed numerically."""
    u = np.linspace(0.0, nu, 400_001)
    step = u[1] - u[0]
    phase = 0.5 * math.pi * u**2
    c = (np.cos(phase)[:-1] + np.cos(phase)[1:]).sum() * 0.5 * step
    s = (np.sin(phase)[:-1] + np.sin(phase)[1:]).sum() * 0.5 * step
    return -20.0 * math.log10(math.sqrt((1.0 - c - s) ** 2 + (c - s) ** 2) / 2.0)


@pytest.mark.parametrize("nu", [-0.5, 0.01, 0.5, 1.5, 3.0, 6.0])
def test_knife_edge_against_fresnel_integrals(nu: float) -> None:
    """Eq. 31 is an approximation of eq. 30: 0.2 dB allowed."""
    assert knife_edge_db(nu) == pytest.approx(_fresnel_db(nu), abs=0.2)


def test_bullingtons_edge_of_one_edge_is_that_edge() -> None:
    """ν = h·√(2d/λd1d2), to 1e-12."""
    d1, d2, h = 120.0, 480.0, 7.0
    expected = h * math.sqrt(2.0 * (d1 + d2) / (LAMBDA * d1 * d2))
    assert bullington_nu(h / d1, h / d2, d1 + d2, LAMBDA) == pytest.approx(expected, rel=1e-12)


def _city(*boxes: tuple[float, float, float, float, float]) -> City:
    return City([Building(str(k), box[4], shapely.box(*box[:4])) for k, box in enumerate(boxes)], "test")


def _loss(city: City, a: tuple[float, float, float], b: tuple[float, float, float], margin_db: float = 200.0) -> float:
    return obstruction_db(obstacle_index(city.walls()), *a, *b, LAMBDA, margin_db)


def test_over_a_long_thin_wall() -> None:
    """A wall 2 m thick and 4 km long between antennas 400 m apart, 10 m above the line: J(ν) of one edge, 0.1 dB."""
    city = _city((-1.0, -2_000.0, 1.0, 2_000.0, 40.0))
    nu = 10.0 * math.sqrt(2.0 * 400.0 / (LAMBDA * 200.0 * 200.0))
    assert _loss(city, (-200.0, 0.0, 30.0), (200.0, 0.0, 30.0)) == pytest.approx(knife_edge_db(nu), abs=0.1)


def test_round_one_corner() -> None:
    """A tower too tall to pass over, one corner 5 m off the line, the other 200 m: J(ν) of the near one, 0.5 dB."""
    city = _city((-1.0, -200.0, 1.0, 5.0, 900.0))
    nu = 5.0 * math.sqrt(2.0 * 400.0 / (LAMBDA * 200.0 * 200.0))
    assert _loss(city, (-200.0, 0.0, 30.0), (200.0, 0.0, 30.0)) == pytest.approx(knife_edge_db(nu), abs=0.5)


def test_both_sides_add_by_power() -> None:
    """P.526-15 5.1: a slab with both edges 5 m off lets twice the power by, so 3 dB less; 0.5 dB."""
    one = _loss(_city((-1.0, -200.0, 1.0, 5.0, 900.0)), (-200.0, 0.0, 30.0), (200.0, 0.0, 30.0))
    two = _loss(_city((-1.0, -5.0, 1.0, 5.0, 900.0)), (-200.0, 0.0, 30.0), (200.0, 0.0, 30.0))
    assert one - two == pytest.approx(3.0, abs=0.5)


def test_a_way_round_may_be_walled_up() -> None:
    """With a second tower where the way round the corner leads, only the long way over both is left."""
    a, b = (-200.0, 0.0, 30.0), (200.0, 0.0, 30.0)
    open_ = _city((-1.0, -200.0, 1.0, 5.0, 900.0))
    shut = _city((-1.0, -200.0, 1.0, 5.0, 900.0), (-60.0, 2.0, -50.0, 300.0, 900.0))
    assert _loss(shut, a, b) > _loss(open_, a, b) + 10.0


def test_a_roof_just_below_the_line() -> None:
    """Grazing: 6 dB on the line, less with clearance, nothing 4 m above; J(ν) of the nearer edge, 0.05 dB."""
    city = _city((-0.5, -2_000.0, 0.5, 2_000.0, 40.0))
    for above_m in (0.001, 0.5, 2.0):
        nu = -above_m * math.sqrt(2.0 * 800.0 / (LAMBDA * 400.0 * 400.0))
        got = _loss(city, (-400.0, 0.0, 40.0 + above_m), (400.0, 0.0, 40.0 + above_m))
        assert got == pytest.approx(knife_edge_db(nu), abs=0.05)
    assert _loss(city, (-400.0, 0.0, 44.5), (400.0, 0.0, 44.5)) == 0.0


def test_loss_is_the_same_both_ways_and_stops_at_its_margin() -> None:
    rng = np.random.default_rng(3)
    corners = rng.uniform(-300.0, 300.0, (60, 2))
    city = _city(
        *((x, y, x + 25.0, y + 30.0, h) for (x, y), h in zip(corners, rng.uniform(10.0, 80.0, 60), strict=True))
    )
    for _ in range(300):
        a = (*rng.uniform(-400.0, 400.0, 2), rng.uniform(1.0, 100.0))
        b = (*rng.uniform(-400.0, 400.0, 2), rng.uniform(1.0, 100.0))
        there, back = _loss(city, a, b), _loss(city, b, a)
        assert there == pytest.approx(back, abs=1e-6)
        for margin_db in (3.0, 12.0, 30.0):
            short = _loss(city, a, b, margin_db)
            assert short == (there if there <= margin_db else BLOCKED)


def test_sight_lines_are_the_citys() -> None:
    """Clear where a prism does not meet the line, by shapely: 600 lines."""
    rng = np.random.default_rng(4)
    corners = rng.uniform(-300.0, 300.0, (80, 2))
    city = _city(*((x, y, x + 25.0, y + 30.0, 50.0) for x, y in corners))
    obstacles = obstacle_index(city.walls())
    seen = 0
    for _ in range(600):
        a, b = rng.uniform(-500.0, 500.0, 2), rng.uniform(-500.0, 500.0, 2)
        low = float(rng.uniform(1.0, 49.0))
        line = shapely.LineString([a, b])
        expected = not any(line.intersects(building.shape) for building in city.buildings)
        assert has_line_of_sight(obstacles, a[0], a[1], low, b[0], b[1], low) == expected
        assert has_line_of_sight(obstacles, a[0], a[1], 50.1, b[0], b[1], 50.1)
        seen += expected
    assert 50 < seen < 550


def test_dipole_and_noise() -> None:
    """Balanis 4-84: 2.15 dBi level, half power 39° up; −174 dBm/Hz + 10·log10(20 MHz) = −101 dBm. 0.05 dB."""
    assert dipole_dbi(0.0) == pytest.approx(2.15)
    assert dipole_dbi(math.sin(math.radians(39.0))) == pytest.approx(2.15 - 3.0, abs=0.05)
    assert dipole_dbi(1.0) == -20.0
    assert noise_dbm(0.0, 20.0) == pytest.approx(-101.0, abs=0.05)


def test_shadowing_is_normal_and_decorrelates() -> None:
    """σ = 8 dB out of sight, 2 % of 20,000 pairs; correlation 1/e at 13 m along a line, 0.03."""
    side = fading.cell_side_m(True)
    here = np.empty(20_000)
    there = np.empty(20_000)
    other = np.uint64(fading.cell_of(0.0, 0.0, 0.0, side))
    for k in range(20_000):
        pair = np.uint64(fading.pair_of(np.uint64(hash64(f"a{k}")), np.uint64(hash64("b"))))
        x = 7.3 * k
        here[k] = fading.shadow_db(SEED, pair, np.uint64(fading.cell_of(x, 0.0, 0.0, side)), other, 10.0, True)
        there[k] = fading.shadow_db(SEED, pair, np.uint64(fading.cell_of(x + 13.0, 0.0, 0.0, side)), other, 10.0, True)
    assert here.std() == pytest.approx(8.0, rel=0.02)
    assert abs(here.mean()) < 0.2
    assert np.corrcoef(here, there)[0, 1] == pytest.approx(1.0 / math.e, abs=0.03)


@pytest.mark.parametrize("hidden", [True, False])
def test_fading_has_rices_power(hidden: bool) -> None:
    """Mean 1, variance (2K + 1)/(K + 1)² (Rice; Rayleigh has K = 0): 3 % of 40,000 bins."""
    pair = np.uint64(fading.pair_of(np.uint64(1), np.uint64(2)))
    power = np.array(
        [
            10.0 ** (0.1 * fading.fade_db(fading.fade_draws(SEED, pair, k * 4096, 4096, 2437.0), hidden))
            for k in range(40_000)
        ]
    )
    ratio = 0.0 if hidden else fading.RICIAN_K
    assert power.mean() == pytest.approx(1.0, rel=0.03)
    assert power.var() == pytest.approx((2.0 * ratio + 1.0) / (ratio + 1.0) ** 2, rel=0.04)


def test_fading_holds_for_the_coherence_time() -> None:
    """0.423·λ/v rounded down to a power of two: at 10 m/s 5.2 ms, so 4.19 ms; the same from both ends."""
    assert fading.coherence_ns(10.0, LAMBDA) == 1 << 22
    pair = np.uint64(fading.pair_of(np.uint64(1), np.uint64(2)))
    assert pair == fading.pair_of(np.uint64(2), np.uint64(1))
    width = 1 << 22
    first = fading.fade_db(fading.fade_draws(SEED, pair, 5 * width, width, 2437.0), True)
    assert fading.fade_db(fading.fade_draws(SEED, pair, 6 * width - 1, width, 2437.0), True) == first
    assert fading.fade_db(fading.fade_draws(SEED, pair, 6 * width, width, 2437.0), True) != first
