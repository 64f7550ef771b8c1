"""Growth of an effect at the end of an attack: slow drifts are told from jumps that are over."""

from __future__ import annotations

import numpy as np
import pytest

from skyrange.metrics.aircraft import DistanceSeries, measure_growth

S = 1_000_000_000


def series(away_m: np.ndarray, landed_s: float = 1e9) -> DistanceSeries:
    """One aircraft at 10 Hz, (t,) its distances; it is in the air until it lands."""
    time_ns = np.arange(len(away_m), dtype=np.int64) * (S // 10)
    return DistanceSeries(time_ns, away_m[:, np.newaxis], (time_ns < landed_s * S)[:, np.newaxis])


SECONDS = np.arange(4_000) / 10.0


@pytest.mark.parametrize("stop_s", [95.0, 330.0])
def test_a_slow_drift_grows_until_the_end(stop_s: float) -> None:
    drift = series(0.22 * np.clip(SECONDS - 20.0, 0.0, None))
    assert measure_growth(drift, 20 * S, round(stop_s * S)) == pytest.approx(13.2, rel=0.01)


def test_a_jump_is_over_after_its_first_half() -> None:
    jump = series(np.clip(3.0 * (SECONDS - 20.0), 0.0, 30.0))
    assert measure_growth(jump, 20 * S, 95 * S) == 0.0


def test_growth_ends_with_the_flight_and_of_a_short_attack_there_is_none() -> None:
    drift = 0.22 * np.clip(SECONDS - 20.0, 0.0, None)
    assert measure_growth(series(drift, landed_s=80.0), 20 * S, 300 * S) == pytest.approx(13.2, rel=0.01)
    assert measure_growth(series(drift, landed_s=30.0), 20 * S, 300 * S) is None
    assert measure_growth(series(drift), 20 * S, 30 * S) is None
