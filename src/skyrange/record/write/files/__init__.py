"""Files of a record: Parquet while the run flies, what is derived from it, and the files for operators."""
