"""Parquet writer of the recorded tables: their encodings, and the schema that other programs read."""

from __future__ import annotations

import base64
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from skyrange.core.parquet_files import plain_schema
from skyrange.record.read.tables import encoded_schema, names_of


def open_parquet(path: Path, schema: pa.Schema) -> pq.ParquetWriter:
    """A file for rows in which names are dictionaries, as in `encoded_schema(schema)`. Raises `OSError`.

    The stored schema says that names are strings: Arrow would store that they were dictionaries, and polars would read
    categories, which cannot be compared between two files.
    """
    writer = pq.ParquetWriter(path, encoded_schema(schema), store_schema=False, **_encodings(schema))
    stored = base64.b64encode(plain_schema(schema).serialize().to_pybytes()).decode()
    writer.add_key_value_metadata({"ARROW:schema": stored, **_decode(schema.metadata)})
    return writer


def _decode(metadata: dict[bytes, bytes] | None) -> dict[str, str]:
    return {key.decode(): value.decode() for key, value in (metadata or {}).items()}


def _encodings(schema: pa.Schema) -> dict[str, object]:
    """Parquet options for a table: names dictionary-encoded, integers delta-encoded, floats split by byte position, as
    are distances of scans, whose low bits are noise: in lists of 16 bits this takes 2/3 of the bytes of any other
    with a VLP-16, and a tenth more than differences with a depth camera.

    Numbers have statistics, by which readers skip groups of rows; those of names would take longer than the names.
    """
    named = names_of(schema)
    layout: dict[str, str] = {}
    for field in schema:
        if pa.types.is_integer(field.type):
            layout[field.name] = "DELTA_BINARY_PACKED"
        elif pa.types.is_floating(field.type):
            layout[field.name] = "BYTE_STREAM_SPLIT"
        elif pa.types.is_binary(field.type):
            layout[field.name] = "DELTA_LENGTH_BYTE_ARRAY"
        elif pa.types.is_list(field.type) and field.type.value_type == pa.uint16():
            layout[f"{field.name}.list.element"] = "BYTE_STREAM_SPLIT"
        elif pa.types.is_list(field.type) and pa.types.is_integer(field.type.value_type):
            named.append(f"{field.name}.list.element")
    return {
        "compression": "zstd",
        "compression_level": 3,
        "use_dictionary": named or False,
        "column_encoding": layout or None,
        "write_statistics": [field.name for field in schema if _is_number(field.type)] or False,
    }


def _is_number(kind: pa.DataType) -> bool:
    return bool(pa.types.is_integer(kind) or pa.types.is_floating(kind))
