"""Parameters of plugins: their base model, strict numbers, points, and problems that name the key.

Numbers are strict (no text, no booleans, no NaN or infinity), but numpy's scalars are accepted, since a notebook
computes with them.
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, Strict
from pydantic_core import PydanticCustomError

from skyrange.core.errors import Problem


class Params(BaseModel):
    """The parameters of one kind of plugin, a table of a scenario: frozen, no unknown keys.

    Every field has a description that begins with what it is, and its unit in its name.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


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
Enu = Annotated[tuple[Number, Number, Number], BeforeValidator(items, json_schema_input_type=list[float])]
"""East, north and up: metres from the origin, or metres per second."""


def refuse(*problems: Problem) -> PydanticCustomError:
    """Faults found by a rule of ours, to be raised by a validator; they pass through pydantic as they are.

    `where` of each is a dotted path below the model or field that raises, "" for itself.
    """
    text = "; ".join(str(fault) for fault in problems)
    return PydanticCustomError("skyrange", "{text}", {"text": text, "problems": problems})
