"""Relations of attacks to an effect, against the definitions, over all effects of up to three attacks."""

from __future__ import annotations

from itertools import product
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyrange.twins.attribution import (
    Attacks,
    Relation,
    complete,
    relations,
    subsets,
)

A, B, C = "abc"


def seen(*there: str, of: str = "ab") -> dict[Attacks, bool]:
    """All subsets of `of`; the effect is there in `there`."""
    return {active: "".join(sorted(active)) in there for active in subsets(frozenset(of))}


@pytest.mark.parametrize(
    ("runs", "expected"),
    [
        (seen("a", of="a"), {A: "both"}),
        (seen("a", "ab"), {A: "both", B: "none"}),
        (seen("ab"), {A: "joint", B: "joint"}),
        (seen("a", "b", "ab"), {A: "redundant", B: "redundant"}),
        (seen("ab", "ac", "abc", of="abc"), {A: "necessary", B: "redundant", C: "redundant"}),
        (seen("a", "ab", "ac", "bc", "abc", of="abc"), {A: "redundant", B: "redundant", C: "redundant"}),
        (seen("ab", "abc", of="abc"), {A: "joint", B: "joint", C: "none"}),
        (seen("a", "abc", of="abc"), {A: "both", B: "necessary", C: "necessary"}),
        ({frozenset("ab"): True}, {A: "unknown", B: "unknown"}),
        ({frozenset("ab"): True, frozenset("b"): False}, {A: "necessary", B: "unknown"}),
        ({frozenset("abc"): True, frozenset("a"): True}, {A: "sufficient", B: "unknown", C: "unknown"}),
    ],
)
def test_relations(runs: dict[Attacks, bool], expected: dict[str, Relation]) -> None:
    assert relations(runs) == expected


def test_one_attack_that_explains_all_leaves_nothing_to_five_others() -> None:
    everyone = frozenset("abcdef")
    runs = {frozenset(): False, everyone: True}
    for one in everyone:
        runs[frozenset(one)] = one == "a"
        runs[everyone - {one}] = one != "a"
    assert relations(runs) == {A: "both"} | dict.fromkeys("bcdef", "none")
    assert complete(runs).keys() == set(subsets(everyone)), "a monotone effect leaves no choice"


def test_interactions_that_the_runs_do_not_tell_are_listed() -> None:
    everyone = frozenset("abcd")
    runs = {frozenset(): False, everyone: True}
    for one in everyone:
        runs[frozenset(one)], runs[everyone - {one}] = False, True
    assert set(relations(runs).values()) == {"unknown"}
    assert {len(one) for one in set(subsets(everyone)) - complete(runs).keys()} == {2}


def test_an_effect_that_is_not_there_has_no_cause() -> None:
    with pytest.raises(ValueError, match="not there"):
        relations(seen("a"))


def all_effects() -> list[dict[Attacks, bool]]:
    """Every effect of three attacks that is there with all and absent without any."""
    inner = list(subsets(frozenset("abc")))[1:-1]
    return [
        {frozenset(): False, frozenset("abc"): True, **dict(zip(inner, held, strict=True))}
        for held in product((False, True), repeat=len(inner))
    ]


@pytest.mark.parametrize("runs", all_effects())
def test_the_words_mean_what_they_say(runs: dict[Attacks, bool]) -> None:
    everyone = frozenset("abc")
    for attack, relation in relations(runs).items():
        alone, without = runs[frozenset(attack)], runs[everyone - {attack}]
        assert (relation == "both") == (alone and not without)
        assert (relation in ("joint", "necessary")) == (not alone and not without)
        assert relation not in ("unknown", "sufficient")  # every subset was run
        if alone and without:
            assert relation == "redundant"
        if relation == "joint":
            there = [active for active, held in runs.items() if held]
            minimal = [active for active in there if not any(other < active for other in there)]
            assert [attack in one for one in minimal] == [True]


@given(st.data())
def test_what_fewer_runs_tell_is_what_all_tell_of_a_monotone_effect(data: st.DataObject) -> None:
    every = list(subsets(frozenset("abcd")))
    causes = data.draw(st.lists(st.sampled_from(every[1:]), min_size=1, max_size=3))
    full = {active: any(cause <= active for cause in causes) for active in every}
    run = data.draw(st.sets(st.sampled_from(every))) | {frozenset(), frozenset("abcd")}
    some = {active: full[active] for active in run}
    assert complete(some).items() <= full.items()
    whole, part = relations(full), relations(some)
    for attack, relation in part.items():
        allowed: dict[str, set[Any]] = {
            "unknown": set(whole.values()) | {whole[attack]},
            "sufficient": {"both", "redundant"},
            "necessary": {"necessary", "joint", "both"},
        }
        assert whole[attack] in allowed.get(relation, {relation})
