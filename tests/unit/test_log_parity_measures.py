"""Are flights measured as they were flown, whatever the rate of their log, and do bands hold what they promise?"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyrange.codec.mission import Mission, MissionItem
from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.flightlog.flights import Flight
from skyrange.flightlog.model import TABLES, FlightLog
from skyrange.flightlog.wind import WindEstimate
from skyrange.parity.logs.bands import SHARE, Band, fit_band, score_track
from skyrange.parity.logs.choice import combine_winds
from skyrange.parity.logs.comparison import find_median
from skyrange.parity.logs.measures import measure_flight, restore_measures
from skyrange.report.marked_page import MarkedPart

HOME = (47.0, 8.0, 400.0)
LIFT_S, CLIMB_MPS, TOP_M, LAND_S, FAST_MPS, SLOW_MPS = 12.0, 2.5, 20.0, 55.0, 1.5, 0.5
LEAN_DEG = 7.0
MISSION = Mission(
    (
        MissionItem(3, 22, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, TOP_M),
        MissionItem(3, 16, 0.0, 0.0, 0.0, 0.0, 47.0, 8.001, TOP_M),
        MissionItem(3, 21, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    ),
    HOME,
)


def height_m(time_s: float) -> float:
    """Straight up, level, down to 10 m, and slowly to the ground."""
    slow_s = LAND_S + (TOP_M - 10.0) / FAST_MPS
    if time_s < LAND_S:
        return min(max(time_s - LIFT_S, 0.0) * CLIMB_MPS, TOP_M)
    if time_s < slow_s:
        return TOP_M - (time_s - LAND_S) * FAST_MPS
    return max(10.0 - (time_s - slow_s) * SLOW_MPS, 0.0)


def make_flight(period_s: float, phase_s: float, *, items: bool = True) -> Flight:
    """The flight in a log with one position in `period_s`."""
    times = np.arange(phase_s, 100.0, period_s)
    tables = {name: np.zeros(0, dtype) for name, dtype in TABLES.items()}
    tables["position"] = np.zeros(len(times), TABLES["position"])
    tables["position"]["time_s"] = times
    east_m = np.clip(times - 20.0, 0.0, 30.0)
    lat_deg, lon_deg = Origin(*HOME).to_geodetic(east_m, np.zeros(len(times)))
    tables["position"]["lat_deg"], tables["position"]["lon_deg"] = lat_deg, lon_deg
    tables["position"]["alt_msl_m"] = HOME[2] + np.array([height_m(time) for time in times])
    tables["attitude"] = np.zeros(len(times), TABLES["attitude"])
    tables["attitude"]["time_s"] = times
    tables["attitude"]["roll_rad"] = math.radians(LEAN_DEG)
    if items:
        tables["items"] = np.zeros(len(times), TABLES["items"])
        tables["items"]["time_s"] = times
        tables["items"]["number"] = np.where(times < LAND_S, 2, 3)
    log = FlightLog(Path("x.tlog"), "tlog", None, 100.0, "", "QUADROTOR", tables, {}, [], [])
    return Flight(log, 1, 8.0, LIFT_S, 98.0, 100.0, HOME, "", ("AUTO",), MISSION)


@given(st.floats(0.05, 1.2), st.floats(0.0, 1.0))
def test_quantities_are_those_of_the_flight_at_any_rate_of_the_log(period_s: float, phase_s: float) -> None:
    measures = measure_flight(make_flight(period_s, phase_s))
    assert measures is not None
    lifted_s, climbed_s = LIFT_S + 1.5 / CLIMB_MPS, LIFT_S + 0.9 * TOP_M / CLIMB_MPS
    slow_s = LAND_S + (TOP_M - 10.0) / FAST_MPS
    true = {
        "climb": climbed_s - lifted_s,
        "leg": LAND_S - climbed_s,
        "descent": slow_s - LAND_S,
        "landing": 8.0 / SLOW_MPS,
    }
    for name, value in true.items():
        assert measures.quantities[name].value == pytest.approx(value, abs=period_s + 1e-6), name
    assert measures.quantities["lean"].value == pytest.approx(LEAN_DEG)
    assert measures.track[:, 3].max() == pytest.approx(TOP_M, abs=CLIMB_MPS * 0.01)
    restored = restore_measures(measures.describe())
    assert restored.quantities["leg"].value == pytest.approx(measures.quantities["leg"].value, abs=1e-3)
    assert restored.track == pytest.approx(measures.track, abs=1e-3)


def test_the_begin_of_an_item_is_not_late_by_half_a_period_on_average() -> None:
    legs = []
    for phase_s in np.arange(0.0, 1.0, 0.05):
        measures = measure_flight(make_flight(1.0, float(phase_s)))
        assert measures is not None
        legs.append(measures.quantities["leg"].value)
    climbed_s = LIFT_S + 0.9 * TOP_M / CLIMB_MPS
    assert np.mean(legs) == pytest.approx(LAND_S - climbed_s, abs=0.06)


def test_the_speed_of_a_leg_is_that_of_its_middle() -> None:
    measures = measure_flight(make_flight(0.5, 0.0))
    assert measures is not None
    assert measures.find_leg_speed_mps() == pytest.approx(1.0, rel=0.02)  # 30 m from 20 s to 50 s
    without = measure_flight(make_flight(0.5, 0.0, items=False))
    assert without is not None
    assert without.find_leg_speed_mps() is None


def test_a_log_without_the_numbers_of_items_has_no_leg() -> None:
    measures = measure_flight(make_flight(0.5, 0.0, items=False))
    assert measures is not None
    assert set(measures.quantities) == {"climb"}


@given(st.integers(2, 40), st.integers(0, 2**32 - 1))
def test_a_band_holds_the_whole_tracks_of_its_share_of_the_seeds(seeds: int, seed: int) -> None:
    tracks = np.random.default_rng(seed).normal(size=(seeds, 30, 3)).cumsum(axis=1)
    band = fit_band(tracks)
    held = sum(score_track(Band(band.centre_m, band.half_m * (1.0 + 1e-12)), track).held for track in tracks)
    assert held == math.ceil(SHARE * seeds)


def test_a_simultaneous_band_is_wider_than_one_for_each_point() -> None:
    tracks = np.random.default_rng(5).normal(size=(200, 60, 3))
    assert fit_band(tracks).half_m.mean() > 3.0  # pointwise: 1.96


def test_the_interval_score_counts_width_and_distance() -> None:
    band = Band(np.zeros((2, 3)), np.full((2, 3), 1.0))
    inside = score_track(band, np.array([[0.5, 0.0, 0.0], [0.0, -1.0, 0.0]]))
    assert (inside.held, inside.inside, inside.score_m) == (True, 1.0, 2.0)
    outside = score_track(band, np.array([[0.5, 0.0, 0.0], [0.0, -1.3, 0.0]]))
    assert (outside.held, outside.inside) == (False, 0.5)
    assert outside.score_m == pytest.approx(2.0 + 40.0 * 0.3 / 6.0)
    wide = score_track(Band(np.zeros((2, 3)), np.full((2, 3), 9.0)), np.zeros((2, 3)))
    assert wide.score_m > inside.score_m


def test_winds_are_weighted_by_their_variance_and_their_error_does_not_average_out() -> None:
    winds = [WindEstimate(2.0, 0.0, 1.0, 0.3, 20.0), WindEstimate(4.0, 0.0, 2.0, 0.5, 30.0)]
    combined = combine_winds(winds)
    assert combined.east_mps == pytest.approx((2.0 * 1.0 + 4.0 * 0.25) / 1.25)
    assert combined.sd_mps == pytest.approx(math.sqrt(2.5))
    assert combine_winds(winds[:1] * 9).sd_mps == pytest.approx(1.0)


def test_the_limits_of_a_median_hold_it_and_shrink_with_more_flights() -> None:
    few, many = find_median([0.1, 0.3, 0.2]), find_median([0.1, 0.3, 0.2] * 30)
    assert few is not None
    assert many is not None
    assert (few.value, few.low, few.high, few.flights) == (0.2, 0.1, 0.3, 3)
    assert many.high - many.low < few.high - few.low
    assert find_median([]) is None


def test_the_part_of_a_page_between_marks_is_renewed_alone(tmp_path: Path) -> None:
    part, page = MarkedPart("<!-- a -->", "<!-- b -->"), tmp_path / "page.md"
    page.write_text("before\n<!-- a -->\nold\n<!-- b -->\nafter\n")
    part.write(page, ["new \\1", ""])
    assert page.read_text() == "before\n<!-- a -->\n\nnew \\1\n\n<!-- b -->\nafter\n"
    page.write_text("nothing\n")
    with pytest.raises(InputError, match="a page without the marks"):
        part.read(page)
    page.write_bytes(b"\xff")
    with pytest.raises(InputError, match="not UTF-8"):
        part.read(page)
