"""Arms of a comparison, limits by placebos, and the rows of attribution."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from skyrange.attack.contract import Counterfactual
from skyrange.cli.options import Arms
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_S
from skyrange.record import Recorder, load
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.toml_files import load_text
from skyrange.twins.arms import SELECTIONS, Arm, acting_attacks, baseline_of, plan_arms, scenario_of
from skyrange.twins.attribution import (
    Authors,
    Comparison,
    attribution_table,
    authors,
    relate,
    summarise,
    unknown_subsets,
    with_authors,
)
from skyrange.twins.effects import NAMES, PLACEBO_LEVEL, ArmOutcomes, Limits, floors, limits

SCENARIO = """
name = "two"
origin = [47.3977, 8.5456]
duration_s = 20
[radio]
[[operators]]
id = "blue"
  [[operators.vehicles]]
  plan = { square = { side_m = 20, alt_m = 15 } }
[[attacks]]
id = "noise"
kind = "remote_id.jam"
params = { transmitter_m = [0, 0, 2] }
[[attacks]]
id = "ghost"
kind = "remote_id.spoof"
params = { at = [100, 0, 10] }
[[attacks]]
id = "off"
kind = "gnss.jump"
muted = true
params = { vehicles = ["blue/1"], offset_m = [10, 0, 0] }
"""


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_text(SCENARIO)


def states(scenario: Scenario) -> dict[str, str]:
    return {one.id: "muted" if one.muted else "sham" if one.sham else "active" for one in scenario.attacks}


def test_each_attack_has_its_own_counterfactual(scenario: Scenario) -> None:
    attacks = acting_attacks(scenario)
    assert attacks == {"noise": "mute", "ghost": "sham"}
    arms = plan_arms(attacks)
    assert [arm.name for arm in arms] == ["nominal", "attacked", "sham", "only-ghost", "only-noise"]
    assert baseline_of(attacks, arms) == "sham"
    found = {arm.name: states(scenario_of(scenario, arm, 3)) for arm in arms}
    assert found == {
        "nominal": {"noise": "muted", "ghost": "muted", "off": "muted"},
        "attacked": {"noise": "active", "ghost": "active", "off": "muted"},
        "sham": {"noise": "muted", "ghost": "sham", "off": "muted"},
        "only-ghost": {"noise": "muted", "ghost": "active", "off": "muted"},
        "only-noise": {"noise": "active", "ghost": "sham", "off": "muted"},
    }
    assert scenario_of(scenario, arms[0], 3).seed == 3


@pytest.mark.parametrize(
    ("count", "selection", "arms", "unknown"),
    [(1, None, 3, 0), (3, None, 9, 0), (4, None, 17, 0), (5, None, 13, 20), (5, "subsets", 33, 0), (2, "each", 5, 0),
     (3, "nominal", 2, 6), (3, "sham", 3, 6), (3, "baseline", 2, 6)],
)  # fmt: skip
def test_the_number_of_runs(count: int, selection: str | None, arms: int, unknown: int) -> None:
    planned = plan_arms(dict.fromkeys("abcdefg"[:count], "sham"), selection)  # type: ignore[arg-type]
    assert len(planned) == len({arm.name for arm in planned}) == arms
    assert unknown_subsets({arm.name: sorted(arm.active) for arm in planned}) == unknown


@pytest.mark.parametrize(("state", "baseline"), [("sham", "sham"), ("mute", "nominal")])
def test_the_baseline_may_be_the_only_other_arm(state: Counterfactual, baseline: str) -> None:
    planned = plan_arms({"one": state}, "baseline")
    assert planned == [Arm(baseline), Arm("attacked", frozenset({"one"}))]
    assert baseline_of({"one": state}, planned) == baseline


def test_a_sham_that_equals_the_nominal_run_is_not_run() -> None:
    planned = plan_arms({"noise": "mute"})
    assert planned == [Arm("nominal"), Arm("attacked", frozenset({"noise"}))]
    assert baseline_of({"noise": "mute"}, planned) == "nominal"
    assert baseline_of({"ghost": "sham"}, planned) is None
    with pytest.raises(InputError, match="expected one of baseline, nominal, sham, each, subsets"):
        plan_arms({}, "all")  # type: ignore[arg-type]


def test_an_effect_is_beyond_what_placebos_do() -> None:
    floor = {"departure": np.array([1.0, 1.0]), "delay": np.zeros(2)}
    placebos = [
        {"departure": np.array([0.0, 0.4]), "delay": np.array([np.nan, 0.0])},
        {"departure": np.array([6.0, 0.2]), "delay": np.array([2.0, 0.0])},
    ]
    found = limits(placebos, floor, repeats=False)
    assert found.of["departure"].tolist() == [6.0, 1.0]
    assert found.of["delay"].tolist() == [2.0, 0.0]
    assert found.placebos["delay"].tolist() == [1, 2], "a placebo without the outcome is none, and not a zero"
    assert found.levels["delay"].tolist() == pytest.approx([1 / 2, 1 / 3])
    none = limits([], floor, repeats=False)
    assert (none.of["departure"].tolist(), none.levels["departure"].tolist()) == ([1.0, 1.0], [1.0, 1.0])
    exact = limits(placebos, floor, repeats=True)
    assert exact.levels["departure"].tolist() == pytest.approx([1 / 3, 0.0]), "a sham that moves it counts all the same"
    assert limits([], floor, repeats=True).levels["delay"].tolist() == [0.0, 0.0]


@pytest.mark.parametrize("replicates", [500, pytest.param(20_000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("count", [1, 5, 19])
def test_without_an_effect_a_limit_is_exceeded_as_often_as_it_says(count: int, replicates: int) -> None:
    chance = np.random.default_rng(1)
    floor = {"departure": np.zeros(1)}
    exceeded = shown = 0
    for _ in range(replicates):
        draws = chance.lognormal(0.0, 2.0, count + 1)
        found = limits([{"departure": draws[k : k + 1]} for k in range(count)], floor, repeats=False)
        assert found.levels["departure"][0] == pytest.approx(1.0 / (count + 1))
        exceeded += draws[-1] > found.of["departure"][0]
        shown += draws[-1] > found.of["departure"][0] and found.levels["departure"][0] <= PLACEBO_LEVEL
    level = 1.0 / (count + 1)
    assert exceeded / replicates == pytest.approx(level, abs=3.3 * (level * (1 - level) / replicates) ** 0.5)
    assert shown / replicates <= PLACEBO_LEVEL + 3.3 * (0.0475 / replicates) ** 0.5


def bounds(level: float = 0.0, placebos: int = 0, **given: float) -> Limits:
    of = distances(**given)
    return Limits(of, {name: np.full(1, placebos) for name in of}, {name: np.full(1, level) for name in of})


def test_with_too_few_placebos_nobody_is_named() -> None:
    away, departed = {A: distances(departure=9.0)}, {A: [4_000_000_000]}
    rows = relate(Comparison(1, ["blue/1"], away, departed, bounds(0.5, 1, departure=1.0)), has_baseline=True)
    assert [(row["relation"], row["shown"], row["placebos"], row["level"]) for row in rows] == [
        ("unknown", False, 1, 0.5)
    ]
    assert authors(rows) == {(1, "blue/1"): Authors((), "not enough placebos")}
    enough = relate(Comparison(1, ["blue/1"], away, departed, bounds(0.05, 19, departure=1.0)), has_baseline=True)
    assert [(row["relation"], row["shown"]) for row in enough] == [("both", True)]


def distances(**given: float) -> dict[str, np.ndarray]:
    return {name: np.array([given.get(name, 0.0)]) for name in NAMES}


A, B, AB = frozenset("a"), frozenset("b"), frozenset("ab")


def test_what_departs_at_the_same_second_without_an_attack_is_not_its_doing() -> None:
    away = {AB: distances(departure=30.0, mission=1.0), A: distances(departure=30.0), B: distances(departure=0.5)}
    departed: dict[frozenset[str], Sequence[int | None]] = {AB: [7_000_000_000], A: [7_000_000_000], B: [None]}
    rows = relate(Comparison(1, ["blue/1"], away, departed, bounds(departure=1.0)), has_baseline=True)
    said = [(row["outcome"], row["attack"], row["relation"], row["shift"], row["shift_s"]) for row in rows]
    assert said == [
        ("departure", "a", "both", None, None),
        ("departure", "b", "none", None, 0.0),
        ("mission", "a", "joint", None, None),
        ("mission", "b", "joint", None, None),
    ]
    assert [(row["alone"], row["without"], row["departed_s"]) for row in rows[:2]] == [
        (30.0, 0.5, 7.0),
        (0.5, 30.0, 7.0),
    ]
    assert attribution_table(rows).num_rows == 4
    named = authors(rows)
    assert named == {(1, "blue/1"): Authors(("a",), "both")}
    row = {"seed": 1, "vehicle": "blue/1", "departed_s": 7.0}
    assert with_authors(row, named) == row | {"attacks": ["a"], "faults": [], "attribution": "both"}
    assert with_authors(row, named, ["a"]) == row | {"attacks": [], "faults": ["a"], "attribution": "both"}
    nobody = {"seed": 2, "attacks": [], "faults": [], "attribution": "none"}
    assert with_authors(row | {"seed": 2}, named) == row | nobody
    assert with_authors(row | {"seed": 2, "departed_s": None}, named)["attribution"] is None


def test_an_attack_that_only_shifts_an_effect_says_by_how_much() -> None:
    away = {AB: distances(departure=9.0), A: distances(departure=9.0), B: distances(departure=8.0)}
    departed = {AB: [4_000_000_000], A: [6_000_000_000], B: [3_000_000_000]}
    rows = relate(Comparison(1, ["blue/1"], away, departed, bounds(departure=1.0)), has_baseline=True)
    assert [(row["relation"], row["shift"], row["shift_s"]) for row in rows] == [
        ("redundant", "delayed", 1.0),
        ("redundant", "advanced", -2.0),
    ]


def test_without_a_baseline_nothing_is_attributed() -> None:
    rows = relate(
        Comparison(1, ["blue/1"], {A: distances(departure=9.0)}, {A: [1]}, bounds(departure=1.0)), has_baseline=False
    )
    assert [row["relation"] for row in rows] == ["unknown"]
    assert authors(rows) == {(1, "blue/1"): Authors((), "unknown")}


def test_differences_that_are_not_known_are_no_effects() -> None:
    away = {A: distances(delay=float("nan"))}
    assert relate(Comparison(1, ["blue/1"], away, {A: [None]}, bounds()), has_baseline=True) == []


def test_one_word_for_several_attacks() -> None:
    assert summarise({"a": "none", "b": "none"}) == Authors((), "none")
    assert summarise({"a": "unknown", "b": "necessary"}) == Authors(("b",), "necessary")
    assert summarise({"a": "redundant", "b": "redundant"}) == Authors(("a", "b"), "redundant")
    assert summarise({"a": "necessary", "b": "redundant", "c": "redundant"}) == Authors(("a", "b", "c"), "joint")


def test_the_delay_that_counts_is_the_period_of_the_truth(tmp_path: Path) -> None:
    recorder = Recorder.open(
        tmp_path / "run", {"vehicles": [{"id": "a/1", "operator": "a"}]}, truth_hz=0.25, sensors_hz=0.0
    )
    for tick in range(3):
        columns = {"east_m": np.zeros(1), "north_m": np.zeros(1), "up_m": np.zeros(1)}
        world: Any = SimpleNamespace(
            vehicles=["a/1"], sources=["dynamic"], present=None, truth=lambda columns=columns: columns, sensors=None
        )
        recorder.on_truth(tick * 4 * NS_PER_S, world)
    recorder.close()
    found = floors(ArmOutcomes.read(load(tmp_path / "run"), 10.0), threshold_m=2.0)
    assert {name: values.tolist() for name, values in found.items()} == {
        "departure": [2.0], "delay": [4.0], "separation": [2.0], "mission": [0.0], "mishaps": [0.0], "energy": [0.0],
        "decisions": [0.0],
    }  # fmt: skip


def test_the_command_line_offers_every_selection() -> None:
    assert [choice.value for choice in Arms] == list(SELECTIONS)
