"""The nodes of a live range report each event and each act once, for the display of the range."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from skyrange.cli.output.flight_lines import FlightLines
from skyrange.metrics.time_series import read_notes
from skyrange.runtime.event_reports import MAX_ROWS
from tests.integration.live_virtual import fly_virtual, prepared, scenario_of

SCENARIO = """
name = "told"
seed = 3
duration_s = 12
origin = [47.3977, 8.5456]
[radio]
[[operators]]
id = "blue"
  [[operators.vehicles]]
  id = "b1"
  plan = { square = { side_m = 20, alt_m = 8 } }
[[attacks]]
id = "terminate"
kind = "mavlink.command"
start_s = 9
params = { vehicles = ["blue/b1"], command = "DO_FLIGHTTERMINATION", values = [1] }
[[attacks]]
id = "ghost"
kind = "remote_id.spoof"
start_s = 5
params = { at = [60, 150, 30], velocity_mps = [-3, -2, 0], transmitter_m = [-140, 40, 2] }
"""


@pytest.mark.rotating
def test_the_reports_of_all_nodes_are_what_the_record_has(tmp_path: Path) -> None:
    flight = prepared(scenario_of(SCENARIO), tmp_path, group="operator")
    flight.range.reports_events = True
    record = fly_virtual(flight)
    reports = flight.range.reports
    acts: Counter[str] = Counter()
    for report in reports:
        acts.update({tally.who: tally.number for tally in report.tallies})
    assert acts == Counter(record.table("labels").column("attack").to_pylist())
    assert acts["ghost"] >= 5
    told = sorted((note.time_ns, note.kind, note.about) for report in reports for note in report.notes)
    kinds = {kind for _, kind, _ in told}
    events = [row for row in read_notes(record, "events") if row.kind in kinds]
    assert told == sorted((row.time_ns, row.kind, row.about) for row in events)
    assert {"event.attack_start", "event.crash"} <= kinds
    assert len(told) < MAX_ROWS
    lines = FlightLines(1)
    for report in reports:
        lines.add(report)
    shown = [str(line) for line in lines.render()]
    assert shown[0] == "1 aircraft: 0 flying, 0 landed, 1 lost"
    assert any("blue/b1: crash at" in line for line in shown)
