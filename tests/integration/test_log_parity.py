"""Does a simulated flight agree with its own log, and what is refused before anything flies?"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from skyrange.cli.app import app
from skyrange.core.errors import InputError
from skyrange.flightlog import read_log
from skyrange.parity.logs.comparison import plan_logs, resume_log_parity
from skyrange.scenario.toml_files import load_file
from skyrange.study.execution.executors import InThisProcess
from skyrange.study.execution.store import claim_store, open_store
from skyrange.study.runs import fly
from tests.written_logs import Moment, TlogWriter, hop, write_tlog

pytestmark = pytest.mark.rotating
SCENARIO = """
name = "out"
duration_s = 62
origin = { lat = 47.0, lon = 8.0, alt_msl_m = 400 }
wind = { speed_mps = 4, from_deg = 250 }
[[operators]]
id = "blue"
streams = "operator"
  [[operators.vehicles]]
  id = "b1"
  start = [0, 0, 90]
  plan = { path = { points = [[0, 0, 12], [40, 0, 12]] }, end = "land" }
  depart_s = 1
"""


def invoke(*words: str) -> Any:
    return CliRunner().invoke(app, list(words))


def two_flights(path: Path) -> Path:
    """A log of two flights in AUTO and one in STABILIZE."""
    writer = TlogWriter()
    writer.upload(0.0)
    for number, mode in enumerate((3, 3, 0)):
        for moment in hop(30.0, high_m=20.0):
            time_s = moment.time_s + 60.0 * number
            writer.heartbeat(time_s, armed=3.0 < moment.time_s < 37.0, mode=mode)
            writer.moment(Moment(time_s, *moment[1:]))
    path.write_bytes(writer.data)
    return path


def test_a_simulated_flight_agrees_with_its_own_log(tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(SCENARIO)
    fly(load_file(tmp_path / "s.toml"), tmp_path / "run", report=False)
    out = tmp_path / "parity"
    words = ["parity", "log", str(tmp_path / "run"), "--autopilot", "builtin", "--seeds", "2", "--jobs", "1"]
    result = invoke(*words, "--out", str(out), "--json")
    assert result.exit_code == 0, result.output
    said = json.loads(result.stdout)["autopilots"]["builtin"]
    (flight,) = said["flights"]
    assert flight["outcomes"] == {"complete": 2}
    for name in ("leg", "descent", "landing"):
        values = flight["quantities"][name]
        assert values["simulated"] == pytest.approx(values["log"], rel=0.05, abs=0.3), name
    assert flight["quantities"]["lean"]["simulated"] == pytest.approx(flight["quantities"]["lean"]["log"], abs=1.5)
    assert not flight["quantities"]["climb"]["judged"]  # the wind is of the first half
    assert flight["quantities"]["landing"]["judged"]
    assert flight["track"]["away_m"] < 2.0
    page = (out / "parity.html").read_text()
    assert "a simulated aircraft" in page
    assert "<script" not in page
    again = invoke("resume", str(out), "--jobs", "1", "--json")
    assert json.loads(again.stdout)["autopilots"]["builtin"] == said


def test_the_wind_of_a_flight_comes_from_the_other_flights(tmp_path: Path) -> None:
    plan = plan_logs([read_log(two_flights(tmp_path / "day.tlog"))], {"builtin": 2}, ["day-2"])
    (flight,) = plan.flights
    assert flight["name"] == "day-1"
    assert "other flights of the log" in flight["estimates"]
    assert flight["judged_from_s"] == -1.0
    assert plan.unjudged == {
        "day-2": "left out by --without",
        "day-3": "it was not flown in the mode of missions",
    }


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--without", "day-9"], "day-9"),
        (["--autopilot", "px4"], "expected one of builtin, ardupilot"),
        (["--seeds", "1"], "seeds"),
        (["--page", "none.md"], "none.md"),
        (["--without", "day-1", "--without", "day-2"], "a flight in the mode of missions"),
    ],
)
def test_what_cannot_be_compared_is_refused_before_anything_flies(
    tmp_path: Path, words: list[str], reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(InThisProcess, "run", lambda *_: pytest.fail("something was flown"))
    log = two_flights(tmp_path / "day.tlog")
    result = invoke("parity", "log", str(log), "--jobs", "1", "--out", str(tmp_path / "out"), *words)
    said = f"{result.output} {result.exception}"
    assert result.exit_code in (1, 2)
    assert reason in " ".join(said.split())
    assert not (tmp_path / "out").exists()


def test_two_logs_with_one_name_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    logs = [read_log(write_tlog(folder / "x.tlog", hop())) for folder in (tmp_path, tmp_path / "a")]
    with pytest.raises(InputError, match="logs whose names differ"):
        plan_logs(logs, {"builtin": 2})


def test_an_autopilot_that_is_missing_is_told_with_the_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SKYRANGE_ARDUCOPTER", str(tmp_path / "none"))
    plan = plan_logs([read_log(two_flights(tmp_path / "day.tlog"))], {"builtin": 2, "ardupilot": 2})
    with pytest.raises(InputError, match="--autopilot builtin does without it"):
        plan.check()


def test_an_autopilot_that_has_flown_everything_is_not_needed_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SKYRANGE_ARDUCOPTER", str(tmp_path / "none"))
    plan = plan_logs([read_log(two_flights(tmp_path / "day.tlog"))], {"builtin": 2, "ardupilot": 2})
    flown = {block.name for block, (_, autopilot, _) in plan.runs.items() if autopilot == "ardupilot"}
    plan.check(flown)
    with pytest.raises(InputError, match="arducopter"):
        plan.check(flown - {min(flown)})


def test_a_fault_that_all_autopilots_share_is_told_without_advice(tmp_path: Path) -> None:
    plan = plan_logs([read_log(two_flights(tmp_path / "day.tlog"))], {"builtin": 2, "ardupilot": 2})
    flight = plan.flights[0]
    flight["scenario"] = flight["scenario"].replace("duration_s = ", "duration_s = -")
    with pytest.raises(InputError, match="duration_s") as raised:
        plan.check()
    assert "does without it" not in str(raised.value)


@pytest.mark.parametrize("change", [{"name": "../../outside"}, {"name": "a\n"}, {"judged_from_s": float("inf")}])
def test_a_folder_of_somebody_else_is_checked_before_anything_is_written(
    tmp_path: Path, change: dict[str, Any]
) -> None:
    plan = plan_logs([read_log(two_flights(tmp_path / "day.tlog"))], {"builtin": 2})
    store = claim_store(plan, tmp_path / "deep" / "plan")
    file = store.path / "plan.json"
    told = json.loads(file.read_text())
    told["told"]["flights"][0] |= change
    file.write_text(json.dumps(told))
    with pytest.raises(InputError, match=f"flights.*{next(iter(change))}"):
        resume_log_parity(open_store(store.path), InThisProcess())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["day.tlog", "deep"]
