"""Field paths: the field and type of the model at a path of keys."""

from __future__ import annotations

from collections.abc import Iterable
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo


def model_of(annotation: Any) -> type[BaseModel] | None:
    """The model class of this type; None if it is not a model."""
    for option in _options(annotation):
        if isinstance(option, type) and issubclass(option, BaseModel):
            return option
    return None


def element_of(annotation: Any) -> Any | None:
    """The type of the elements; None if this is not a sequence of any length."""
    for option in _options(annotation):
        if get_origin(option) is tuple and get_args(option)[1:] == (...,):
            return get_args(option)[0]
    return None


def value_of(annotation: Any) -> Any | None:
    """The type of the values; None if this is not a table with free keys."""
    for option in _options(annotation):
        if get_origin(option) is dict:
            return get_args(option)[1]
    return None


def type_below(annotation: Any, key: str | int) -> Any | None:
    """The type one level below, at the name of a field, the index of an element or the key of a table; else None."""
    if isinstance(key, int):
        return element_of(annotation)
    model = model_of(annotation)
    if model is not None:
        field = model.model_fields.get(key)
        return None if field is None else field.annotation
    return value_of(annotation)


def type_at(root: Any, keys: Iterable[str | int]) -> Any | None:
    """The type at a path below `root`; None if the path leaves the model."""
    for key in keys:
        if root is None:
            return None
        root = type_below(root, key)
    return root


def field_at(root: Any, keys: tuple[str | int, ...]) -> FieldInfo | None:
    """The field at the end of a path; if the path ends inside the value of a field, that field."""
    found = None
    for depth, key in enumerate(keys):
        model = model_of(root)
        if model is not None and isinstance(key, str) and key in model.model_fields:
            found = model.model_fields[key]
        root = type_below(root, keys[depth])
        if root is None:
            break
    return found


def _options(annotation: Any) -> list[Any]:
    """The alternatives of a type, without annotations."""
    while get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    if get_origin(annotation) in (Union, UnionType):
        return [option for part in get_args(annotation) for option in _options(part)]
    return [annotation]
