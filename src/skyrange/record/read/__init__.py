"""Reading of a record, from its spool or from its Parquet files."""
