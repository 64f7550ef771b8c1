"""Base of the scenario's models: frozen, strict, with errors that name the key.

A model built in Python raises InputError, as a file does.
"""

from __future__ import annotations

import os
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError
from pydantic_core import PydanticCustomError

from skyrange.contracts.params import Number, Whole, items, refuse
from skyrange.core.errors import Problem
from skyrange.core.ids import ID_PATTERN
from skyrange.scenario.validation.error_messages import input_error

__all__ = ["FileName", "Id", "Model", "Number", "Whole", "items", "refuse", "wrong"]


class Model(BaseModel):
    """Frozen, no unknown keys; bad values raise InputError when built by name in Python."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    def __init__(self, /, **data: Any) -> None:
        """Build from keywords. Raises InputError with every fault that was found."""
        try:
            super().__init__(**data)
        except ValidationError as error:
            raise input_error(type(self).__name__, error, type(self), data, self.cross_check) from None

    @classmethod
    def cross_check(cls, data: Any) -> list[Problem]:
        """Faults between the parts of `data`, a table this model is to be built from; none unless it says so."""
        return []

    # pydantic validates nested models through `__init__` if a class overrides it; this marks it as
    # equivalent to pydantic's own, so that nested faults are collected and raised once.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]


FileName = Annotated[
    str,
    BeforeValidator(
        lambda name: os.fspath(name) if isinstance(name, os.PathLike) else name, json_schema_input_type=str
    ),
    Field(min_length=1),
]
"""A file's name, as text or as a path object."""
Id = Annotated[str, Field(pattern=ID_PATTERN.pattern)]
"""An id that may stand in file names and link names."""


def wrong(value: object, expected: str, hint: str = "", where: str = "") -> PydanticCustomError:
    """`refuse` for a single fault."""
    return refuse(Problem(where, value if isinstance(value, str) else repr(value), expected, hint))
