"""Is the scenario of a simulated flight's log the scenario that was flown?"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from skyrange.cli.app import app
from skyrange.core.errors import InputError
from skyrange.flightlog import read_log, split_flights
from skyrange.flightlog.conversion import convert_flight
from skyrange.flightlog.wind import WindEstimate
from skyrange.record import load as load_record
from skyrange.scenario.toml_files import load_file as load
from skyrange.study.runs import fly as fly_scenario
from tests.written_logs import hop, write_tlog

pytestmark = pytest.mark.rotating
SCENARIO = """
name = "out-and-back"
duration_s = 110
start_utc = 2026-03-01T09:30:00Z
origin = {{ lat = 47.0, lon = 8.0, alt_msl_m = 400 }}
wind = {{ speed_mps = 4, from_deg = 250 }}
record = {{ csv = true }}
[[operators]]
id = "blue"
  [[operators.vehicles]]
  id = "b1"
  start = [0, 0, 90]
  plan = {{ {plan}, end = "land", speed_mps = 6 }}
  params = {{ WPNAV_ACCEL = 180 }}
  depart_s = 3
{rest}
"""
PATH = "path = { points = [[60, 0, 20], [60, 60, 25], [0, 60, 20], [0, 0, 20]] }"


def fly(folder: Path, plan: str = PATH, rest: str = "") -> Path:
    """Fly the scenario; the telemetry log of its operator."""
    (folder / "s.toml").write_text(SCENARIO.format(plan=plan, rest=rest))
    record = fly_scenario(load(folder / "s.toml"), folder / "run", report=False)
    (log,) = (record.path / "operators").glob("*.tlog")
    return log


def landing_s(path: Path) -> float:
    outcome = load_record(path).outcomes
    (state,) = outcome.values()
    assert state["state"] == "complete"
    return float(state["finished_s"])


def invoke(*words: str) -> Any:
    result = CliRunner().invoke(app, list(words))
    assert result.exit_code == 0, result.output
    return result


def test_an_imported_flight_flies_as_the_flight_did(tmp_path: Path) -> None:
    log = fly(tmp_path)
    result = invoke("import", str(log), "--out", str(tmp_path / "imported"), "--json")
    said = json.loads(result.stdout)
    assert (said["flight"], said["flights"]) == (1, 1)
    scenario = load(Path(said["scenario"]))
    assert (scenario.origin.lat, scenario.origin.lon) == pytest.approx((47.0, 8.0), abs=8e-5)  # the home is a fix
    assert scenario.origin.alt_msl_m == pytest.approx(400.0, abs=6.0)
    (operator,) = scenario.operators
    (vehicle,) = operator.vehicles
    assert vehicle.start.heading_deg == pytest.approx(90.0, abs=3.0)
    (flight,) = split_flights(read_log(log))
    conversion = convert_flight(flight, "x")
    assert isinstance(conversion.wind, WindEstimate)
    wanted_mps = 4.0
    assert abs(conversion.wind.speed_mps - wanted_mps) < 3.0 * conversion.wind.sd_mps
    assert abs((conversion.wind.from_deg - 250.0 + 180.0) % 360.0 - 180.0) < 30.0
    record = fly_scenario(scenario, tmp_path / "again", report=False)
    first_s = landing_s(tmp_path / "run") - flight.armed_s
    again_s = landing_s(record.path)
    (flown,) = split_flights(read_log(log))
    assert flown.mission is not None
    assert again_s == pytest.approx(first_s, rel=0.12)
    page = (tmp_path / "imported" / "import.html").read_text()
    for title in ("Taken", "Estimated", "Assumed", "Ignored"):
        assert f"<h2>{title}</h2>" in page


def test_the_folder_of_a_run_is_read_as_the_log_of_its_station(tmp_path: Path) -> None:
    by_file = read_log(fly(tmp_path))
    by_folder = read_log(tmp_path / "run")
    assert by_folder.format == "run"
    for name, rows in by_file.tables.items():
        assert rows.tobytes() == by_folder.tables[name].tobytes()
    assert [sent.mission.items for sent in by_file.missions] == [sent.mission.items for sent in by_folder.missions]
    with pytest.raises(InputError, match=r"--vehicle: blue/b2 — expected a vehicle of the run"):
        read_log(tmp_path / "run", vehicle="blue/b2")


def test_the_loss_of_the_link_is_found(tmp_path: Path) -> None:
    (flight,) = split_flights(read_log(fly(tmp_path, rest='[[links]]\nmatch = "gcs:*"\nmode = "datagram"\nloss = 0.1')))
    (link,) = convert_flight(flight, "x").scenario["links"]
    assert link["loss"] == pytest.approx(0.1, abs=0.02)


def test_a_flight_without_a_mission_flies_along_its_track(tmp_path: Path) -> None:
    path = write_tlog(tmp_path / "a.tlog", hop(), mission=False)
    invoke("import", str(path), "--out", str(tmp_path / "out"))
    record = fly_scenario(load(tmp_path / "out" / "scenario.toml"), tmp_path / "run", report=False)
    assert landing_s(record.path) < 120.0


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--flight", "4"), "a flight from 1 to 1"),
        (("--system", "9"), "expected one of 1"),
        (("--out", "."), "an empty"),
    ],
)
def test_a_wrong_option_is_named(words: tuple[str, str], text: str, tmp_path: Path) -> None:
    path = write_tlog(tmp_path / "a.tlog", hop())
    result = CliRunner().invoke(app, ["import", str(path), *words])
    assert result.exit_code != 0
    assert text in str(result.exception) + result.output
