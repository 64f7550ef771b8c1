"""What do all parts of the scenario model share? Strict plain numbers, names, and errors that help.

Numbers are strict (no text, no booleans, no NaN or infinity) but numpy's scalars are welcome, since a
notebook computes with them. A model built in Python raises InputError, as a file does.
"""

from __future__ import annotations

import os
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, Strict, ValidationError
from pydantic_core import PydanticCustomError

from skyrange.core.errors import Fault
from skyrange.core.ids import ID_PATTERN


class Model(BaseModel):
    """Frozen, no unknown keys; bad values raise InputError when built by name in Python."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    def __init__(self, /, **data: Any) -> None:
        """Build from keywords. Raises InputError with every fault that was found."""
        try:
            super().__init__(**data)
        except ValidationError as error:
            from skyrange.scenario.faults import input_error  # the models come first, then what speaks of them

            raise input_error(type(self).__name__, error, type(self), data) from None

    @classmethod
    def faults_between(cls, data: Any) -> list[Fault]:
        """Faults between the parts of `data`, a table this model is to be built from; none unless it says so."""
        return []

    # pydantic validates nested models through `__init__` if a class overrides it; this marks it as
    # equivalent to pydantic's own, so that nested faults are collected and raised once.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]


def _plain(value: Any) -> Any:
    """A numpy scalar as the Python number that it equals; all else as it is."""
    return value.item() if type(value).__module__ == "numpy" and getattr(value, "ndim", None) == 0 else value


def items(value: Any) -> Any:
    """A numpy array as nested lists; all else as it is."""
    return value.tolist() if type(value).__module__ == "numpy" and getattr(value, "ndim", 0) > 0 else value


Number = Annotated[float, BeforeValidator(_plain), Strict(), Field(allow_inf_nan=False)]
"""A finite float; integers count as floats."""
Whole = Annotated[int, BeforeValidator(_plain), Strict()]
"""An integer, not a boolean and not a float."""
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


def refuse(*faults: Fault) -> PydanticCustomError:
    """Faults found by a rule of ours, to be raised by a validator; they pass through pydantic as they are.

    `where` of each is a dotted path below the model or field that raises, "" for itself.
    """
    text = "; ".join(str(fault) for fault in faults)
    return PydanticCustomError("skyrange", "{text}", {"text": text, "faults": faults})


def wrong(value: object, expected: str, hint: str = "", where: str = "") -> PydanticCustomError:
    """`refuse` for a single fault."""
    return refuse(Fault(where, value if isinstance(value, str) else repr(value), expected, hint))
