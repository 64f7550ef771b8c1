"""Real ArduPilot processes fly in the range: beside builtin ones, the same twice, and nothing of them stays."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from skyrange.core.errors import ComponentError, InputError
from skyrange.record import load
from skyrange.runtime.run import Run
from skyrange.scenario.toml_files import load_data
from tests.ardupilot import listening, needs_arducopter, programs

pytestmark = needs_arducopter

QUICK = {"SCHED_LOOP_RATE": 100}
"""Fewer exchanges, a stated trade: a third of the time."""


def scenario(duration_s: float = 70.0, seed: int = 3, **changes: Any) -> Any:
    """Two ArduPilots and a builtin, each on a short leg and down again."""

    def vehicle(id_: str, autopilot: str, east_m: float) -> dict[str, Any]:
        params = QUICK if autopilot == "ardupilot" else {}
        return {
            "id": id_,
            "autopilot": autopilot,
            "start": [east_m, 0.0],
            "plan": {"path": {"points": [[0.0, 10.0]], "alt_m": 3.0}, "speed_mps": 4.0},
            "params": dict(params),
        }

    fleet = [vehicle("a1", "ardupilot", 0.0), vehicle("a2", "ardupilot", 30.0), vehicle("b1", "builtin", 60.0)]
    return load_data(
        {
            "name": "mixed",
            "seed": seed,
            "duration_s": duration_s,
            "origin": {"lat": 40.778, "lon": -73.955},
            "operators": [{"id": "op", "vehicles": fleet}],
            **changes,
        }
    )


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("mixed") / "run"
    Run.start(scenario(), folder).execute()
    return folder


def test_both_kinds_fly_their_missions_in_one_run(flown: Path) -> None:
    record = load(flown)
    outcomes = {vehicle: told["state"] for vehicle, told in record.manifest["outcomes"].items()}
    assert outcomes == {"op/a1": "complete", "op/a2": "complete", "op/b1": "complete"}
    engines = {engine["kind"]: engine for engine in record.manifest["engines"]}
    assert len(engines["ardupilot"]["sha256"]) == 64
    links = set(record.table("frames").column("link").to_pylist())
    assert {"autopilot:op/a1", "autopilot:op/b1", "gcs:op/a1", "rid_data:op/a2"} <= links


def test_what_happens_aboard_is_noted_alike(flown: Path) -> None:
    told: dict[str, list[str]] = {}
    for row in load(flown).table("events").to_pylist():
        told.setdefault(row["about"], []).append(row["kind"])
    for kind in ("event.mode", "event.armed", "event.takeoff", "event.item_reached", "event.landed", "event.disarmed"):
        assert kind in told["op/b1"]
        assert kind in told["op/a1"], f"{kind}: {told['op/a1']}"


def test_the_same_twice_to_the_byte(flown: Path, tmp_path: Path) -> None:
    Run.start(scenario(), tmp_path / "again").execute()
    assert load(tmp_path / "again").manifest["digests"] == load(flown).manifest["digests"]


def test_nothing_of_it_listens_on_tcp(tmp_path: Path, before: set[int]) -> None:
    run = Run.start(scenario(), tmp_path / "run")
    try:
        run.advance(-40.0 + 45.0)  # booted
        assert programs() - before
        assert listening(programs() - before) == set()
    finally:
        run.finish()


def killed(run: Run, others: set[int], what: signal.Signals) -> int:
    """Send a signal to the process of op/a1: of ours, the first that was started."""
    victim = min(programs() - others)
    os.kill(victim, what)
    return victim


def test_one_that_dies_falls_and_the_others_go_on(tmp_path: Path, before: set[int]) -> None:
    run = Run.start(scenario(autopilots={"on_silent": "continue"}), tmp_path / "run")
    try:
        run.advance(12.0)
        killed(run, before, signal.SIGSEGV)
        run.advance(70.0)
    finally:
        run.finish()
    events = load(tmp_path / "run").table("events").to_pylist()
    about = {row["kind"]: row for row in events if row["about"] == "op/a1"}
    ended = json.loads(about["event.autopilot_lost"]["data"])["ended"]
    assert ended.startswith(("signal", "exit"))
    assert "event.engine_dead" in about
    assert "event.crash" in about
    done = {row["about"] for row in events if row["kind"] == "event.outcome" and '"complete"' in row["data"]}
    assert done == {"op/a2", "op/b1"}


def test_one_that_falls_silent_is_named_and_the_record_stays(tmp_path: Path, before: set[int]) -> None:
    run = Run.start(scenario(autopilots={"deadline_s": 0.5}), tmp_path / "run")
    run.advance(5.0)
    killed(run, before, signal.SIGSTOP)
    began = time.monotonic()
    with pytest.raises(ComponentError, match=r"op/a1 \(silent\)"):
        run.execute()
    assert time.monotonic() - began < 10.0
    record = load(tmp_path / "run")
    assert record.manifest["status"] == "failed"
    assert "event.autopilot_lost" in record.table("events").column("kind").to_pylist()


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_none_outlives_skyrange(tmp_path: Path, before: set[int], how: signal.Signals) -> None:
    code = (
        "from pathlib import Path\n"
        "from tests.integration.test_ardupilot_flight import scenario\n"
        "from skyrange.runtime.run import Run\n"
        f"Run.start(scenario(3000.0), Path({str(tmp_path / 'run')!r})).execute()\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 90.0
    while len(programs() - before) < 2 and time.monotonic() < deadline:
        time.sleep(0.05)
    time.sleep(0.5)
    assert len(programs() - before) == 2
    process.send_signal(how)
    process.wait(30.0)
    deadline = time.monotonic() + 10.0
    while programs() - before and time.monotonic() < deadline:
        time.sleep(0.05)


def test_a_parameter_that_no_firmware_has_is_named_before_anything_starts(tmp_path: Path, before: set[int]) -> None:
    wrong = scenario()
    fleet = wrong.operators[0].vehicles
    fleet[0].params.update({"WPNAV_SPED": 500.0, "GPS1_TYPE": 1.0})
    with pytest.raises(InputError) as caught:
        Run.start(wrong, tmp_path / "run")
    told = str(caught.value)
    assert "WPNAV_SPED" in told
    assert "WPNAV_SPEED" in told
    assert "GPS1_TYPE" in told
    assert not (tmp_path / "run").exists()


def test_a_parameter_that_the_firmware_does_not_take_is_named_before_anything_starts(
    tmp_path: Path, before: set[int]
) -> None:
    wrong = scenario()
    fleet = wrong.operators[0].vehicles
    fleet[1].params.update({"FS_GCS_ENABLE": 300.0, "FS_OPTIONS": 1.5, "ATC_ANG_RLL_P": 4.75})
    with pytest.raises(InputError) as caught:
        Run.start(wrong, tmp_path / "run")
    told = {fault.where: fault for fault in caught.value.problems}
    assert told.keys() == {"op/a2.params.FS_GCS_ENABLE", "op/a2.params.FS_OPTIONS"}
    assert told["op/a2.params.FS_OPTIONS"].value == "1.5"
    assert "changed this one to 1" in told["op/a2.params.FS_OPTIONS"].expected
    assert not (tmp_path / "run").exists()


def test_dataflash_logs_are_kept_where_asked(tmp_path: Path, before: set[int]) -> None:
    run = Run.start(scenario(autopilots={"options": {"ardupilot": {"keep_logs": True}}}), tmp_path / "run")
    run.advance(12.0)
    run.finish()
    logs = sorted(path.name for path in (tmp_path / "run" / "dataflash").iterdir())
    assert logs == ["op-a1.bin", "op-a2.bin"]
    assert (tmp_path / "run" / "dataflash" / "op-a1.bin").read_bytes()[:2] == b"\xa3\x95"


@pytest.mark.slow
def test_a_low_battery_leads_to_the_same_failsafe_or_to_a_warning(tmp_path: Path) -> None:
    """By the build: it takes the world's battery, or the scenario is said to have no battery failsafe under it."""
    low = {"BATT_LOW_VOLT": 12.3, "BATT_LOW_TIMER": 2.0, "BATT_FS_LOW_ACT": 2.0}
    made = scenario(45.0)
    fleet = [one.model_copy(update={"params": {**one.params, **low}}) for one in made.operators[0].vehicles[1:]]
    operator = made.operators[0].model_copy(update={"vehicles": tuple(fleet)})
    Run.start(made.model_copy(update={"operators": (operator,)}), tmp_path / "run").execute()
    record = load(tmp_path / "run")
    events = record.table("events").to_pylist()
    modes = [row for row in events if row["kind"] == "event.mode"]
    failsafes = {row["about"] for row in modes if json.loads(row["data"]).get("reason") == "battery_failsafe"}
    warnings = record.manifest.get("warnings", [])
    assert "op/b1" in failsafes
    assert ("op/a2" in failsafes) is not any(line.startswith("op/a2: BATT_LOW_VOLT = 12.3") for line in warnings)
