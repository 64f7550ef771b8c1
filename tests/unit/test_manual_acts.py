"""Which starts and stops by hand are refused, of a scenario and of a run, and what the refusals say."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from skyrange.core.errors import InputError
from skyrange.record import load as load_record
from skyrange.runtime.run import Run
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.overrides import set_key
from skyrange.scenario.toml_files import load_file, load_text
from skyrange.study.pairing import pair
from skyrange.study.runs import fly
from skyrange.twins.arms import acting_attacks
from tests.cases import each_case

TEXT = """
name = "hands"
duration_s = 2.0
origin = [40.778, -73.955]
record = { level = "summary" }

[[operators]]
id = "blue"
  [[operators.vehicles]]
  id = "b1"
  plan = { path = { points = [[0, 20]], alt_m = 4 } }

[[attacks]]
id = "jump"
kind = "gnss.jump"
manual = true
params = { vehicles = ["blue/b1"], offset_m = [3, 0, 2] }

[[attacks]]
id = "drift"
kind = "gnss.drift"
manual = true
start_s = 0.5
stop_s = 1.5
params = { vehicles = ["blue/b1"], rate_mps = [1, 0, 0] }

[[attacks]]
id = "gap"
kind = "link.delay"
start_s = 1.0
params = { links = ["gcs:*"], delay_s = 0.1 }

[[attacks]]
id = "near"
kind = "link.drop"
when = { vehicle = "blue/b1", within_m = 1, of = [0, 20, 4] }
params = { links = ["gcs:*"], probability = 0.1 }

[[defences]]
id = "test"
kind = "gnss.innovation"
manual = true
"""


def load(*changes: str) -> Scenario:
    return load_text(TEXT, overrides=changes)


def at(at_s: float, act: str, action: str) -> dict[str, Any]:
    return {"at_s": at_s, "act": act, "action": action}


WRONG: list[tuple[list[dict[str, Any]], str]] = [
    ([at(1.0, "jmp", "start")], "Did you mean 'jump'"),
    ([at(1.0, "gap", "start")], "expected an act with manual = true"),
    ([at(1.0, "jump", "start"), at(1.2, "jump", "start")], "Declare jump twice"),
    ([at(0.4, "drift", "start")], "0.5 or more"),
    ([at(1.5, "drift", "start")], "less than 1.5"),
    ([at(1.0, "jump", "stop")], "Add its start"),
    ([at(1.0, "jump", "start"), at(1.0, "jump", "stop")], "more than 1, when jump starts"),
    ([at(1.0, "gap", "stop")], "more than 1, when gap starts"),
    ([at(-1.0, "jump", "start")], "at_s"),
    ([{**at(1.0, "jump", "start"), "by": "a\nb"}], "by"),
    ([{**at(1.0, "jump", "start"), "by": ""}], "by"),
    ([{**at(1.0, "jump", "begin")}], "start"),
]


@each_case("acts, text", WRONG)
def test_a_scenario_with_wrong_acts_by_hand_is_refused(acts: list[dict[str, Any]], text: str) -> None:
    with pytest.raises(InputError) as error:
        load(set_key("manual_acts", acts))
    assert text in str(error.value)


def test_an_act_starts_by_a_condition_or_by_hand() -> None:
    with pytest.raises(InputError, match="a condition starts it, or somebody does"):
        load("attacks.near.manual=true")


def test_what_is_loaded_at_the_start_does_not_start_by_hand(tmp_path: Path) -> None:
    plan = {
        "id": "plan",
        "kind": "ground.plan_file",
        "manual": True,
        "params": {"vehicles": ["blue/b1"], "offset_m": [5, 0, 0]},
    }
    data = load().data()
    data["attacks"].append(plan)
    with pytest.raises(InputError, match="a start by hand"):
        Run.start(load(set_key("attacks", data["attacks"])), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_acts_that_exclude_each_other_are_refused_while_both_would_act(tmp_path: Path) -> None:
    both = [at(0.6, "jump", "start"), at(0.7, "drift", "start")]
    with pytest.raises(InputError, match="GNSS fixes of blue/b1"):
        Run.start(load(set_key("manual_acts", both)), tmp_path / "both")
    one_by_one = [*both, at(0.7, "jump", "stop")]
    fly(load(set_key("manual_acts", one_by_one)), tmp_path / "one by one", report=False)


def refused(call: Callable[[], object], text: str) -> None:
    with pytest.raises(InputError) as error:
        call()
    assert text in str(error.value)


def test_what_a_run_refuses(tmp_path: Path) -> None:
    run = Run.start(load(), tmp_path / "run")
    acts = run.acts
    assert list(acts) == ["drift", "gap", "jump", "near", "test"]
    assert acts["gap"].window_s == (1.0, None)
    assert acts["jump"].window_s == (None, None)
    assert [acts[name].role for name in ("jump", "test")] == ["attack", "defence"]
    refused(lambda: acts["jmp"], "Did you mean 'jump'")
    refused(acts["gap"].start, "starts at 1 s — expected an act that is declared with manual = true")
    refused(acts["near"].start, "starts by its condition")
    refused(acts["jump"].stop, "has not started")
    refused(acts["drift"].start, "0.5 s or later")
    refused(lambda: acts["test"].start(by="two\nlines"), "by")
    assert acts["test"].start() == 0.0
    refused(acts["test"].start, "starts at 0 s — expected one request")
    run.advance(0.7)
    assert acts["test"].status == "acting"
    assert acts["jump"].start() == 0.71
    assert acts["jump"].status == "waiting"
    refused(acts["drift"].start, "GNSS fixes of blue/b1")
    refused(acts["jump"].stop, "has not started")
    run.advance(0.8)
    refused(acts["jump"].start, "Declare it twice")
    assert acts["jump"].stop() == 0.81
    assert acts["drift"].start() == 0.81  # the other ends then
    run.advance(1.6)
    refused(acts["drift"].stop, "ends at 1.5 s")
    assert {name: act.status for name, act in acts.items()} == {
        "drift": "ended", "gap": "acting", "jump": "ended", "near": "waiting", "test": "acting",
    }  # fmt: skip
    assert acts["gap"].stop() == 1.61
    run.advance(2.0)
    refused(acts["test"].stop, "the run ends at 2 s")
    run.finish()
    refused(acts["test"].stop, "the run ends at 2 s")
    again = fly(load_file(tmp_path / "run" / "scenario.toml"), tmp_path / "again", report=False)
    assert again.manifest["digests"] == load_record(tmp_path / "run").manifest["digests"]


def test_a_stop_after_one_without_effect_is_the_one_of_the_schedule(tmp_path: Path) -> None:
    """A condition may hold after the time at which the scenario plans to stop its act."""
    nearby = "attacks.near.when={ vehicle = 'blue/b1', within_m = 90, of = [0, 20, 4] }"
    scenario = load(nearby, "attacks.near.start_s=1.0", set_key("manual_acts", [at(1.1, "near", "stop")]))
    early = scenario.manual_acts[0].model_copy(update={"at_s": 0.5})  # as if its start were at 0 s
    run = Run.start(scenario.model_copy(update={"manual_acts": (early,)}), tmp_path / "run")
    run.advance(1.2)
    assert run.acts["near"].status == "acting"
    run.acts["near"].stop()
    run.advance(2.0)
    run.finish()
    assert [row["effective"] for row in load_record(run.recorder.path).manifest["manual_acts"]] == [False, True]
    (kept,) = load_file(tmp_path / "run" / "scenario.toml").manual_acts
    assert (kept.at_s, kept.by) == (1.21, "python")


def test_an_act_with_a_condition_may_start_at_any_time(tmp_path: Path) -> None:
    drift = load("attacks.jump.manual=false", "attacks.jump.for_s=0.2")
    jump = drift.attacks[0].model_copy(update={"when": drift.attacks[3].when, "start_s": 0.6})
    run = Run.start(drift.model_copy(update={"attacks": (jump, *drift.attacks[1:])}), tmp_path / "run")
    run.advance(0.7)
    refused(run.acts["drift"].start, "GNSS fixes of blue/b1")
    run.finish("interrupted")


def test_an_act_that_nobody_starts_is_no_attack_and_is_warned_of(tmp_path: Path) -> None:
    quiet = load("attacks.gap.muted=true", "attacks.near.muted=true", "attacks.drift.muted=true")
    record = fly(quiet, tmp_path / "run", report=False)
    (jump, test) = record.manifest["warnings"]
    assert jump == "attack jump did nothing: manual = true, and nobody has started it"
    assert test.startswith("defence test did nothing")
    with pytest.raises(InputError, match="waiting for a start by hand"):
        pair(quiet.model_copy(update={"record": type(quiet.record)()}), tmp_path / "pair")
    planned = load(set_key("manual_acts", [at(1.0, "jump", "start"), at(1.0, "test", "start")]))
    assert set(acting_attacks(planned)) == {"jump", "gap", "near"}


def test_a_stop_without_effect_is_in_the_manifest(tmp_path: Path) -> None:
    """Whether a condition has held when its act is stopped is known in flight."""
    record = fly(load(set_key("manual_acts", [at(1.0, "near", "stop")])), tmp_path / "run", report=False)
    assert [(row["act"], row["effective"]) for row in record.manifest["manual_acts"]] == [("near", False)]
