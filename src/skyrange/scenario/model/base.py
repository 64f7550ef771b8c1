"""Base of the scenario's models: frozen and strict, with errors that name the key.

A model that is built in Python raises InputError, as a file does.
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
    """Frozen model without unknown keys. If it is built from keywords in Python, invalid values raise InputError."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    def __init__(self, /, **data: Any) -> None:
        """Build from keywords. Raises InputError with all problems."""
        try:
            super().__init__(**data)
        except ValidationError as error:
            raise input_error(type(self).__name__, error, type(self), data, self.cross_check) from None

    @classmethod
    def cross_check(cls, data: Any) -> list[Problem]:
        """The problems between the parts of `data`, the table from which the model is built; none by default."""
        return []

    # pydantic validates nested models through `__init__` if a class overrides it; this marks it as
    # equivalent to pydantic's own, so that nested problems are collected and raised once.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]


FileName = Annotated[
    str,
    BeforeValidator(
        lambda name: os.fspath(name) if isinstance(name, os.PathLike) else name, json_schema_input_type=str
    ),
    Field(min_length=1),
]
"""The name of a file, as text or as a path object."""
Id = Annotated[str, Field(pattern=ID_PATTERN.pattern)]
"""An id that can be part of file names and link names."""


def wrong(value: object, expected: str, hint: str = "", where: str = "") -> PydanticCustomError:
    """`refuse` for a single problem."""
    return refuse(Problem(where, value if isinstance(value, str) else repr(value), expected, hint))
