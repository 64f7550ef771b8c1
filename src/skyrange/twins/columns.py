"""Columns of the tables of a pair: of effects, attribution and propagation. `columns.csv` has them."""

from __future__ import annotations

from typing import Final

from skyrange.record.schema import Column, read_columns

PAIR_TABLES: Final = read_columns(__file__, "columns.csv", Column)
"""By table, its columns in order."""
