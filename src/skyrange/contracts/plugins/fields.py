"""Fields of a kind: `param` declares a parameter of a scenario, `state` what changes during a run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from pydantic import Field
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

MISSING: Final = PydanticUndefined


@dataclass(frozen=True, slots=True)
class Param:
    """A parameter as declared: the constraints, default and description that its model gets."""

    info: FieldInfo


@dataclass(frozen=True, slots=True)
class State:
    """A field that changes during a run; each instance begins with a value of its own."""

    make: Callable[[], Any]


def param(
    description: str,
    *,
    default: Any = MISSING,
    ge: float | None = None,
    gt: float | None = None,
    le: float | None = None,
    lt: float | None = None,
    strict: bool | None = None,
    min_length: int | None = None,
    max_length: int | None = None,
) -> Any:
    """A parameter. `description` begins with what it is; a unit belongs in the field's name as well.

    Without `default` a scenario has to give it. The limits are those of pydantic's `Field`.
    """
    limits: dict[str, Any] = {
        "ge": ge, "gt": gt, "le": le, "lt": lt, "strict": strict, "min_length": min_length, "max_length": max_length,
    }  # fmt: skip
    given = {name: limit for name, limit in limits.items() if limit is not None}
    if default is not MISSING:
        given["default"] = default
    return Param(Field(description=description, **given))


def reads_fields(method: Any, *arguments: Any) -> Any:
    """A method for kinds with the fields that its arguments name; `declare` refuses a kind without one of them."""
    method.field_names = tuple(one for one in arguments if isinstance(one, str))
    return method


def state(make: Callable[[], Any]) -> Any:
    """A field that begins with `make()`, such as `state(dict)`. For a number or a text, `name: int = 0` does."""
    return State(make)
