"""Does the light of an attacker reach an aircraft that moves as often as its beam and its tracking allow?"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.attack.bases.light import LightsSensor, even_choice
from skyrange.attack.contract import AttackPlugin
from skyrange.contracts.scan_light import ScanLight
from tests.unit.test_attack_gnss import context

AT = (50.0, 0.0, 10.0)


def laser(**params: Any) -> LightsSensor:
    kind = AttackPlugin.find("lidar.blind")
    chosen = kind.params.model_validate({"vehicles": ["blue/b1"], "at": AT, **params})
    (only,) = kind(chosen, context()).scan_hooks
    assert isinstance(only, LightsSensor)
    return only


def light(velocity: tuple[float, float, float] = (0.0, 0.0, 0.0), *, seen: bool = True) -> ScanLight:
    """A sensor 50 m west of the laser that looks at it."""
    ahead = np.array([[1.0, 0.0, 0.0]])
    return ScanLight(
        vehicle="blue/b1", sensor="ring", kind="lidar", near_m=1.0, reach_m=100.0, wavelength_um=0.9,
        velocity=np.array(velocity), origin=np.array([[0.0, 0.0, 10.0]]), direction=ahead, in_base=ahead,
        ahead=np.ones(1), delay_s=np.zeros(1), is_in_sight=lambda _: seen, transmission=np.ones(1),
        false_echo_m=np.full(1, np.nan), is_blind=np.zeros(1, np.bool_),
    )  # fmt: skip


def share_of_hits(attack: LightsSensor, lit: ScanLight, scans: int = 2_000) -> float:
    return sum(attack.on_scan(scan * 100_000_000, lit) for scan in range(scans)) / scans


@pytest.mark.parametrize(("aim_mrad", "beam_mrad"), [(1.0, 5.0), (2.0, 3.0), (5.0, 5.0)])
def test_a_still_aircraft_is_hit_as_often_as_the_aim_falls_within_the_spot(aim_mrad: float, beam_mrad: float) -> None:
    """The error of a two-axis mount has a Rayleigh distribution."""
    radius, sigma = 0.5 * (0.01 + 0.05 * beam_mrad), 0.05 * aim_mrad
    expected = 1.0 - np.exp(-0.5 * (radius / sigma) ** 2)
    share = share_of_hits(laser(aim_mrad=aim_mrad, beam_mrad=beam_mrad), light())
    assert share == pytest.approx(expected, abs=4.0 * np.sqrt(0.25 / 2_000))


def test_an_aircraft_that_flies_across_escapes_a_late_tracking_and_one_that_comes_closer_does_not() -> None:
    late = laser(aim_mrad=0.5, lag_s=0.05)
    across, closer = light((0.0, 12.0, 0.0)), light((12.0, 0.0, 0.0))
    assert share_of_hits(late, across, 200) == 0.0
    assert share_of_hits(late, closer, 200) > 0.95
    shares = [share_of_hits(laser(lag_s=lag_s), across, 500) for lag_s in (0.0, 0.008, 0.012, 0.02)]
    assert shares == sorted(shares, reverse=True)
    assert shares[0] > 0.9
    assert shares[-1] < 0.1


def test_light_stays_where_walls_are_and_within_its_range() -> None:
    assert share_of_hits(laser(), light(seen=False), 50) == 0.0
    assert share_of_hits(laser(range_m=49.0), light(), 50) == 0.0
    assert share_of_hits(laser(range_m=51.0, aim_mrad=0.0), light(), 50) == 1.0


@settings(max_examples=100)
@given(st.integers(0, 300), st.integers(1, 300))
def test_an_even_choice_is_no_larger_and_in_order(count: int, most: int) -> None:
    rows = np.arange(count) * 3
    chosen = even_choice(rows, most)
    assert len(chosen) == min(count, most)
    assert (np.diff(chosen) > 0).all()
    assert np.isin(chosen, rows).all()
