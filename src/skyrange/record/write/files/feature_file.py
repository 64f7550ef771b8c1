"""Parquet file of the `features` table, of the counts that were recorded, with one row for each link and interval."""

from __future__ import annotations

import pyarrow.parquet as pq

from skyrange.record.part_files import OPEN
from skyrange.record.read.features import merge_features
from skyrange.record.read.tables import Tables, combine_batches, encoded_schema, parquet_options
from skyrange.record.schema import arrow_schema
from skyrange.record.spool import SPOOL
from skyrange.record.write.files.table_files import GROUP_ROWS


def write_features(tables: Tables) -> dict[str, int]:
    """Write the file beside the spool of `tables`, of one shard; returns the name of the table with its rows, or
    nothing if it has none. Raises `OSError` and `ArrowException`. Memory stays bounded.
    """
    schema = arrow_schema("features")
    merged = (batch for table in merge_features(tables) for batch in table.to_batches())
    rows = 0
    writer: pq.ParquetWriter | None = None
    try:
        for group in combine_batches(merged, GROUP_ROWS):
            if writer is None:
                path = tables.folder.absolute() / SPOOL / f"features.parquet{OPEN}"
                path.unlink(missing_ok=True)
                writer = pq.ParquetWriter(path, encoded_schema(schema), **parquet_options(schema))
            rows += group.num_rows
            writer.write_table(group.combine_chunks().cast(writer.schema), row_group_size=GROUP_ROWS)
    finally:
        if writer is not None:
            writer.close()
    return {"features": rows} if rows else {}
