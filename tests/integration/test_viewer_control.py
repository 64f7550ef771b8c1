"""A run that another thread controls: acts, pause and speed, and the same run again from its schedule."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from skyrange.core.errors import InputError, ShortfallError
from skyrange.metrics.exact_difference import diff
from skyrange.record import RunRecord
from skyrange.record import load as load_record
from skyrange.runtime.run import Run
from skyrange.scenario.shipped import load
from skyrange.scenario.toml_files import load_file
from skyrange.study.runs import fly
from skyrange.view.control import Command, RunControl

WAIT_S = 30.0


def controlled(folder: Path, person: Callable[[RunControl], None], **more: Any) -> RunRecord:
    """A short run at ten times real time, which `person` controls from a thread of its own."""
    control, failures = RunControl(), list[BaseException]()

    def play() -> None:
        try:
            await_state(control, lambda state: state["now_s"] > 0.0)
            person(control)
        except BaseException as error:
            failures.append(error)
            raise

    thread = threading.Thread(target=play)
    thread.start()
    scenario = load("gnss.jump", ["duration_s=8", "attacks.*.start_s=0", "attacks.*.manual=true"])
    record = fly(
        scenario, folder, speed=10.0, on_start=control.start, on_progress=control.between(None), report=False, **more
    )
    control.finish()
    thread.join(WAIT_S)
    assert not failures
    return record


def await_state(control: RunControl, holds: Callable[[Any], bool]) -> Any:
    until = time.monotonic() + WAIT_S
    while not holds(state := control.state):
        assert time.monotonic() < until, state
        time.sleep(0.005)
    return state


def obeyed(control: RunControl, do: Any, **more: Any) -> Any:
    return control.submit(Command(do, **more)).result(WAIT_S)


def test_what_a_person_does_is_recorded_and_is_the_same_again(tmp_path: Path) -> None:
    told: list[Any] = []

    def person(control: RunControl) -> None:
        (act,) = (act for act in control.state["acts"] if act["role"] == "attack")
        assert (act["kind"], act["manual"], act["status"], act["start_s"]) == ("gnss.jump", True, "waiting", None)
        await_state(control, lambda state: state["now_s"] > 2.0)
        obeyed(control, "pause")
        before = control.state["now_s"]
        assert control.state["paused"]
        time.sleep(1.0)  # as long as 10 s of the run
        told.append(obeyed(control, "start", act=act["id"])["at_s"])
        assert before < told[0] <= before + 0.0101
        assert control.state["now_s"] == before
        for wrong in (Command("start", act=act["id"]), Command("stop", act="nobody"), Command("speed", speed=-1.0)):
            with pytest.raises(InputError):
                control.submit(wrong).result(WAIT_S)
        obeyed(control, "resume")
        obeyed(control, "speed", speed=20.0)
        assert control.state["speed"] == 20.0
        await_state(control, lambda state: state["now_s"] > 4.0)
        told.append(obeyed(control, "stop", act=act["id"])["at_s"])

    record = controlled(tmp_path / "hand", person)
    rows = record.manifest["manual_acts"]
    assert [(row["action"], row["at_s"], row["by"]) for row in rows] == [
        ("start", told[0], "viewer"),
        ("stop", told[1], "viewer"),
    ]
    labels = record.table("labels").to_pylist()
    assert labels
    assert all(told[0] <= row["at_ns"] * 1e-9 < told[1] for row in labels)
    assert record.manifest["timings"]["max_lag_s"] < 1.0  # the pause is no delay
    again = fly(load_file(record.path / "scenario.toml"), tmp_path / "again", report=False)
    assert again.manifest["digests"] == record.manifest["digests"]
    assert diff(record, again).same


def test_commands_after_the_end_are_refused(tmp_path: Path) -> None:
    control = RunControl()
    run = Run.start(load("gnss.jump", ["duration_s=0.2"]), tmp_path / "run")
    control.start(run)
    late = control.submit(Command("pause"))
    run.execute()
    control.finish()
    with pytest.raises(InputError, match="the run has ended"):
        late.result(0)
    with pytest.raises(InputError, match="the run has ended"):
        control.submit(Command("resume"))
    assert control.state["ended"]


def test_a_paused_run_is_interrupted(tmp_path: Path) -> None:
    run = Run.start(load("gnss.jump", ["duration_s=2"]), tmp_path / "run")
    calls = 0

    def step(now: int, end: int) -> None:
        nonlocal calls
        calls += 1
        run.pause()
        if calls == 5:
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(ShortfallError, match=r"interrupted at 0\.1 of 2\.0"):
        run.execute(on_progress=step)
    assert load_record(tmp_path / "run").status == "interrupted"
