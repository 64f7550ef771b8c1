"""Which attack caused an effect: two attacks at once, of which one is heard and changes nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from skyrange.scenario.toml_files import load_text
from skyrange.study.pairing import pair
from skyrange.twins.pair_folder import Pair

pytestmark = pytest.mark.rotating

FLEET = """
name = "two"
seed = 3
duration_s = 18
origin = [47.3977, 8.5456]

[radio]

[[operators]]
id = "blue"
avoidance = "geometric"
vehicles = [
  { id = "b1", plan = { path = { points = [[0, 80]], alt_m = 10 }, speed_mps = 4 } },
  { id = "b2", start = [400, 0], plan = { path = { points = [[0, 80]], alt_m = 10 }, speed_mps = 4 } },
]
"""
GHOST = """
[[attacks]]
id = "ghost"
kind = "remote_id.spoof"
start_s = 8
params = { form = "ghost", at = [300, 300, 10], transmitter_m = [0, 20, 2] }
"""


def drift(name: str, start_s: float) -> str:
    return f"""
[[attacks]]
id = "{name}"
kind = "gnss.drift"
start_s = {start_s}
params = {{ vehicles = ["blue/b1"], rate_mps = [2, 0, 0] }}
"""


def landing(name: str) -> str:
    """An attack that orders b1 to land at 12 s."""
    return f"""
[[attacks]]
id = "{name}"
kind = "mavlink.mode"
start_s = 12
params = {{ vehicles = ["blue/b1"], mode = "LAND" }}
"""


def relations(made: Pair, outcome: str = "departure") -> dict[tuple[str, str], str]:
    rows = made.attribution.to_pylist()
    return {(row["vehicle"], row["attack"]): row["relation"] for row in rows if row["outcome"] == outcome}


@pytest.fixture(scope="module")
def heard(tmp_path_factory: pytest.TempPathFactory) -> Pair:
    folder = tmp_path_factory.mktemp("heard") / "pair"
    return pair(load_text(FLEET + GHOST + drift("drift", 12.0)), folder, jobs=1, run_reports=False)


def test_an_attack_that_was_only_heard_is_not_the_cause(heard: Pair) -> None:
    assert heard.arms == ["nominal", "attacked", "sham", "only-drift", "only-ghost"]
    received = [
        row for row in heard.propagation.to_pylist() if row["attack"] == "ghost" and row["vehicle"] == "blue/b1"
    ]
    assert any(row["kind"] == "frame" for row in received), "the aircraft received the ghost"
    assert relations(heard) == {("blue/b1", "drift"): "both", ("blue/b1", "ghost"): "none"}
    effects = {(row["against"], row["vehicle"]): row for row in heard.effects.to_pylist()}
    for against in heard.twins:
        one = effects[against, "blue/b1"]
        assert (one["attacks"], one["attribution"]) == (["drift"], "both")
        assert one["departed_s"] > 12.0
        other = effects[against, "blue/b2"]
        assert (other["attacks"], other["attribution"]) == ([], None)


def test_the_effect_has_a_path_from_its_cause(heard: Pair) -> None:
    (effect,) = (row for row in heard.propagation.to_pylist() if row["phase"] == "effect")
    assert (effect["vehicle"], effect["attack"], effect["relation"], effect["path"]) == (
        "blue/b1",
        "drift",
        "both",
        True,
    )
    assert effect["origin"].startswith("gnss:blue/b1|")


def test_the_departure_is_that_of_the_run_with_the_cause_alone(heard: Pair) -> None:
    alone = heard.run("only-drift").table("truth").to_pylist()
    attacked = heard.run("attacked").table("truth").to_pylist()
    assert [row for row in alone if row["vehicle"] == "blue/b1"] == [
        row for row in attacked if row["vehicle"] == "blue/b1"
    ]


def test_the_page_names_the_cause(heard: Pair) -> None:
    page = heard.report.read_text(encoding="utf-8")
    section = page[page.index('id="attribution"') : page.index('id="effects"')]
    for words in ("departure", "drift", "ghost", "both", "none", "these runs repeat to the byte"):
        assert words in section


def test_shams_are_marked_in_the_table_of_labels(heard: Pair) -> None:
    def marks(arm: str) -> set[Any]:
        return {(row["attack"], row["benign"]) for row in heard.run(arm).table("labels").to_pylist()}

    assert marks("attacked") == {("ghost", False), ("drift", False)}
    assert marks("sham") == {("ghost", True)}, "a false fix has no load, so that its counterfactual is muted"
    assert marks("only-drift") == {("ghost", True), ("drift", False)}
    assert marks("nominal") == set()


@pytest.mark.slow
def test_either_of_two_equal_attacks_suffices(tmp_path: Path) -> None:
    made = pair(
        load_text(FLEET + landing("one") + landing("two"), overrides=["duration_s=15"]),
        tmp_path / "pair",
        jobs=1,
        run_reports=False,
    )
    assert relations(made) == {("blue/b1", "one"): "redundant", ("blue/b1", "two"): "redundant"}


def test_without_the_counterfactual_runs_nothing_is_attributed(tmp_path: Path) -> None:
    made = pair(load_text(FLEET + landing("land")), tmp_path / "pair", arms="nominal", jobs=1, run_reports=False)
    assert made.arms == ["nominal", "attacked"]
    assert made.baseline is None
    assert relations(made) == {("blue/b1", "land"): "unknown"}
    assert "so no effect is attributed" in made.report.read_text(encoding="utf-8")
