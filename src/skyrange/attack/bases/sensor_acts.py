"""Acts on readings of sensors: a kind with the base `OnSensors` that has one as its `act` needs no method.

A reading is a column of `Sensors` by its name, such as `baro_up_m`. The sham leaves the readings.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from typing import Any, Final

import numpy as np

from skyrange.contracts.components import Floats, Sensors
from skyrange.contracts.plugins.form import reads_fields
from skyrange.core.errors import InputError, nearest
from skyrange.core.time import Time

COLUMNS: Final = tuple(field.name for field in fields(Sensors))
"""Names of all readings."""


def alter_reading(column: str, change: str | Callable[[Any, Floats], Any]) -> Any:
    """Alter a reading: `change` is a function of the kind and the values, or the name of a parameter that is added.

    The values have a row for each aircraft; whole ones, such as a number of satellites, are rounded. Raises
    `InputError` for a reading that does not exist.
    """
    _check(column)

    def act(self: Any, now: Time, sensors: Sensors) -> None:
        true = getattr(sensors, column)
        false = np.asarray(true + np.asarray(getattr(self, change)) if isinstance(change, str) else change(self, true))
        true[...] = np.rint(false) if true.dtype.kind == "i" and false.dtype.kind == "f" else false

    return reads_fields(act, change)


def hold_reading(column: str) -> Any:
    """Keep a reading as it was when the act began.

    Raises `InputError` for a reading that does not exist.
    """
    _check(column)

    def act(self: Any, now: Time, sensors: Sensors) -> None:
        true = getattr(sensors, column)
        true[...] = self.held_readings.setdefault(column, true.copy())

    return act


def _check(column: str) -> None:
    if column not in COLUMNS:
        raise InputError.one("act", "reading", column, ", ".join(COLUMNS), nearest(column, COLUMNS))
