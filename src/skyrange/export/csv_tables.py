"""Export of all recorded tables of a run as CSV files, with a list of their columns.

A cell of ids has a JSON list, a cell of bytes hexadecimal digits. A null is an empty cell, an empty text is `""`.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

import pyarrow as pa
import pyarrow.compute as pc

from skyrange.core.files import atomic_write
from skyrange.export import Export
from skyrange.record.read.run import RunRecord
from skyrange.record.read.telemetry import message_schema
from skyrange.record.schema import ALL_MESSAGES, TABLES, arrow_schema

FOLDER: Final = "tables"
COLUMNS: Final = "columns.csv"
"""The file that says the type, unit and meaning of the columns of all files."""


def write_tables(record: RunRecord, folder: Path | None = None) -> Export:
    """Write every table that the run's level keeps as a CSV file into `folder` (default: `tables` in the run's folder;
    created if it is missing): `truth.csv`, …, `telemetry/ATTITUDE.csv`, …, and `columns.csv`.

    `items` and `by` of the result count rows, in all and by file. Raises `InputError` for a damaged table, and
    `OSError` if a file cannot be written; no incomplete file is left behind.
    """
    target = folder or record.path / FOLDER
    target.mkdir(exist_ok=True)
    rows: dict[str, int] = {}
    described: list[tuple[str, pa.Field]] = []
    for name in TABLES:
        if record.keeps(name):
            batches = record.batches(name)
            rows[f"{name}.csv"], schema = write_csv(target / f"{name}.csv", batches, arrow_schema(name))
            described += [(name, field) for field in schema]
    if record.keeps(ALL_MESSAGES):
        (target / ALL_MESSAGES).mkdir(exist_ok=True)
        for message in record.messages:
            batches = record.telemetry_batches(message)  # raises for a name that no message has, thus for any path
            name = f"{ALL_MESSAGES}/{message}"
            rows[f"{name}.csv"], schema = write_csv(target / f"{name}.csv", batches, message_schema(message))
            described += [(name, field) for field in schema]
    with atomic_write(target / COLUMNS) as file:
        file.write(_describe_columns(described).encode())
    return Export(target, sum(rows.values()), rows)


def write_csv(path: Path, batches: Iterator[pa.RecordBatch], declared: pa.Schema) -> tuple[int, pa.Schema]:
    """Write batches; the number of their rows, and their schema, which is `declared` if there is none."""
    schema, rows = declared, 0
    with atomic_write(path) as file:
        for place, batch in enumerate(batches):
            schema = batch.schema if place == 0 else schema
            if place == 0:
                file.write(_header(schema))
            rows += batch.num_rows
            if batch.num_rows:
                cells = [print_cells(batch.column(number)) for number in range(batch.num_columns)]
                lines = pc.binary_join_element_wise(*cells, ",", null_handling="replace", null_replacement="")
                file.write("\n".join([*lines.to_pylist(), ""]).encode())
        if schema is declared:
            file.write(_header(schema))
    return rows, schema


def _header(schema: pa.Schema) -> bytes:
    return (",".join(_quote(pa.array(schema.names)).to_pylist()) + "\n").encode()


def print_cells(column: pa.Array) -> pa.Array:
    """The values of a column as the text of cells (RFC 4180); null where there is none.

    A floating-point number has a point or an exponent, by which readers tell its type, and all digits that it needs.
    """
    kind = column.type
    if pa.types.is_floating(kind):
        text = column.cast(pa.string())
        integral = pc.match_substring_regex(text, "^-?[0-9]+$")
        text = pc.if_else(integral, pc.binary_join_element_wise(text, ".0", ""), text)
        return pc.replace_substring(text, "nan", "NaN")
    if pa.types.is_integer(kind) or pa.types.is_boolean(kind):
        return column.cast(pa.string())
    if pa.types.is_list(kind):
        texts = ["[]" if cell == [] else None if cell is None else json.dumps(cell, ensure_ascii=False)
                 for cell in column.to_pylist()]  # fmt: skip
        return _quote(pa.array(texts, pa.string()))
    if pa.types.is_binary(kind):
        return pa.array([None if cell is None else cell.hex() for cell in column.to_pylist()], pa.string())
    return _quote(column.cast(pa.string()))


def _quote(texts: pa.Array) -> pa.Array:
    """Texts in quotes if they are empty, or contain a comma, a quote, a line break or a space at an end."""
    special = pc.match_substring_regex(texts, '^$|[,"\r\n]|^ | $')
    quoted = pc.binary_join_element_wise('"', pc.replace_substring(texts, '"', '""'), '"', "")
    return pc.if_else(special, quoted, texts)


def _describe_columns(columns: Iterable[tuple[str, pa.Field]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("table", "column", "type", "unit", "meaning"))
    for table, field in columns:
        texts = (field.metadata or {}).items()
        metadata = {key.decode(errors="replace"): value.decode(errors="replace") for key, value in texts}  # if damaged
        writer.writerow((table, field.name, str(field.type), metadata.get("unit", ""), metadata.get("meaning", "")))
    return text.getvalue()
