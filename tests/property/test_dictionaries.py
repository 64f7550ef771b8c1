"""Dictionaries of name columns: whatever they are, the names of all rows stay what they were."""

from __future__ import annotations

import pyarrow as pa
from hypothesis import given
from hypothesis import strategies as st

from skyrange.record.dictionaries import dictionary_array, unify_dictionaries

NAMES = ["", "a", "b", "op1", "op1.uav1", "ü", "z"]
TYPE = pa.dictionary(pa.int32(), pa.string())


@st.composite
def _batches(draw: st.DrawFn) -> list[pa.Array]:
    """Batches of names whose dictionaries grow, shrink, or have nothing in common; some are slices."""
    found = []
    grown = draw(st.permutations(NAMES))
    for _ in range(draw(st.integers(0, 5))):
        names = grown[: draw(st.integers(1, len(grown)))] if draw(st.booleans()) else draw(st.permutations(NAMES))
        rows = draw(st.lists(st.none() | st.integers(0, len(names) - 1), max_size=6))
        batch = pa.DictionaryArray.from_arrays(pa.array(rows, pa.int32()), pa.array(names, pa.string()))
        found.append(batch.slice(draw(st.integers(0, len(rows)))))
    return found


@given(_batches())
def test_the_names_stay_and_have_one_dictionary(batches: list[pa.Array]) -> None:
    column = pa.chunked_array(batches, TYPE)
    table = pa.table({"number": pa.array(range(len(column))), "name": column})
    unified = unify_dictionaries(table)
    assert unified.column("name").to_pylist() == column.to_pylist()
    assert unified.column("number").to_pylist() == list(range(len(column)))
    assert unified.column("name").num_chunks <= 1
    assert unified.schema == table.schema
    assert dictionary_array(column).to_pylist() == column.to_pylist()
    assert dictionary_array(column.cast(pa.string())).to_pylist() == column.to_pylist()


@given(st.integers(1, 6), st.integers(1, 6))
def test_a_growing_dictionary_is_not_looked_up(first: int, second: int) -> None:
    whole = pa.array(NAMES, pa.string())
    short, long = sorted((first, second))
    batches = [
        pa.DictionaryArray.from_arrays(pa.array([0], pa.int32()), whole.slice(0, size)) for size in (short, long, short)
    ]
    unified = dictionary_array(pa.chunked_array(batches, TYPE))
    assert unified.dictionary.equals(whole.slice(0, long))
    assert unified.indices.to_pylist() == [0, 0, 0]
