"""Delays: an aircraft that departs later by a known time lands later by that time, to the tick of the world."""

from __future__ import annotations

import numpy as np
import pytest

from skyrange.core.time import to_seconds
from skyrange.metrics.aircraft import measure, read_ticks
from skyrange.metrics.safety import NEAR_M, find_landings_s
from skyrange.metrics.time_series import read_notes
from skyrange.record import RunRecord
from skyrange.scenario.toml_files import load_text
from skyrange.twins.effects import COLUMNS, ArmOutcomes, effect_rows
from tests.ardupilot import needs_arducopter
from tests.flights import shared_run

TICK_S = 0.0025
"""The quantum of the world (`world.step`), in which nothing is timed more exactly."""
SHIFTS_S = (0.02, 0.2, 0.46, 0.98)
"""Multiples of the ground station's service time (20 ms): at other times it would not send."""
HEARTBEAT = "heartbeat"

SCENARIO = """
name = "shifted"
seed = 5
duration_s = {duration_s}
origin = [52.0, 13.0]
[sensors]
noise = 0
[record]
truth_hz = {truth_hz}
[[operators]]
id = "a"
  [[operators.vehicles]]
  id = "a1"
  {engine}
  depart_s = {depart_s}
  plan = {{ path = {{ points = [[0, 0, 4], [4, 2, 4]] }}, end = "land" }}
"""


def flown(shift_s: float, truth_hz: float = 10.0, engine: str = "", duration_s: float = 34.0) -> RunRecord:
    text = SCENARIO.format(depart_s=round(4.0 + shift_s, 3), truth_hz=truth_hz, engine=engine, duration_s=duration_s)
    return shared_run(load_text(text))


@pytest.mark.parametrize("shift_s", SHIFTS_S)
def test_a_known_delay_is_found_to_the_tick(shift_s: float) -> None:
    """Every time of an outcome in the table: one that follows the heartbeats has a description that says so."""
    one, other = (ArmOutcomes.read(flown(at_s), NEAR_M) for at_s in (shift_s, 0.0))
    (row,) = effect_rows(5, "nominal", one, other, threshold_m=1.0)
    assert row["outcome"] == row["outcome_twin"] == "complete"
    assert row["delay_s"] == pytest.approx(shift_s, abs=TICK_S + 1e-9)
    timed = [column for column in COLUMNS if column.unit == "s" and column.name.endswith("_twin_s")]
    assert timed
    for column in timed:
        if HEARTBEAT not in column.meaning:
            delay_s = row[column.name.replace("_twin_s", "_s")] - row[column.name]
            assert delay_s == pytest.approx(shift_s, abs=TICK_S + 1e-9), column.name


def check_landing(record: RunRecord) -> None:
    """The landing is a tick at which truth, recorded at each tick, comes from the air to the ground."""
    ticks = read_ticks(record)
    down = np.flatnonzero(ticks.aloft[:-1, 0] & ~ticks.aloft[1:, 0]) + 1
    assert len(down), "it did not land"
    (landed_s,) = find_landings_s(read_notes(record, "events"), record.outcomes).values()
    assert min(abs(to_seconds(int(at_ns)) - landed_s) for at_ns in ticks.time_ns[down]) <= TICK_S
    (one,) = measure(record, ticks, NEAR_M)
    assert one.landed_s == landed_s
    assert one.finished_s is not None
    assert landed_s < one.finished_s < landed_s + 6.0


def test_a_landing_is_where_truth_at_every_tick_has_it() -> None:
    check_landing(flown(0.2, truth_hz=400.0))


@needs_arducopter
def test_a_landing_of_an_arducopter_is_where_truth_has_it() -> None:
    check_landing(flown(0.2, truth_hz=400.0, engine='autopilot = "ardupilot"', duration_s=60.0))
