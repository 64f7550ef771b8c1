"""Names of the columns of a study's results, which factors and draws cannot have."""

from __future__ import annotations

from dataclasses import fields
from functools import cache
from typing import Final

from skyrange.metrics.aircraft import Measured
from skyrange.study.run_measures import QUANTITIES
from skyrange.twins.effects import COLUMNS as EFFECT_COLUMNS

HEAD: Final = ("block", "point", "seed", "arm")
"""Columns of all tables, before those of the factors and draws."""
RUN: Final = (
    "status", "error", "failed_missions", "simulated_s", "vehicles", "city", "families", "fingerprint", "flight",
)  # fmt: skip
ALERT: Final = ("time_s", "detector", "kind", "subject", "score")
ACT: Final = (
    "attack", "kind", "family", "vehicle", "fault", "harmless_intrusion", "first_s", "last_s", "effect_end_s", "acts"
)  # fmt: skip


def column_of(quantity: str) -> str:
    """The name of a quantity as a column: 'answer, median' is answer_median."""
    return quantity.replace(",", "").replace(" ", "_")


@cache
def reserved_names() -> frozenset[str]:
    """All names of columns that are not those of factors and draws."""
    names = {*HEAD, *RUN, *ALERT, *ACT, "airborne_s", "takeoff_s"}
    names |= {column_of(quantity.name) for quantity in QUANTITIES}
    names |= {field.name for field in fields(Measured)} | {column.name for column in EFFECT_COLUMNS}
    return frozenset(names)
