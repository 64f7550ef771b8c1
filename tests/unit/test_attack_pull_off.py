"""What does a pull-off make of its model of the victim's filter?"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from skyrange.attack.bases.gnss.innovation_model import converged
from skyrange.attack.contract import AttackContext
from skyrange.attack.gnss.pull_off import ALIGNED, CRUISING, PULLING, STOPPING, PullOff
from skyrange.core.time import NS_PER_S


def chosen(**params: Any) -> PullOff:
    return PullOff(**{"vehicles": ["blue/b1"], "bearing_deg": 90, **params})


def planned(seconds: int = 120, **params: Any) -> PullOff:
    found = chosen(**params)
    found.prepare(cast("AttackContext", SimpleNamespace(duration_ns=seconds * NS_PER_S)))
    return found


def innovations(track: PullOff) -> np.ndarray:
    """What its own model says of its fixes: innovations over their gates, (n, 2)."""
    model = converged(track.assumed)
    rows = []
    for offset, speed in zip(track.plan.offset_at_m[1:].tolist(), track.plan.speed_at_mps[1:].tolist(), strict=True):
        by_m, by_mps = model.innovations(offset, speed)
        rows.append((by_m / model.position_gate_m, by_mps / model.velocity_gate_mps))
        model.fuse(offset, speed)
    return np.asarray(np.abs(np.array(rows)))


def test_the_gates_are_those_of_a_converged_ekf3() -> None:
    """5 sigma of 1.5 m and of 0.3 m/s, and of its own uncertainty: 5 √(2 · 1.5²) = 10.6, 5 √(3 · 0.3²) = 2.6."""
    model = converged(chosen().assumed)
    assert 10.6 < model.position_gate_m < 11.0
    assert 2.6 < model.velocity_gate_mps < 2.9
    halved = converged(chosen(pos_i_gate=250, vel_i_gate=250).assumed)
    assert halved.position_gate_m == pytest.approx(0.5 * model.position_gate_m)
    assert halved.velocity_gate_mps == pytest.approx(0.5 * model.velocity_gate_mps)


def test_the_model_follows_a_constant_offset_and_a_constant_speed() -> None:
    model = converged(chosen().assumed)
    for _ in range(1000):
        model.fuse(30.0, 0.0)
    assert model.error[:2] == pytest.approx([30.0, 0.0], abs=0.05)
    for number in range(1, 1001):
        model.fuse(30.0 + 0.4 * number, 2.0)
    assert model.innovations(30.0 + 0.4 * 1001, 2.0) == pytest.approx((0.0, 0.0), abs=0.05)


@pytest.mark.parametrize(
    "params",
    [
        {},
        {"gate_fraction": 0.9, "speed_mps": 30},
        {"gate_fraction": 0.2, "distance_m": 80},
        {"pos_i_gate": 100, "gate_fraction": 0.5, "speed_mps": 20},
        {"distance_m": 200, "speed_mps": 15, "period_s": 0.1, "lag_s": 0.1},
    ],
)
def test_no_innovation_exceeds_the_fraction_of_its_gate_and_one_reaches_it(params: dict[str, Any]) -> None:
    wanted = planned(**params)
    assert innovations(wanted).max() == pytest.approx(wanted.gate_fraction, rel=0.01)


def test_a_larger_fraction_is_faster() -> None:
    times = []
    for fraction in (0.3, 0.6, 0.9):
        track = planned(gate_fraction=fraction)
        times.append(float(np.interp(50.0, track.plan.offset_at_m, np.arange(len(track.plan.offset_at_m)) * 0.2)))
    assert times == sorted(times, reverse=True)


def test_position_and_velocity_agree_at_any_time_and_the_phases_follow_each_other() -> None:
    track = planned(aligned_s=4, distance_m=250)
    seconds = np.linspace(0.0, 119.0, 11_901)
    offsets, velocities, phases = track.shift(seconds)
    assert not offsets[seconds < 4.0].any()
    assert not velocities[seconds < 4.0].any()
    middle = 0.5 * (velocities[1:] + velocities[:-1])
    assert np.abs(np.diff(offsets, axis=0) / 0.01 - middle).max() < 0.05
    assert np.abs(offsets[:, 1:]).max() < 1e-9
    assert offsets[-1, 0] == pytest.approx(250.0, abs=1.0)
    assert offsets[:, 0].max() < 1.1 * 250.0
    assert list(dict.fromkeys(phases.tolist())) == [ALIGNED, PULLING, CRUISING, STOPPING]


def test_it_goes_on_after_its_table() -> None:
    track = planned(3_600, aligned_s=0)
    assert len(track.plan.offset_at_m) < 3_600
    offsets, velocities, _ = track.shift(np.array([3_000.0, 3_001.0]))
    assert offsets[1, 0] - offsets[0, 0] == pytest.approx(10.0)
    assert velocities[1, 0] == pytest.approx(10.0)


def test_a_fix_is_fused_before_the_next() -> None:
    with pytest.raises(ValueError, match="lag_s"):
        chosen(period_s=0.1)
