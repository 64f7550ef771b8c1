"""Are the messages of exported logs those of a log that ArduCopter wrote, and is that log read as the flight it was?"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pymavlink.DFReader import DFReader_binary

from skyrange.export.dataflash_messages import DEFINITIONS, MULTIPLIERS, UNITS
from skyrange.flightlog import FlightLog, read_log, split_flights
from skyrange.record import RunRecord
from skyrange.scenario.toml_files import load_text
from tests.ardupilot import needs_arducopter
from tests.flights import shared_run

pytestmark = needs_arducopter
SCENARIO = """
name = "arducopter-logged"
seed = 3
duration_s = 60
origin = { lat = 40.7780, lon = -73.9550, alt_msl_m = 20, geoid_m = -32.7 }
start_utc = 2026-01-01T12:00:00Z
[autopilots.options.ardupilot]
keep_logs = true
[[operators]]
id = "op"
streams = "operator"
  [[operators.vehicles]]
  id = "a1"
  autopilot = "ardupilot"
  plan = { path = { points = [[0, 15]], alt_m = 5 }, speed_mps = 4, end = "land" }
"""
OUR_OWN = frozenset(name for name, found in DEFINITIONS.items() if not found.source)


@pytest.fixture(scope="module")
def record() -> RunRecord:
    return shared_run(load_text(SCENARIO))


@pytest.fixture(scope="module")
def path(record: RunRecord) -> Path:
    return record.path / "dataflash" / "op-a1.bin"


@pytest.fixture(scope="module")
def log(path: Path) -> FlightLog:
    return read_log(path)


@pytest.fixture(scope="module")
def definitions(path: Path) -> dict[str, dict[Any, Any]]:
    """What ArduCopter's log says of its messages: FMT by name, FMTU by number, UNIT and MULT by id."""
    found: dict[str, dict[Any, Any]] = {"FMT": {}, "FMTU": {}, "UNIT": {}, "MULT": {}}
    reader = DFReader_binary(str(path))
    while (message := reader.recv_msg()) is not None:
        if message.get_type() in found:
            keys = (getattr(message, key) for key in ("Name", "FmtType", "Id") if hasattr(message, key))
            found[message.get_type()][next(keys)] = message
    reader.close()
    return found


@pytest.mark.parametrize("name", sorted(DEFINITIONS.keys() - OUR_OWN))
def test_a_message_has_the_fields_of_arducopters(name: str, definitions: dict[str, dict[Any, Any]]) -> None:
    ours, theirs = DEFINITIONS[name], definitions["FMT"][name]
    assert (theirs.Format, theirs.Columns, theirs.Length) == (
        ours.format, ",".join(ours.labels), ours.layout.itemsize,
    )  # fmt: skip
    units = definitions["FMTU"][theirs.Type]
    assert (units.UnitIds, units.MultIds) == (ours.units, ours.multipliers)


def test_no_message_of_our_own_has_a_name_of_arducopters(definitions: dict[str, dict[Any, Any]]) -> None:
    assert sorted(OUR_OWN) == ["EKSR", "LABL", "VNED"]
    assert not OUR_OWN & definitions["FMT"].keys()


def test_units_and_multipliers_are_arducopters(definitions: dict[str, dict[Any, Any]]) -> None:
    for mark, text in UNITS.items():
        assert definitions["UNIT"][ord(mark)].Label == text
    for mark, value in MULTIPLIERS.items():  # ArduPilot's constants have single precision
        assert definitions["MULT"][ord(mark)].Mult == pytest.approx(value, rel=1e-7)


def test_arducopters_log_is_read_as_its_flight(record: RunRecord, log: FlightLog) -> None:
    assert log.vehicle_type == "QUADROTOR"
    assert log.firmware.startswith("ArduCopter V")
    assert not log.remarks
    (flight,) = split_flights(log)
    start_s = record.manifest["start_unix_ns"] * 1e-9
    events = {row["kind"]: row["time_ns"] * 1e-9 for row in record.events.to_pylist()}
    assert log.start_unix_s is not None
    for kind, found_s in (("event.armed", flight.armed_s), ("event.disarmed", flight.disarmed_s)):
        assert found_s + log.start_unix_s - start_s == pytest.approx(events[kind], abs=0.5)
    assert flight.modes == ("GUIDED", "AUTO")
    assert flight.mission is not None
    assert [item.command for item in flight.mission.items] == [22, 178, 16, 21]
    assert flight.rows("position")["alt_msl_m"].max() - flight.home[2] == pytest.approx(5.0, abs=1.0)
    for table in ("attitude", "gnss", "battery", "vibration", "estimator"):
        assert len(log.tables[table])
