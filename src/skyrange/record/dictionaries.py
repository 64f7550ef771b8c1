"""Dictionaries of name columns, merged over the batches of a table."""

from __future__ import annotations

import pyarrow as pa


def unify_dictionaries(table: pa.Table) -> pa.Table:
    """The table in one piece, with one dictionary for each column of names.

    The dictionaries of a recorder grow: each begins with all names of the one before. The longest then serves all
    batches. `pa.Table.unify_dictionaries` looks up every name of every batch, which takes longer than encoding the rows
    if there are many aircraft.
    """
    return pa.Table.from_arrays([_unify(column) for column in table.columns], schema=table.schema).combine_chunks()


def dictionary_array(column: pa.ChunkedArray) -> pa.DictionaryArray:
    """A column of names in one piece; names that are plain strings are encoded."""
    encoded = _unify(column) if pa.types.is_dictionary(column.type) else column.dictionary_encode()
    whole = encoded.combine_chunks()
    return whole.chunk(0) if isinstance(whole, pa.ChunkedArray) else whole


def _unify(column: pa.ChunkedArray) -> pa.ChunkedArray:
    if not pa.types.is_dictionary(column.type) or column.num_chunks < 2:
        return column
    dictionaries = [chunk.dictionary for chunk in column.chunks]
    longest = max(dictionaries, key=len)
    if not all(_begins_with(longest, other) for other in dictionaries):
        return column.unify_dictionaries()
    indices = pa.concat_arrays([chunk.indices for chunk in column.chunks])
    return pa.chunked_array([pa.DictionaryArray.from_arrays(indices, longest)], column.type)


def _begins_with(longer: pa.Array, shorter: pa.Array) -> bool:
    if len(longer) == len(shorter) and _location(longer) == _location(shorter):
        return True
    return bool(longer.slice(0, len(shorter)).equals(shorter))


def _location(names: pa.Array) -> tuple[int, list[int]]:
    return names.offset, [0 if buffer is None else buffer.address for buffer in names.buffers()]
