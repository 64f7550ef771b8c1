"""A radio engine that dies in a live range is replaced, done without, or ends the range, as `on_death` says."""

from __future__ import annotations

import io
import json
import os
import signal
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from skyrange.assembly.build import build
from skyrange.cli.output.live_table import make_table
from skyrange.contracts.components import InstanceStatus
from skyrange.contracts.medium import ProgramStatus
from skyrange.core.errors import ComponentError, InputError
from skyrange.core.time import NS_PER_S
from skyrange.radio.external.ns3 import VARIABLE
from skyrange.record import RunRecord, load
from skyrange.runtime.live.deployment import LOOPBACK
from skyrange.runtime.live.node import process
from skyrange.runtime.live.range import SupervisedNode
from skyrange.runtime.warm_up import with_builtin_medium
from tests.integration.live_virtual import VirtualFlight, fly_virtual, prepared, scenario_of
from tests.integration.radio_program import SCENARIO, write_program

HIT_S = 2.0


@pytest.fixture(autouse=True)
def engine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, str(write_program(tmp_path)))


def _programs(flight: VirtualFlight) -> list[dict[str, Any]]:
    return list(flight.range.members["world"].status.get("programs", ()))


def _flown(folder: Path, on_death: str, sign: signal.Signals, times: int = 1) -> tuple[RunRecord, list[int]]:
    """A range whose engine gets a signal, `times` times; the process ids that it had."""
    flight = prepared(SCENARIO.format(seconds=9, on_death=on_death), folder)
    found: list[int] = []

    async def hurt(flight: VirtualFlight) -> None:
        for number in range(times):
            await flight.reach(HIT_S + number)
            (program,) = _programs(flight)
            assert program["state"] == "ready"
            found.append(program["pid"])
            os.kill(program["pid"], sign)
        await flight.reach(HIT_S + times + 1)
        found.append(_programs(flight)[0]["pid"])

    return fly_virtual(flight, hurt), found


def _heard_s(record: RunRecord) -> list[float]:
    return sorted(at / NS_PER_S for at in record.table("receptions", ["time_ns"]).column("time_ns").to_pylist())


def _told(record: RunRecord) -> list[tuple[str, dict[str, Any]]]:
    rows = record.table("events").to_pylist()
    return [(row["kind"], json.loads(row["data"])) for row in rows if row["about"] == "radio engine ns3"]


def _gone(pid: int) -> bool:
    return not Path(f"/proc/{pid}").exists()


@pytest.mark.slow
@pytest.mark.parametrize("sign", [signal.SIGKILL, pytest.param(signal.SIGSTOP, marks=pytest.mark.slow)])
def test_it_is_started_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sign: signal.Signals) -> None:
    if sign == signal.SIGSTOP:
        monkeypatch.setattr(process, "ENGINE_DEADLINE_S", 2.0)
    record, (first, second) = _flown(tmp_path, "restart", sign)
    assert first != second
    assert _gone(first)
    assert _gone(second)
    why = "ended (signal SIGKILL)" if sign == signal.SIGKILL else "did not answer for 2 s"
    (dead, lost), (ready, _) = _told(record)
    assert (dead, ready) == ("event.engine_dead", "event.engine_ready")
    assert why in lost["why"]
    assert lost["lost"] == 1  # the frame with which the death was noticed
    told = record.manifest["live"]["programs"]["radio engine ns3"]
    assert (told["node"], told["state"], len(told["ended"])) == ("world", "ready", 1)
    heard = _heard_s(record)
    assert min(heard) < HIT_S
    assert max(heard) > 8.0
    assert record.status == "complete"


@pytest.mark.slow
def test_it_is_started_three_times_at_most(tmp_path: Path) -> None:
    record, pids = _flown(tmp_path, "restart", signal.SIGKILL, times=4)
    assert len(set(pids)) == 4
    told = record.manifest["live"]["programs"]["radio engine ns3"]
    assert (told["state"], len(told["ended"])) == ("dead", 4)
    assert HIT_S + 2 < max(_heard_s(record)) < HIT_S + 4
    assert record.status == "complete"


@pytest.mark.slow
def test_the_range_goes_on_without_it(tmp_path: Path) -> None:
    record, (pid, same) = _flown(tmp_path, "continue", signal.SIGKILL)
    assert pid == same
    assert [kind for kind, _ in _told(record)] == ["event.engine_dead"]
    assert record.manifest["live"]["programs"]["radio engine ns3"]["state"] == "dead"
    heard = _heard_s(record)
    assert min(heard) < max(heard) < HIT_S + 1.0
    assert record.status == "complete"


@pytest.mark.rotating
def test_the_range_ends_and_names_it(tmp_path: Path) -> None:
    with pytest.raises(ComponentError, match=r"radio engine ns3: ended \(signal SIGKILL\)") as caught:
        _flown(tmp_path, "stop", signal.SIGKILL)
    assert caught.value.exit_code == 3
    record = load(tmp_path / "run")
    assert record.status == "failed"
    assert min(_heard_s(record)) < HIT_S


def test_the_table_of_nodes_shows_it(tmp_path: Path) -> None:
    flown = prepared(SCENARIO.format(seconds=20, on_death="restart"), tmp_path).range
    program = ProgramStatus("radio engine ns3", 4711, InstanceStatus.READY, ("ended (signal SIGKILL)",))
    flown.members["world"] = SupervisedNode("world", LOOPBACK, "flying", status={"programs": [program._asdict()]})
    console = Console(width=120, record=True, file=io.StringIO())
    console.print(make_table(flown))
    (row,) = [line for line in console.export_text().splitlines() if "radio engine ns3" in line]
    assert "pid 4711" in row
    assert "ready, 1 ended" in row


def test_processes_without_the_oracle_need_no_engine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = scenario_of(SCENARIO.format(seconds=20, on_death="stop"))
    monkeypatch.setenv(VARIABLE, str(tmp_path / "nowhere"))
    with pytest.raises(InputError, match="nowhere"):
        build(scenario)
    assert build(scenario, local={"blue.gcs"}).oracle is None
    flown = build(with_builtin_medium(scenario))  # what such a process compiles with
    assert flown.oracle is not None
    assert not flown.oracle.medium.runs_programs


def test_a_range_without_an_engine_does_not_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, str(tmp_path / "nowhere"))
    with pytest.raises(InputError, match="an executable file"):
        prepared(SCENARIO.format(seconds=20, on_death="stop"), tmp_path)
    assert not (tmp_path / "run").exists()


def test_an_engine_that_does_not_start_is_named_before_anything_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = tmp_path / "broken"
    broken.write_text("#!/bin/sh\necho cannot find libns3 >&2\nexit 4\n")
    broken.chmod(0o755)
    monkeypatch.setenv(VARIABLE, str(broken))
    with pytest.raises(ComponentError, match="cannot find libns3"):
        prepared(SCENARIO.format(seconds=20, on_death="restart"), tmp_path)
    assert not (tmp_path / "run").exists()
