"""Are two attacks that alter the same refused if and only if the times in which they act overlap?"""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyrange.assembly.acts.conflicts import find_exclusions, window_of
from skyrange.assembly.build import build
from skyrange.attack.exclusive import Exclusive, common
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_S
from skyrange.scenario.model.attacks import AttackTable
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.toml_files import load_text

JUMP = {"vehicles": ["blue/b1"], "offset_m": [20, 0, 0]}
DURATION_S = 60
seconds = st.integers(0, DURATION_S + 10)
lengths = st.none() | st.integers(1, DURATION_S)


def table(name: str, start_s: int, lasts_s: int | None, for_s: int | None, waits: bool, muted: bool) -> AttackTable:
    values: dict[str, Any] = {"id": name, "kind": "gnss.jump", "start_s": start_s, "params": JUMP, "muted": muted}
    if lasts_s is not None:
        values["stop_s"] = start_s + lasts_s
    if for_s is not None:
        values["for_s"] = for_s
    if waits:
        values["when"] = {"vehicle": "blue/b1", "within_m": 5, "of": [0, 0, 10]}
    return AttackTable.model_validate(values)


tables = st.builds(lambda *values: values, seconds, lengths, lengths, st.booleans(), st.booleans())


def may_act(start_s: int, lasts_s: int | None, for_s: int | None, waits: bool, muted: bool) -> set[int]:
    """The seconds in which an attack may act, counted one by one."""
    found = set()
    for second in range(DURATION_S):
        begun = second >= start_s
        stopped = lasts_s is not None and second >= start_s + lasts_s
        spent = for_s is not None and not waits and second >= start_s + for_s
        if begun and not stopped and not spent and not muted:
            found.add(second)
    return found


@given(one=tables, other=tables)
def test_windows_that_overlap_are_refused(one: Any, other: Any) -> None:
    same = [Exclusive("GNSS fixes of blue/b1")]
    declared = [("attacks.one", table("one", *one)), ("attacks.two", table("two", *other))]
    acting = [(where, window_of(act, DURATION_S * NS_PER_S), same) for where, act in declared if not act.muted]
    problems = list(find_exclusions(acting))
    assert bool(problems) == bool(may_act(*one) & may_act(*other))
    for problem in problems:
        assert "attacks.one" in str(problem)
        assert "attacks.two" in str(problem)


@given(one=tables)
def test_a_window_lies_within_the_run(one: Any) -> None:
    start, stop = window_of(table("one", *one), DURATION_S * NS_PER_S)
    assert stop <= DURATION_S * NS_PER_S
    assert start >= 0


parts = st.frozensets(st.sampled_from("abc"))
areas = st.none() | st.tuples(st.tuples(*[st.floats(-9, 9)] * 3), st.floats(0.1, 9))
claims = st.lists(st.builds(Exclusive, st.sampled_from(["x", "y"]), parts, areas), max_size=4)


@given(one=claims, other=claims)
def test_what_is_common_is_common_to_both(one: list[Exclusive], other: list[Exclusive]) -> None:
    assert bool(common(one, other)) == bool(common(other, one))
    assert bool(common(one, other)) == any(mine.common(others) for mine in one for others in other)
    for mine in one:
        assert mine.common(mine)


SCENARIO = """
name = "two"
seed = 4
duration_s = 30
origin = [40.778, -73.955]
[[operators]]
id = "blue"
  [[operators.vehicles]]
  id = "b1"
  plan.square = { side_m = 20, alt_m = 10 }
  [[operators.vehicles]]
  id = "b2"
  start = [30, 0]
  plan.square = { side_m = 20, alt_m = 10 }
"""
B1, GCS = ["blue/b1"], ["gcs:blue/b1"]
REPEATER = {"power_dbm": -30, "isolation_db": 100}
DRIFT = {"vehicles": B1, "rate_mps": [1, 0, 0]}


def with_attacks(*attacks: dict[str, Any]) -> Scenario:
    scenario = load_text(SCENARIO)
    tables = tuple(AttackTable.model_validate({"id": f"a{n}", **one}) for n, one in enumerate(attacks))
    return scenario.model_copy(update={"attacks": tables})


def attack(kind: str, **params: Any) -> dict[str, Any]:
    return {"kind": kind, "params": params}


EXCLUDED = [
    (attack("gnss.jump", **JUMP), attack("gnss.drift", **DRIFT), "GNSS fixes of blue/b1"),
    (attack("gnss.meacon", at=[0, 0, 2], **REPEATER), attack("gnss.meacon", at=[50, 0, 2], **REPEATER),
     "GNSS fixes of blue/b1"),
    (attack("gnss.meacon", at=[0, 0, 2], **REPEATER), attack("gnss.jump", **JUMP), "GNSS fixes of blue/b1"),
    (attack("telemetry.hide_failures", links=GCS), attack("telemetry.false_alarm", links=GCS), "HEARTBEAT"),
    (attack("telemetry.hide_failures", links=GCS), attack("ground.insider", operator="blue", at=[0, 0, 9]),
     "HEARTBEAT"),
    (attack("ground.insider", operator="blue", at=[0, 0, 9]), attack("ground.insider", operator="blue", at=[9, 0, 9]),
     "ground station of blue"),
    (attack("mavlink.mission_alter", vehicles=B1, offset_m=[9, 0, 0]),
     attack("mavlink.mission_alter", vehicles=B1, on="log", form="delete", item=2), "plan of blue/b1"),
    (attack("companion.takeover", vehicles=B1, track=[[0, 0, 9]]), attack("companion.no_avoidance", vehicles=B1),
     "companion of blue/b1"),
    (attack("mavlink.parameter", vehicles=B1, values={"A": 1}, shown={"A": 2}),
     attack("mavlink.parameter", vehicles=B1, values={"A": 3}, shown={"A": 4, "B": 1}), "A in PARAM_VALUE"),
]  # fmt: skip
TOGETHER = [
    (attack("gnss.jump", **JUMP), attack("gnss.jump", **{**JUMP, "vehicles": ["blue/b2"]})),
    (attack("gnss.jump", **JUMP), attack("gnss.jam", transmitter_m=[0, 50, 2])),
    (attack("gnss.meacon", at=[0, 0, 2], **REPEATER), attack("gnss.meacon", at=[5000, 0, 2], **REPEATER)),
    (attack("telemetry.hide_failures", links=GCS), attack("telemetry.position", links=GCS, offset_m=[9, 0, 0])),
    (attack("telemetry.hide_failures", links=GCS), attack("telemetry.hide_failures", links=["gcs:blue/b2"])),
    (attack("link.drop", links=GCS), attack("link.drop", links=GCS)),
    (attack("link.delay", links=GCS), attack("link.delay", links=GCS)),
    (attack("mavlink.parameter", vehicles=B1, values={"A": 1}, shown={"A": 2}),
     attack("mavlink.parameter", vehicles=B1, values={"B": 3}, shown={"B": 4})),
    (attack("mavlink.parameter", vehicles=B1, values={"A": 1}),
     attack("mavlink.parameter", vehicles=B1, values={"A": 2})),
]  # fmt: skip


@pytest.mark.parametrize(("one", "other", "what"), EXCLUDED)
def test_kinds_that_exclude_each_other(one: dict[str, Any], other: dict[str, Any], what: str) -> None:
    with pytest.raises(InputError) as refused:
        build(with_attacks(one, other))
    for text in (what, "attacks.a0", "attacks.a1", "do not overlap"):
        assert text in str(refused.value)
    build(with_attacks(one, {**other, "muted": True}))
    build(with_attacks({**one, "stop_s": 10}, {**other, "start_s": 10}))
    with pytest.raises(InputError):
        build(with_attacks({**one, "stop_s": 10.1}, {**other, "start_s": 10}))


@pytest.mark.parametrize(("one", "other"), TOGETHER)
def test_kinds_that_go_together(one: dict[str, Any], other: dict[str, Any]) -> None:
    build(with_attacks(one, other))


def test_acts_of_one_stage() -> None:
    acts = {"jump": attack("gnss.jump", **JUMP), "drift": attack("gnss.drift", **DRIFT)}
    first, then = {"name": "a", "acts": ["jump"], "timeout_s": 5}, {"name": "b", "acts": ["drift"], "timeout_s": 5}
    build(with_attacks(attack("campaign", acts=acts, stages=[first, then])))
    both = {"name": "b", "acts": ["jump", "drift"], "timeout_s": 5}
    with pytest.raises(InputError, match=r"stages\.1\.acts: drift, jump .* GNSS fixes of blue/b1"):
        build(with_attacks(attack("campaign", acts=acts, stages=[first, both])))
    with pytest.raises(InputError, match=r"attacks\.a1: alters GNSS fixes of blue/b1"):
        build(with_attacks(attack("gnss.jump", **JUMP), attack("campaign", acts=acts, stages=[first, then])))
