"""The sentence on a pair: who made whom leave its path, when, and in how many seeds."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pyarrow as pa
from hypothesis import given
from hypothesis import strategies as st

from skyrange.twins.pair_folder import Pair
from skyrange.twins.verdict import describe_losses, describe_verdict

ROWS = st.fixed_dictionaries(
    {
        "departed_s": st.none() | st.floats(0.0, 300.0),
        "departure_m": st.floats(0.0, 99.0),
        "delay_s": st.none() | st.floats(-60.0, 60.0),
        "extra_energy_j": st.none() | st.floats(-9000.0, 9000.0),
        "outcome": st.sampled_from(["complete", "failed"]),
        "outcome_twin": st.just("complete"),
        "collisions": st.integers(0, 2),
        "collisions_twin": st.integers(0, 1),
        "attacks": st.sampled_from([[], ["ghost"], ["ghost", "jammer"]]),
        "faults": st.sampled_from([[], ["gust"]]),
        "attribution": st.sampled_from(["both", "none", "unknown", None]),
    }
)


@st.composite
def pairs(draw: st.DrawFn) -> Pair:
    seeds = list(range(7, 7 + draw(st.integers(1, 4))))
    rows: list[dict[str, Any]] = [
        draw(ROWS) | {"seed": seed, "vehicle": vehicle, "against": "nominal"}
        for seed in seeds
        for vehicle in ("a/1", "b/1")
    ]
    twin = [row | {"against": "sham", "departed_s": 1.0} for row in rows]
    return cast("Pair", SimpleNamespace(effects=pa.Table.from_pylist([*rows, *twin]), seeds=seeds, twin="nominal"))


@given(pairs())
def test_it_names_the_first_departure_its_authors_and_the_seeds(found: Pair) -> None:
    of_seed = [row for row in found.effects.to_pylist() if row["against"] == "nominal" and row["seed"] == 7]
    losses = describe_losses(of_seed)
    assert describe_verdict(found, 7).startswith(losses)
    for row in of_seed:
        lost = row["outcome"] != "complete" or row["collisions"] > row["collisions_twin"]
        assert (row["vehicle"] in losses) == lost
    sentence = describe_verdict(found, 7).removeprefix(losses).strip()
    rows = [row for row in found.effects.to_pylist() if row["against"] == "nominal" and row["departed_s"] is not None]
    first = min((row for row in rows if row["seed"] == 7), key=lambda row: row["departed_s"], default=None)
    count = len(found.seeds)
    if first is None:
        assert sentence.startswith("No aircraft left its path")
        others = len({row["seed"] for row in rows})
        assert (f"one did in {others} of {count} seeds" in sentence) == (others > 0)
        return
    authors = [*first["attacks"], *first["faults"]]
    assert sentence.startswith(
        f"{' and '.join(authors)} made {first['vehicle']} leave" if authors else first["vehicle"]
    )
    assert f"at {first['departed_s']:.1f} s: {first['departure_m']:.0f} m off its path" in sentence
    assert ("is shown to be the cause" in sentence) == (not authors)
    assert ("its mission failed instead of complete" in sentence) == (first["outcome"] == "failed")
    alike = {
        row["seed"]
        for row in rows
        if row["vehicle"] == first["vehicle"] and [*row["attacks"], *row["faults"]] == authors
    }
    assert ("In this run, seed 7." if count == 1 else f"it did so in {len(alike)} of {count} seeds") in sentence
