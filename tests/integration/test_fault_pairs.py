"""A benign fault beside an attack: which of them caused what, and is the fault never called an attack?"""

from __future__ import annotations

from pathlib import Path

import pytest

from skyrange.scenario.toml_files import load_text
from skyrange.study.pairing import pair
from skyrange.twins.pair_folder import Pair

pytestmark = pytest.mark.rotating

FLEET = """
name = "both"
seed = 3
duration_s = 18
origin = [47.3977, 8.5456]

[[operators]]
id = "blue"
vehicles = [
  { id = "b1", plan = { path = { points = [[0, 80]], alt_m = 10 }, speed_mps = 4 } },
  { id = "b2", start = [400, 0], plan = { path = { points = [[0, 80]], alt_m = 10 }, speed_mps = 4 } },
]
"""
DRIFT = """
[[attacks]]
id = "drift"
kind = "gnss.drift"
start_s = 12
params = { vehicles = ["blue/b1"], rate_mps = [2, 0, 0] }
"""
MISTAKE = """
[[faults]]
id = "mistake"
kind = "operator.error"
start_s = 12
for_s = 3
params = { vehicles = ["blue/b2"], command = "return" }
"""


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> Pair:
    return pair(load_text(FLEET + DRIFT + MISTAKE), tmp_path_factory.mktemp("both") / "pair", jobs=1)


def test_attack_and_fault_are_told_apart(both: Pair) -> None:
    assert both.arms == ["nominal", "attacked", "only-drift", "only-mistake"]
    assert both.faults == ["mistake"]
    assert both.manifest["attacks"] == {"drift": "mute"}
    rows = both.attribution.to_pylist()
    found = {(r["vehicle"], r["attack"], r["fault"]): r["relation"] for r in rows if r["outcome"] == "departure"}
    assert found == {
        ("blue/b1", "drift", False): "both",
        ("blue/b1", "mistake", True): "none",
        ("blue/b2", "drift", False): "none",
        ("blue/b2", "mistake", True): "both",
    }
    effects = {row["vehicle"]: row for row in both.effects.to_pylist() if row["against"] == both.reference}
    assert (effects["blue/b1"]["attacks"], effects["blue/b1"]["faults"]) == (["drift"], [])
    assert (effects["blue/b2"]["attacks"], effects["blue/b2"]["faults"]) == ([], ["mistake"])


def test_the_record_leads_from_the_fault_to_its_effect(both: Pair) -> None:
    rows = [row for row in both.propagation.to_pylist() if row["attack"] == "mistake"]
    assert {row["fault"] for row in rows} == {True}
    (effect,) = (row for row in rows if row["phase"] == "effect")
    assert (effect["vehicle"], effect["path"]) == ("blue/b2", True)
    assert not any(row["fault"] for row in both.propagation.to_pylist() if row["attack"] == "drift")


def test_labels_and_events_say_what_is_a_fault(both: Pair) -> None:
    def said(arm: str) -> set[tuple[str, bool, bool]]:
        labels = both.run(arm).table("labels").to_pylist()
        return {(row["attack"], row["fault"], row["benign"]) for row in labels}

    assert said("attacked") == {("drift", False, False), ("mistake", True, False)}
    assert said("only-drift") == {("drift", False, False)}, "the counterfactual of a fault is to mute it"
    assert said("only-mistake") == {("mistake", True, False)}
    assert said("nominal") == set()
    events = both.run("attacked").table("events").to_pylist()
    begun = {(row["kind"], row["about"]) for row in events if row["source"] == "kernel"}
    assert begun >= {
        ("event.attack_start", "drift"),
        ("event.fault_start", "mistake"),
        ("event.fault_stop", "mistake"),
    }
    assert ("event.attack_start", "mistake") not in begun
    manifest = both.run("attacked").manifest
    assert [row["id"] for row in manifest["attacks"]] == ["drift"]
    assert [row["id"] for row in manifest["faults"]] == ["mistake"]


def test_the_pages_say_fault(both: Pair) -> None:
    page = both.report.read_text(encoding="utf-8")
    attacks = page[page.index('id="attacks"') : page.index('id="faults"')]
    faults = page[page.index('id="faults"') : page.index('id="paths"')]
    assert "drift" in attacks
    assert "mistake" not in attacks
    assert "operator.error" in faults
    assert "mistake (fault)" in page[page.index('id="attribution"') : page.index('id="effects"')]
    report = (both.path / "attacked" / "report.html").read_text(encoding="utf-8")
    assert "act of a fault" in report


def test_a_scenario_with_a_fault_alone_is_paired(tmp_path: Path) -> None:
    made = pair(load_text(FLEET + MISTAKE), tmp_path / "pair", jobs=1)
    assert made.arms == ["nominal", "attacked"]
    assert made.manifest["attacks"] == {}
    (row,) = (row for row in made.effects.to_pylist() if row["departed_s"] is not None)
    assert (row["vehicle"], row["attacks"], row["faults"], row["attribution"]) == ("blue/b2", [], ["mistake"], "both")
