"""Parquet files that skyrange writes, read by their declared columns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from skyrange.core.errors import InputError, Problem

MAX_ROWS: Final = 1 << 27
"""Most rows of a file that is read as a whole: a file of a few bytes can say that it has any number of them."""
_COMPLETE: Final = "a complete Parquet file"
_DAMAGED: Final = "The file was changed by hand or is damaged."


@contextmanager
def name_damaged_file(who: str, where: str) -> Iterator[None]:
    """Turn what Arrow raises for a damaged file into an `InputError` in the name of `who`, about the file `where`."""
    try:
        yield
    except FileNotFoundError:
        raise InputError.one(who, where, "no such file", _COMPLETE, "It was removed.") from None
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:  # the last: names of columns
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError.one(who, where, reason, _COMPLETE, _DAMAGED) from error


def plain_schema(schema: pa.Schema) -> pa.Schema:
    """A schema with plain strings instead of dictionaries."""
    fields = [field.with_type(pa.string()) if pa.types.is_dictionary(field.type) else field for field in schema]
    return pa.schema(fields, metadata=schema.metadata)


def check_columns(found: pa.Schema, declared: pa.Schema, who: str, where: str) -> None:
    """Raise `InputError` unless a file has each declared column once, with its type; names may be dictionaries."""
    found = plain_schema(found)
    problems = []
    for field in declared:
        places = found.get_all_field_indices(field.name)
        kinds = ", ".join(str(found.field(place).type) for place in places) or "missing"
        if len(places) != 1 or not found.field(places[0]).type.equals(plain_schema(pa.schema([field])).field(0).type):
            problems.append(Problem(f"{where}: {field.name}", kinds, f"a column of type {field.type}", _DAMAGED))
    if problems:
        raise InputError(who, problems)


def check_values(batch: pa.RecordBatch | pa.Table, declared: pa.Schema, who: str, where: str) -> None:
    """Raise `InputError` for rows without a value in a declared column that has one in each row, or lists with such."""
    for field in declared:
        column = batch.column(field.name)
        if column.null_count and not field.nullable:
            value = f"{column.null_count} rows without a value"
            raise InputError.one(who, f"{where}: {field.name}", value, "a value in each row", _DAMAGED)
        if pa.types.is_list(field.type) and pc.list_flatten(column).null_count:  # lists of names
            raise InputError.one(
                who, f"{where}: {field.name}", "lists with nothing in them", "lists of values", _DAMAGED
            )


def check_ranges(table: pa.Table, ranges: Mapping[str, tuple[float, float]], who: str, where: str) -> None:
    """Raise `InputError` for a number outside the range of its column, such as (0, 1), or for one that is not a number.

    Ranges of columns that the table does not have are ignored.
    """
    for name, (low, high) in ranges.items():
        if name not in table.column_names:
            continue
        column = table.column(name)
        least, most = pa.scalar(low, column.type), pa.scalar(high, column.type)  # an integer is compared as it is
        is_inside = pc.and_(pc.greater_equal(column, least), pc.less_equal(column, most))
        found = column.filter(pc.invert(is_inside))  # NaN is outside, and nulls are left out
        if len(found):
            value = f"{found[0]}, in {len(found)} of {len(column)} rows"
            raise InputError.one(who, f"{where}: {name}", value, f"a number from {low} to {high}", _DAMAGED)


def read_table(
    path: Path, who: str, where: str, declared: pa.Schema | None = None, *, columns: Sequence[str] | None = None
) -> pa.Table:
    """The table in a Parquet file with the `declared` columns, those among them that are in `columns`, or all that it
    has where none are declared. Names are plain strings.

    Raises `InputError` in the name of `who` for a file that is missing or damaged, has too many rows, or is not as
    declared.
    """
    with name_damaged_file(who, where), pq.ParquetFile(path.absolute()) as file:
        if declared is not None:
            chosen = [field for field in declared if columns is None or field.name in columns]
            declared = plain_schema(pa.schema(chosen, metadata=declared.metadata))
            check_columns(file.schema_arrow, declared, who, where)
        if file.metadata.num_rows > MAX_ROWS:
            value = f"{file.metadata.num_rows:,} rows"
            raise InputError.one(who, where, value, f"a table of at most {MAX_ROWS:,} rows")
        table = file.read(columns=None if declared is None else declared.names)
        table.validate(full=True)
        table = table.cast(plain_schema(table.schema)) if declared is None else table.select(declared.names)
    if declared is not None:
        table = table.cast(
            pa.schema([field.with_nullable(nullable=True) for field in declared], metadata=declared.metadata)
        )
        check_values(table, declared, who, where)
        table = pa.Table.from_arrays(table.columns, schema=declared)
    return table
