"""Is the wandering of fixes at rest measured as it is, and is a vehicle that is carried or flies left out?"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from skyrange.core.geodesy import Origin
from skyrange.flightlog.model import TABLES, FlightLog
from tools.agreement.fix_noise import LAGS_S, TABLE, measure_fixes, write_lines

ORIGIN = Origin(47.0, 8.0, 400.0)
LONG_S, SD_M, TAU_S = 4000, 1.5, 60.0


def make_log(*, carried_from_s: float = math.inf, armed_from_s: float = math.inf) -> FlightLog:
    """Fixes at 1 Hz with errors of a first-order process, which moves at 1 m/s from a time on, or is armed."""
    generator = np.random.default_rng(3)
    share = math.exp(-1.0 / TAU_S)
    errors = np.zeros((LONG_S, 3))
    errors[0] = generator.normal(0.0, SD_M, 3)
    for k in range(1, LONG_S):
        errors[k] = share * errors[k - 1] + generator.normal(0.0, SD_M * math.sqrt(1.0 - share * share), 3)
    times = np.arange(LONG_S, dtype=np.float64)
    moved = np.maximum(times - carried_from_s, 0.0)
    tables = {name: np.zeros(0, dtype) for name, dtype in TABLES.items()}
    tables["gnss"], tables["position"] = np.zeros(LONG_S, TABLES["gnss"]), np.zeros(LONG_S, TABLES["position"])
    tables["states"] = np.zeros(LONG_S, TABLES["states"])
    lat_deg, lon_deg = ORIGIN.to_geodetic(errors[:, 0] + moved, errors[:, 1])
    fixes = tables["gnss"]
    fixes["time_s"], fixes["fix"], fixes["satellites"], fixes["hdop"] = times, 3, 9 + (times % 100 == 0), 0.8
    fixes["lat_deg"], fixes["lon_deg"], fixes["alt_msl_m"] = lat_deg, lon_deg, 400.0 + errors[:, 2]
    tables["position"]["time_s"], tables["position"]["east_mps"] = times, moved > 0.0
    tables["states"]["time_s"], tables["states"]["armed"] = times, times >= armed_from_s
    return FlightLog(Path("x.tlog"), "tlog", None, float(LONG_S), "", "QUADROTOR", tables, {}, [], [])


def test_the_distance_of_fixes_is_that_of_the_process() -> None:
    noise = measure_fixes("x", make_log())
    for lag_s in LAGS_S:
        along_m, upright_m, pairs = noise.apart_m[lag_s]
        one_axis = math.sqrt(2.0 * SD_M**2 * (1.0 - math.exp(-lag_s / TAU_S)))
        assert along_m == pytest.approx(one_axis * math.sqrt(2.0), rel=0.15), lag_s
        assert upright_m == pytest.approx(one_axis, rel=0.2), lag_s
        assert pairs == LONG_S - 60 - lag_s
    assert (noise.satellites, noise.hdop[1]) == ((9, 10), 0.8)
    assert noise.steps == 2 * 39  # on and off again at each hundred after the first minute


def test_a_vehicle_that_is_carried_or_armed_is_not_at_rest() -> None:
    still = measure_fixes("x", make_log())
    carried = measure_fixes("x", make_log(carried_from_s=2000.0))
    assert carried.rest_s == pytest.approx(2000.0 - 60.0, abs=1.0)
    assert carried.apart_m[60.0][0] < 1.5 * still.apart_m[60.0][0]
    armed = measure_fixes("x", make_log(armed_from_s=1000.0))
    assert armed.rest_s == pytest.approx(1000.0 - 60.0, abs=1.0)


def test_a_log_that_never_rests_is_told_as_such(tmp_path: Path) -> None:
    noise = measure_fixes("x", make_log(armed_from_s=0.0))
    assert noise.rest_s == 0.0
    page = tmp_path / "page.md"
    page.write_text(f"{TABLE.begin}\n{TABLE.end}\n")
    TABLE.write(page, write_lines([noise], [measure_fixes("y", make_log())]))
    assert "| x | 0 s | – | – | – |" in page.read_text()
